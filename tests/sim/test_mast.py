"""GENERATE.MAST: the roadside unit's pose is drawn per scene, and everything that is recorded agrees with it."""

import copy
from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.config import load_config
from pcdet_avp.config_check import check_values
from pcdet_avp.config_scenes import scene_config
from pcdet_avp.datasets.avp import transforms
from pcdet_avp.datasets.avp.prepare import PrepareConfig, prepare
from pcdet_avp.datasets.avp.record import read_frame
from pcdet_avp.errors import ConfigError
from pcdet_avp.generate import SceneJob, make_scene, plan
from pcdet_avp.sim.layouts import draw_layout
from pcdet_avp.sim.mast import draw_mast, under_ceiling
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.scene_config import GarageConfig, MastConfig
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SOURCES

CFGS = Path(__file__).parents[2] / "cfgs" / "dataset_configs"
ANY = load_config(CFGS / "avp_any_mast.yaml")
SCENE = 5


def tiny():
    """avp_any_mast with the tests' small sensors, those of the roadside alone, and one frame a scene, so that it is
    quick."""
    cfg, small = copy.deepcopy(ANY), load_config(CFGS / "avp_tiny.yaml")
    for key in ("SENSORS", "IMAGE_SHAPE", "VOXEL_SIZE"):
        cfg[key] = small[key]
    cfg.GENERATE.FRAMES_PER_SCENE, cfg.GENERATE.SOURCES = 1, ["infra_camera", "infra_lidar"]
    cfg.GENERATE.SCENE.OCCUPANCY = [0.4, 0.4]
    return cfg


def draw(number, generate, seed=4001):
    rng = np.random.default_rng(np.random.SeedSequence([seed, number]))
    return draw_training_scene(rng, scene_config(generate))


@pytest.fixture(scope="module")
def units():
    return [draw_mast(np.random.default_rng(seed), MastConfig()) for seed in range(400)]


@pytest.fixture(scope="module")
def unit():
    """The unit of the scene of ``frame``."""
    return draw(SCENE, tiny().GENERATE).world.unit


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    """One frame as it is recorded and read."""
    root, manifest = tmp_path_factory.mktemp("any_mast"), plan(tiny())
    scene = manifest.scenes[SCENE]
    make_scene(SceneJob(str(root), SCENE, scene, manifest.seed, manifest.generator))
    return read_frame(root, scene.frame_ids[0])


def in_unit(unit, points):
    """World points (N, 3) along the axes of the unit's sensors (right, down, forward), by plain trigonometry."""
    x, y, z = (np.asarray(points, float) - [unit.x_m, unit.y_m, unit.z_m]).T
    ahead = np.cos(unit.yaw_rad) * x + np.sin(unit.yaw_rad) * y
    left = np.cos(unit.yaw_rad) * y - np.sin(unit.yaw_rad) * x
    sine, cosine = np.sin(unit.pitch_down_rad), np.cos(unit.pitch_down_rad)
    return np.stack([-left, -ahead * sine - z * cosine, ahead * cosine - z * sine], 1)


def test_every_pose_lies_in_the_ranges_and_the_ranges_are_used(units):
    heights, pitches, yaws, offsets = np.array(
        [(u.z_m, np.degrees(u.pitch_down_rad), np.degrees(u.yaw_rad) - 180, u.y_m) for u in units]
    ).T
    for values, (low, high) in (
        (heights, ANY.GENERATE.MAST.HEIGHT_M),
        (pitches, ANY.GENERATE.MAST.PITCH_DOWN_DEG),
        (yaws, ANY.GENERATE.MAST.YAW_DEG),
        (offsets, ANY.GENERATE.MAST.OFFSET_M),
    ):
        assert low <= values.min() < low + 0.1 * (high - low)
        assert high >= values.max() > high - 0.1 * (high - low)
    aims = heights / np.tan(np.radians(pitches))
    assert 5 <= aims.min() < aims.max() <= 60
    assert np.degrees(np.arctan(2.3 / 5)) == pytest.approx(24.7, abs=0.01)  # the steepest that hangs lowest
    assert pitches[heights < 2.5].max() < np.degrees(np.arctan(2.5 / 5))
    assert {u.x_m for u in units} == {0.0}


