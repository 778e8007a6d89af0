"""Car meshes fill their boxes and are closed towards the outside."""

import numpy as np
import pytest

from pcdet_avp.errors import GeometryError
from pcdet_avp.sim.meshes.car import car_mesh
from pcdet_avp.sim.meshes.car_spec import SIZES_M, CarSpec, draw_car
from pcdet_avp.sim.meshes.mesh import Material, face_normals
from pcdet_avp.sim.rays.raytracer import FAR_M, RayTracer, TriangleScene

BODIES = list(SIZES_M)


def cars(body, count=6):
    rng = np.random.default_rng(1)
    return [draw_car(rng, body) for _ in range(count)]


def outside_rays(spec, count=4000):
    """Rays from a sphere around the car towards points inside its box."""
    rng = np.random.default_rng(2)
    start = rng.normal(size=(count, 3))
    start[:, 2] = np.abs(start[:, 2])
    start = 8 * start / np.linalg.norm(start, axis=1, keepdims=True)
    target = rng.uniform(-0.5, 0.5, (count, 3)) * spec.size + (0, 0, spec.height / 2)
    return start.astype(np.float32), (target - start).astype(np.float32)


@pytest.mark.parametrize("body", BODIES)
def test_the_mesh_fills_its_box_to_a_millimetre(body):
    for spec in cars(body):
        mesh, half = car_mesh(spec), np.array(spec.size) / 2
        np.testing.assert_allclose(mesh.vertices.min(0), [-half[0], -half[1], 0.0], atol=1e-3)
        np.testing.assert_allclose(mesh.vertices.max(0), [half[0], half[1], spec.height], atol=1e-3)


@pytest.mark.parametrize("body", BODIES)
def test_whoever_looks_from_outside_meets_front_faces_only(body):
    for spec in cars(body, 3):
        mesh = car_mesh(spec)
        start, direction = outside_rays(spec)
        hits = RayTracer([TriangleScene([(mesh, 0)])]).cast(start, direction)
        met = hits.face >= 0
        facing = np.einsum("ij,ij->i", face_normals(mesh.vertices, mesh.faces)[hits.face[met]], direction[met])
        assert met.mean() > 0.7
        assert (facing < 0).mean() > 0.995


@pytest.mark.parametrize("body", BODIES)
def test_corner_normals_are_unit_and_on_the_outer_side_of_their_faces(body):
    mesh = car_mesh(cars(body, 1)[0])
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1, atol=1e-4)
    outward = face_normals(mesh.vertices, mesh.faces)
    assert np.einsum("ij,ikj->ik", outward, mesh.normals).min() > 0


@pytest.mark.parametrize("body", BODIES)
def test_wheels_stand_on_the_floor_and_daylight_shows_under_the_sills(body):
    spec = cars(body, 1)[0]
    mesh = car_mesh(spec)
    touching = mesh.vertices[mesh.vertices[:, 2] < 0.01]
    assert touching[:, 0].min() < -0.2 * spec.length < 0.2 * spec.length < touching[:, 0].max()
    under = RayTracer([TriangleScene([(mesh, 0)])]).cast(
        np.array([0, 5, 0.05], np.float32), np.array([[0, -1, 0]], np.float32)
    )
    assert under.distance[0] == FAR_M


@pytest.mark.parametrize("body", BODIES)
def test_glass_lamps_wheels_and_plates_are_where_a_car_has_them(body):
    spec = cars(body, 1)[0]
    mesh = car_mesh(spec)
    middle = mesh.vertices[mesh.faces].mean(1)
    assert middle[mesh.materials == Material.HEAD_LAMP, 0].min() > 0.3 * spec.length
    assert middle[mesh.materials == Material.TAIL_LAMP, 0].max() < -0.4 * spec.length
    assert middle[mesh.materials == Material.GLASS, 2].min() > 0.4 * spec.height
    assert set(np.sign(middle[mesh.materials == Material.RETROREFLECTOR, 0])) == {-1, 1}
    assert len(mesh.faces) < 2000


def test_drawn_sizes_lie_in_the_stated_ranges_and_vary():
    rng = np.random.default_rng(0)
    specs = [draw_car(rng) for _ in range(300)]
    for spec in specs:
        low, high = SIZES_M[spec.body]
        assert all(a <= v <= b for a, v, b in zip(low, spec.size, high, strict=True))
    assert {spec.body for spec in specs} == set(BODIES)
    assert len({spec.color for spec in specs}) == 300
    whites = [min(s.color) > 0.4 for s in specs if s.body == "van"]
    assert np.mean(whites) > 0.35


def test_an_unknown_body_and_a_size_of_zero_are_refused():
    with pytest.raises(GeometryError, match="hatchback, sedan"):
        CarSpec("tractor", 4.0, 2.0, 2.0, (0.5, 0.5, 0.5))
    with pytest.raises(GeometryError, match="positive"):
        CarSpec("sedan", 4.0, 0.0, 1.5, (0.5, 0.5, 0.5))
