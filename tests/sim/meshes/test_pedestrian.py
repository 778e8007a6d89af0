"""People stand on the floor at their full height in every phase of the gait."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcdet_avp.errors import GeometryError
from pcdet_avp.sim.meshes.mesh import Material, face_normals
from pcdet_avp.sim.meshes.pedestrian import pedestrian_mesh
from pcdet_avp.sim.meshes.pedestrian_spec import BOX_SIDE_M, HEIGHT_M, draw_pedestrian


def signed_volume(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(float) for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), phase=st.floats(-20, 20), walking=st.booleans())
def test_feet_touch_the_floor_and_the_crown_is_at_full_height(seed, phase, walking):
    spec = draw_pedestrian(np.random.default_rng(seed))
    mesh = pedestrian_mesh(spec, phase, walking)
    assert abs(mesh.vertices[:, 2].min()) < 1e-4
    assert abs(mesh.vertices[:, 2].max() - spec.height) < 1e-4
    lowest = mesh.faces[mesh.materials == Material.RUBBER]
    assert mesh.vertices[lowest, 2].min() < 1e-3


def test_a_body_weighs_what_a_body_weighs_and_faces_outwards():
    rng = np.random.default_rng(3)
    for kind, litres in (("adult", (55, 150)), ("child", (12, 45))):
        for _ in range(5):
            spec = replace(draw_pedestrian(rng, kind), backpack=False)
            assert litres[0] < 1000 * signed_volume(pedestrian_mesh(spec, 1.0, True)) < litres[1]


def test_normals_are_unit_and_outward_after_posing():
    mesh = pedestrian_mesh(draw_pedestrian(np.random.default_rng(4)), 0.7, True)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1, atol=1e-4)
    outward = face_normals(mesh.vertices, mesh.faces)
    assert (np.einsum("ij,ikj->ik", outward, mesh.normals) > 0).mean() > 0.99


def test_a_gait_repeats_after_two_steps_and_mirrors_after_one():
    spec = replace(draw_pedestrian(np.random.default_rng(5), "adult"), backpack=False)
    now, step, cycle = (pedestrian_mesh(spec, 0.4 + shift, True).vertices for shift in (0, np.pi, 2 * np.pi))
    np.testing.assert_allclose(now, cycle, atol=1e-5)
    mirrored = now * (1, -1, 1)
    np.testing.assert_allclose(step.min(0), mirrored.min(0), atol=2e-3)
    np.testing.assert_allclose(step.max(0), mirrored.max(0), atol=2e-3)


def test_a_stride_is_longer_than_a_stance():
    spec = draw_pedestrian(np.random.default_rng(6), "adult")
    shoes = {}
    for walking in (True, False):
        mesh = pedestrian_mesh(spec, np.pi / 2, walking)
        x = mesh.vertices[np.unique(mesh.faces[mesh.materials == Material.RUBBER]), 0]
        shoes[walking] = x.max() - x.min()
    assert shoes[False] < 0.45 < 0.6 < shoes[True] < 1.2


def test_the_label_box_is_the_capsule_box_of_the_kind():
    rng = np.random.default_rng(7)
    for _ in range(100):
        spec = draw_pedestrian(rng)
        dx, dy, dz = spec.size
        assert dx == dy == spec.box_side
        assert BOX_SIDE_M[spec.kind][0] <= dx <= BOX_SIDE_M[spec.kind][1]
        assert HEIGHT_M[spec.kind][0] <= dz <= HEIGHT_M[spec.kind][1]


def test_trunk_and_head_stay_over_the_label_box():
    spec = replace(draw_pedestrian(np.random.default_rng(8), "adult"), backpack=False)
    for phase in np.linspace(0, 6, 7):
        vertices = pedestrian_mesh(spec, phase, True).vertices
        head = vertices[vertices[:, 2] > 0.9 * spec.height]
        assert np.abs(head[:, :2].mean(0)).max() < 0.1


def test_an_unknown_kind_is_refused():
    with pytest.raises(GeometryError, match="adult, child"):
        replace(draw_pedestrian(np.random.default_rng(9)), kind="robot")