def test_one_generator_one_pose(units):
    assert draw_mast(np.random.default_rng(7), MastConfig()) == units[7]
    assert len(set(units)) == len(units)


def test_the_ceiling_hangs_a_little_above_the_unit_and_never_below_a_van(units):
    for unit in units[:60]:
        layout = draw_layout(np.random.default_rng(1), under_ceiling(GarageConfig(), unit, MastConfig()))
        assert max(2.9, unit.z_m + 0.2) <= layout.ceiling_m <= max(2.9, unit.z_m + 0.6)
        assert layout.ceiling_m > unit.z_m + 0.19
        assert all(lamp.z < layout.ceiling_m for lamp in layout.lamps)


NOBODY = {key: [0, 0] for key in ("IN_GAP", "CROSSING", "ALONG", "ON_SIDE_ROAD", "SAME_LANE", "OPPOSITE_LANE")}
EMPTY = {**ANY.GENERATE, "SCENE": {**ANY.GENERATE.SCENE, **NOBODY, "OCCUPANCY": [0.0, 0.0]}}


def test_all_but_unit_and_ceiling_is_the_scene_of_a_fixed_mast():
    drawn, fixed = (draw(SCENE, {**ANY.GENERATE, "MAST": mast}).seek(0) for mast in (ANY.GENERATE.MAST, None))
    np.testing.assert_array_equal(drawn.road_users().boxes, fixed.road_users().boxes)
    np.testing.assert_array_equal(drawn.world_from_ego.matrix, fixed.world_from_ego.matrix)
    assert (drawn.layout.slots, drawn.layout.pillars) == (fixed.layout.slots, fixed.layout.pillars)
    assert drawn.lighting.exposure == fixed.lighting.exposure
    assert fixed.unit is None
    assert drawn.layout.ceiling_m != fixed.layout.ceiling_m


def test_one_garage_has_one_mast():
    worlds = [draw(number, {**EMPTY, "GARAGE_SEED": 7}).world for number in range(3)]
    assert len({world.unit for world in worlds}) == 1
    assert draw(0, {**EMPTY, "GARAGE_SEED": 8}).world.unit != worlds[0].unit


def test_a_known_point_is_seen_where_a_pinhole_at_the_drawn_pose_sees_it(frame, unit):
    """192 pixels at 90 degrees: f = 96. The vehicle's middle on the floor, and points around it."""
    world = frame.ego.world_from_agent.translation + np.array([[0, 0, 0], [-3, 1, 0.5], [2, -1.5, 1.5]])
    right, down, forward = in_unit(unit, world).T
    uv, depth = frame.infra.camera.project(frame.infra.world_from_agent.inverse().apply(world))
    np.testing.assert_allclose(uv, np.stack([96 + 96 * right / forward, 54 + 96 * down / forward], 1), atol=1e-6)
    np.testing.assert_allclose(depth, forward, atol=1e-9)
    network = prepare(frame, SENSOR_SETS["CL+CL"], PrepareConfig.from_config(tiny(), ["Car", "Pedestrian"]))
    in_ego = np.c_[frame.ego.world_from_agent.inverse().apply(world), np.ones(3)]
    in_infra = in_ego @ np.linalg.inv(network["ego_from_infra"].astype(float)).T
    pixels = network["trans_cam_to_img_infra"] @ network["trans_lidar_to_cam_infra"] @ in_infra.T
    np.testing.assert_allclose((pixels[:2] / pixels[2]).T, uv, atol=0.01)


def test_every_pixel_s_depth_ends_on_the_floor_or_above_it(frame, unit):
    """Backwards through the same pinhole; a pose that is off by a degree would put the floor at 20 m 35 cm too low."""
    rows, columns = np.nonzero(frame.infra.depth)
    depth = frame.infra.depth[rows, columns].astype(float)
    right, down = (columns + 0.5 - 96) / 96 * depth, (rows + 0.5 - 54) / 96 * depth
    height = unit.z_m - down * np.cos(unit.pitch_down_rad) - depth * np.sin(unit.pitch_down_rad)
    assert len(right) > 0.5 * frame.infra.depth.size
    assert height.min() > -0.02
    assert (np.abs(height) < 0.02).mean() > 0.15


