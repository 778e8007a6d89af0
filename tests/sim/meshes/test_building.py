"""The building is closed, keeps the road and the mast's view free, and is cheap for rays."""

import numpy as np
import pytest

from pcdet_avp.sim.garage import LANE_WIDTH_M
from pcdet_avp.sim.layouts import GarageConfig, draw_layout
from pcdet_avp.sim.meshes.building import building_mesh
from pcdet_avp.sim.meshes.mesh import Material, face_normals
from pcdet_avp.sim.rays.raytracer import FAR_M, RayTracer, TriangleScene


@pytest.fixture(scope="module", params=[0, 1, 2])
def garage(request):
    layout = draw_layout(np.random.default_rng(request.param))
    return layout, building_mesh(layout), RayTracer([TriangleScene([(building_mesh(layout), -1)])])


def test_a_few_thousand_triangles_suffice(garage):
    assert 500 < len(garage[1].faces) < 15000


def test_no_ray_escapes_from_the_road(garage):
    layout, _, tracer = garage
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(5000, 3)).astype(np.float32)
    origin = np.array([layout.junction_x - 20, -1.0, 1.5], np.float32)
    assert (tracer.cast(origin, directions).distance < FAR_M).all()


def test_every_face_seen_from_the_road_looks_at_the_viewer(garage):
    layout, mesh, tracer = garage
    directions = np.random.default_rng(1).normal(size=(5000, 3)).astype(np.float32)
    hits = tracer.cast(np.array([layout.junction_x, 0.0, 1.5], np.float32), directions)
    facing = np.einsum("ij,ij->i", face_normals(mesh.vertices, mesh.faces)[hits.face], directions)
    assert (facing < 0).mean() > 0.999


def test_floor_and_ceiling_are_where_the_layout_says(garage):
    layout, _, tracer = garage
    x = np.linspace(layout.road_start_x + 1, layout.road_end_x - 1, 200)
    start = np.stack([x, np.full_like(x, 0.9), np.full_like(x, 1.0)], 1).astype(np.float32)
    down = tracer.cast(start, np.tile(np.float32([0, 0, -1]), (200, 1)))
    np.testing.assert_allclose(down.distance, 1.0, atol=0.006)
    up = tracer.cast(start, np.tile(np.float32([0, 0, 1]), (200, 1)))
    assert up.distance.max() == pytest.approx(layout.ceiling_m - 1.0, abs=1e-3)
    assert up.distance.min() > 0.9 * layout.ceiling_m - 1.0


def test_both_lanes_are_free_up_to_the_height_of_a_van(garage):
    layout, _, tracer = garage
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-3.2, 3.2, 17), np.linspace(0.05, 2.6, 9)))
    start = np.stack([np.full_like(y, layout.road_start_x + 0.5), y, z], 1).astype(np.float32)
    ahead = tracer.cast(start, np.tile(np.float32([1, 0, 0]), (len(y), 1)))
    assert ahead.distance.min() > layout.road_end_x - layout.road_start_x - 1.0


def test_nothing_hangs_between_the_mast_and_the_road_in_its_map(garage):
    _, _, tracer = garage
    rng = np.random.default_rng(2)
    target = rng.uniform((-44.8, -3.3, 0.05), (-3.0, 3.3, 2.2), (2000, 3)).astype(np.float32)
    mast = np.array([0, 0, 7.0], np.float32)
    assert not tracer.occluded(np.tile(mast, (2000, 1)), target - mast, 0.999).any()


def test_pillars_stand_where_the_layout_says(garage):
    layout, _, tracer = garage
    for pillar in layout.pillars[:10]:
        towards = np.array([0, np.sign(pillar.y), 0], np.float32)
        hit = tracer.cast(np.array([pillar.x, 0, 1.4], np.float32), towards[None])
        assert hit.distance[0] == pytest.approx(abs(pillar.y) - pillar.size / 2, abs=0.01)


def test_there_is_one_glowing_face_per_lamp_and_failed_ones_are_dark(garage):
    layout, mesh, _ = garage
    glow = mesh.colors[mesh.materials == Material.LAMP].max(1).reshape(-1, 2)[:, 0]
    intensity = np.array([lamp.intensity for lamp in layout.lamps])
    assert len(glow) == len(intensity)
    assert (glow[intensity == 0] < 0.05).all()
    assert (glow[intensity > 0.7] > 0.5).all()


def test_slot_lines_are_floor_paint_a_few_millimetres_high(garage):
    _, mesh, _ = garage
    floor = mesh.vertices[np.unique(mesh.faces[mesh.materials == Material.FLOOR])]
    assert floor[:, 2].max() < 0.01
    assert np.abs(floor[:, 1]).max() >= LANE_WIDTH_M


def test_a_low_ceiling_leaves_the_road_free():
    layout = draw_layout(np.random.default_rng(4), GarageConfig(ceiling_m=(3.0, 3.0)))
    tracer = RayTracer([TriangleScene([(building_mesh(layout), -1)])])
    ahead = tracer.cast(np.array([layout.road_start_x + 1, -1.7, 1.9], np.float32), np.float32([[1, 0, 0]]))
    assert ahead.distance[0] > 100
