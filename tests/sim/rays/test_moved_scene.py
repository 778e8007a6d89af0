"""A scene that is moved answers like one whose mesh was moved."""

import numpy as np
import pytest

from pcdet_avp.sim.meshes.car import car_mesh
from pcdet_avp.sim.rays.moved_scene import MovedScene
from pcdet_avp.sim.rays.raytracer import RayTracer
from pcdet_avp.sim.rays.triangle_scene import TriangleScene
from pcdet_avp.sim.world import EGO_SPEC
from pcdet_avp.structures.pose import Pose

POSE = Pose.from_xyz_yaw(-31.7, 12.3, yaw=2.1)
EYE = np.array([-10.0, 3.0, 2.5], np.float32)


@pytest.fixture(scope="module")
def rays():
    """40,000 rays (R, 3) around the car, about half of which miss it."""
    target = POSE.translation + np.random.default_rng(0).uniform([-4, -4, 0], [4, 4, 2.5], (40_000, 3))
    return (target - EYE).astype(np.float32)


def answers(scene, rays):
    hits = RayTracer([scene]).cast(EYE, rays)
    return hits.face, hits.distance


def test_first_hits_are_those_of_the_moved_mesh(rays):
    mesh = car_mesh(EGO_SPEC)
    face, distance = answers(TriangleScene([(mesh.transformed(POSE), 7)]), rays)
    moved = MovedScene(TriangleScene([(mesh, 0)]), POSE, 7)
    found, way = answers(moved, rays)
    assert 0.2 < (face >= 0).mean() < 0.8
    same = found == face  # all but rays along an edge, which either neighbour may take
    assert same.mean() > 0.999
    np.testing.assert_allclose(way[same], distance[same], rtol=1e-5)
    assert (moved.instance == 7).all()
    assert len(moved.instance) == len(moved) == len(mesh.faces)


def test_what_blocks_and_who_may_be_met_agree_with_the_hits(rays):
    moved = MovedScene(TriangleScene([(car_mesh(EGO_SPEC), 0)]), POSE, 7)
    tracer, (face, _) = RayTracer([moved]), answers(moved, rays)
    assert (tracer.occluded(EYE, rays) == (face >= 0)).mean() > 0.9999
    far = np.full(len(rays), 1e6, np.float32)
    passing = moved.passing(np.broadcast_to(EYE, rays.shape), rays, far, face < 0)
    assert set(passing) == set(np.flatnonzero(face >= 0))  # of those that meet it, none is left out
    near = moved.candidates(EYE, rays)
    assert set(np.flatnonzero(face >= 0)) <= set(near)
    assert len(near) < len(rays)
    assert moved.recall(EYE, rays, 1e6) is None
