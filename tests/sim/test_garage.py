"""Drawn garage plans: sizes as in the paper, nothing in anything's way, and a mast that overlooks the junction."""

import numpy as np
import pytest

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.garage import LANE_WIDTH_M, SLOT_DEPTH_M, SLOT_WIDTH_M, GarageLayout, Slot, Wall
from pcdet_avp.sim.layouts import GarageConfig, draw_layout
from pcdet_avp.sim.meshes.mesh import Material, box_mesh
from pcdet_avp.sim.rays.raytracer import RayTracer, TriangleScene
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.rotated_iou import bev_intersection

LOW_CEILING = GarageConfig(ceiling_m=(3.15, 3.35))


@pytest.fixture(scope="module")
def layouts():
    return [draw_layout(np.random.default_rng(seed)) for seed in range(40)]


def slot_boxes(layout):
    return np.array([(s.x, s.y, 0.5, SLOT_DEPTH_M, SLOT_WIDTH_M, 1.0, s.heading) for s in layout.slots])


def road_box(layout):
    length = layout.road_end_x - layout.road_start_x
    return np.array([[layout.road_start_x + length / 2, 0, 0.5, length, 2 * LANE_WIDTH_M, 1, 0.0]])


def side_road_box(layout):
    length = -LANE_WIDTH_M - layout.side_road_end_y
    return np.array([[layout.junction_x, -LANE_WIDTH_M - length / 2, 0.5, length, 2 * LANE_WIDTH_M, 1, np.pi / 2]])


def solids(layout):
    """A tracer over pillars and walls."""
    parts = []
    for box in layout.solid_boxes():
        pose = Pose.from_xyz_yaw(*box[:3], yaw=box[6])
        parts.append((box_mesh(box[3:6], (0, 0, 0), (0.5, 0.5, 0.5), Material.CONCRETE).transformed(pose), -1))
    return RayTracer([TriangleScene(parts)])


def test_a_wall_has_the_body_between_its_ends():
    wall = Wall(1.0, 2.0, 1.0, 6.0, height=3.0, thickness=0.2)
    assert wall.box == pytest.approx((1.0, 4.0, 1.5, 4.0, 0.2, 3.0, np.pi / 2))


def test_gaps_are_between_neighbours_of_a_row_only():
    """Three slots left, of which the third stands behind a pillar; one slot right."""
    left = [Slot(x, 6.3, np.pi / 2) for x in (-10.0, -10.0 - SLOT_WIDTH_M, -10.5 - 2 * SLOT_WIDTH_M)]
    plan = GarageLayout(-50, 1.5, -13, -28, 7.3, (*left, Slot(-10.0 + 3.2, -6.3, -np.pi / 2)), (), (), (), 0)
    assert plan.slot_gaps() == pytest.approx(np.array([[-10.0 - SLOT_WIDTH_M / 2, LANE_WIDTH_M, np.pi / 2]]))


def test_no_slot_pillar_or_wall_stands_in_another_or_on_a_road(layouts):
    for layout in layouts:
        slots, stones = slot_boxes(layout), layout.solid_boxes()
        roads = np.concatenate([road_box(layout), side_road_box(layout)])
        overlaps = bev_intersection(slots, slots) - np.diag(np.diag(bev_intersection(slots, slots)))
        assert overlaps.max() < 1e-6
        assert bev_intersection(slots, stones).max() < 1e-6
        assert bev_intersection(slots, roads).max() < 1e-6
        assert bev_intersection(stones, roads).max() < 1e-6


def test_the_mast_stands_indoors_and_the_outline_is_closed(layouts):
    """Rays from the mast and from the road at eye height meet a wall within the building, whatever their direction."""
    azimuth = np.linspace(0, 2 * np.pi, 721)
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], 1)
    for layout in layouts:
        tracer, length = solids(layout), layout.road_end_x - layout.road_start_x
        for origin in ((0.0, 0.0, 7.0), (layout.road_start_x + 5, 0.0, 1.9), (layout.junction_x, -15.0, 1.9)):
            assert tracer.cast(np.array(origin), directions).distance.max() < length + 1