def test_points_of_the_roadside_lie_in_the_labels_of_the_ego(frame, unit):
    """Each car's box, in the ego frame, holds as many of the unit's points as the simulator counted on the car."""
    points = np.c_[frame.infra.points[:, :3], np.ones(len(frame.infra.points))].astype(float)
    in_ego = (points @ frame.ego_from_infra.matrix.T)[:, :3]
    labels, column = frame.labels, SOURCES.index("infra_lidar")
    seen = (labels.hit_counts[:, column] >= 10) & (labels.names == "Car")
    assert seen.sum() >= 3
    for box, hits in zip(labels.boxes[seen], labels.hit_counts[seen, column], strict=True):
        x, y, z = (in_ego - box[:3]).T
        along, aside = np.cos(box[6]) * x + np.sin(box[6]) * y, np.cos(box[6]) * y - np.sin(box[6]) * x
        beyond = np.abs(np.stack([along, aside, z], 1)) - box[3:6] / 2
        inside = (beyond < 0.02).all(1)
        assert inside.sum() >= hits
    origin = frame.infra.world_from_agent
    np.testing.assert_allclose(origin.translation, [0, unit.y_m, 0], atol=1e-9)
    assert np.cos(origin.yaw - unit.yaw_rad) == pytest.approx(1)


def test_augmentation_keeps_both_agents_together(frame):
    """Seen from the ego, the unit's cloud mirrors with the garage, and stays when the unit's frame turns."""
    before, pixels = cloud_in_ego(frame), pixels_of_cloud(frame)
    flipped, turned = transforms.flip(frame), transforms.rotate_agent(frame, "infra", 0.05)
    np.testing.assert_allclose(cloud_in_ego(flipped), before * [1, -1, 1], atol=1e-4)
    np.testing.assert_allclose(cloud_in_ego(turned), before, atol=1e-4)
    np.testing.assert_allclose(pixels_of_cloud(flipped), pixels * [-1, 1] + [192, 0], atol=0.01)
    np.testing.assert_allclose(pixels_of_cloud(turned), pixels, atol=0.01)
    assert not np.allclose(turned.infra.points, frame.infra.points, atol=0.01)


def cloud_in_ego(frame):
    return frame.ego_from_infra.apply(frame.infra.points[:, :3].astype(float))


def pixels_of_cloud(frame):
    """Those of the points at least 2 m before the camera."""
    uv, depth = frame.infra.camera.project(frame.infra.points[:, :3].astype(float))
    return uv[depth > 2]


@pytest.mark.parametrize(
    ("key", "value", "what"),
    [
        ("HEIGHT_M", [7.0, 2.3], r"MastConfig\.height_m: expected \(low, high\)"),
        ("AIM_M", [5.0, 8.0], r"at a height of 2\.3 m no pitch .* within aim_m \(5\.0, 8\.0\)"),
        ("CEILING_ABOVE_M", [0.0, 0.5], r"MastConfig\.ceiling_above_m: expected numbers above 0"),
        ("HIGHT_M", [2.3, 7.0], r"GENERATE\.MAST: unknown key 'HIGHT_M'; known: HEIGHT_M"),
    ],
)
def test_impossible_ranges_are_refused(key, value, what):
    generate = copy.deepcopy(ANY.GENERATE)
    generate.MAST[key] = value
    if key == "AIM_M":
        generate.MAST.PITCH_DOWN_DEG = [30.0, 45.0]
    with pytest.raises(ConfigError, match=what):
        scene_config(generate)


def test_wrong_kinds_of_values_and_a_mast_on_a_plan_are_refused():
    cfg = copy.deepcopy(ANY)
    check_values(cfg)
    cfg.GENERATE.MAST.PITCH_DOWN_DEG = [5.0, 95.0]
    with pytest.raises(ConfigError, match=r"MAST\.PITCH_DOWN_DEG: expected a list of 2, each degrees from -90 to 90"):
        check_values(cfg)
    with pytest.raises(ConfigError, match="expected PLAN or MAST, found both"):
        scene_config({**ANY.GENERATE, "PLAN": "cfgs/plans/paper_road.yaml"})
    assert scene_config({**ANY.GENERATE, "MAST": None}).mast is None