def exit_lane_seen_m(layout, mast_m=7.0, target_m=0.5):
    """Metres of the exiting lane's centre line, at a height, inside the roadside LiDAR's field and line of sight."""
    y = np.arange(layout.side_road_end_y, -LANE_WIDTH_M, 0.1)
    points = np.stack([np.full_like(y, layout.exit_lane_x), y, np.full_like(y, target_m)], 1)
    eye = np.array([0.0, 0.0, mast_m])
    local = (Pose.from_xyz_yaw(0, 0, mast_m, yaw=np.pi, pitch_down=np.radians(30)).inverse()).apply(points)
    azimuth = np.degrees(np.arctan2(local[:, 1], local[:, 0]))
    elevation = np.degrees(np.arctan2(local[:, 2], np.hypot(local[:, 0], local[:, 1])))
    in_field = (np.abs(azimuth) <= 60) & (elevation >= -60) & (elevation <= 30)
    return 0.1 * (in_field & ~solids(layout).occluded(eye, points - eye, 1.0)).sum()


def test_the_mast_sees_15_m_of_the_exiting_lane(layouts):
    """Specification, section 3: above 0.5 m, in every garage."""
    assert min(exit_lane_seen_m(layout) for layout in layouts) >= 15.0


def test_the_junction_is_blind_for_the_ego(layouts):
    """Solid walls and pillars alone: from 10 m before the side road, nothing deeper than 14 m can be seen in it."""
    for layout in layouts:
        eye = np.array([layout.junction_x - LANE_WIDTH_M - 10.0, layout.lane_y, 1.9])
        y = np.arange(layout.side_road_end_y + 1, -14.0, 0.25)
        deep = np.stack([np.full_like(y, layout.exit_lane_x), y, np.full_like(y, 1.0)], 1)
        assert solids(layout).occluded(eye, deep - eye, 1.0).all()


def test_ranges_are_kept(layouts):
    cfg = GarageConfig()
    for layout in layouts:
        assert cfg.road_length_m[0] <= -layout.road_start_x <= cfg.road_length_m[1]
        assert 12.0 <= -layout.junction_x <= 15.0
        assert layout.ceiling_m >= 7.2
        assert 60 <= len(layout.slots) <= 90
        assert {s.heading for s in layout.slots} == {np.pi / 2, -np.pi / 2}
        assert all(np.sign(s.y) == np.sign(s.heading) for s in layout.slots)
        assert all(0.0 <= lamp.intensity <= 1.1 and lamp.z < layout.ceiling_m for lamp in layout.lamps)


def test_every_scene_has_its_own_garage_and_every_seed_the_same(layouts):
    assert len({(a.road_start_x, a.junction_x, a.pillars[0].size, len(a.slots)) for a in layouts}) == len(layouts)
    assert draw_layout(np.random.default_rng(7)) == layouts[7]


def test_some_lamps_are_dim_or_dead(layouts):
    light = np.array([lamp.intensity for layout in layouts for lamp in layout.lamps])
    assert 0.02 < (light == 0).mean() < 0.15
    assert 0.05 < ((light > 0) & (light < 0.7)).mean() < 0.3


def test_low_ceilings_are_a_setting():
    layout = draw_layout(np.random.default_rng(0), LOW_CEILING)
    assert 3.15 <= layout.ceiling_m <= 3.35
    assert max(wall.height for wall in layout.walls) == layout.ceiling_m
    assert exit_lane_seen_m(layout, mast_m=2.8) >= 10.0


@pytest.mark.parametrize("bad", [(7.8, 7.2), 7.2, (7.2, 7.4, 7.8), ("low", "high")])
def test_ranges_that_cannot_be_are_refused(bad):
    with pytest.raises(ConfigError, match=r"GarageConfig\.ceiling_m"):
        GarageConfig(ceiling_m=bad)
