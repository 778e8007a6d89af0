"""A sample has every key whatever sensors there are; its numbers follow by hand from the frame."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.prepare import PrepareConfig, prepare
from pcdet_avp.errors import ConfigError, RecordError, SensorError
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import box_corners
from pcdet_avp.structures.frame import AgentView
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SensorSet

GRID = BevGrid(0.0, -30.08, -0.5, 44.8, 30.08, 3.5, 0.64)
CONFIG = PrepareConfig(GRID, image_shape=(36, 64))
ALL = SENSOR_SETS["CL+CL"]


@pytest.mark.parametrize("name", SENSOR_SETS)
def test_every_combination_has_the_same_keys_shapes_and_types(make_frame, name):
    full = prepare(make_frame(), ALL, CONFIG)
    sample = prepare(make_frame(), SENSOR_SETS[name], CONFIG)
    assert list(sample) == list(full)
    assert tuple(sample["source_present"]) == SENSOR_SETS[name].mask
    for key, value in full.items():
        if isinstance(value, np.ndarray):
            assert sample[key].dtype == value.dtype, key
            if not key.startswith("points"):
                assert sample[key].shape == value.shape, key


def test_an_absent_sensor_leaves_zeros_and_no_points_but_keeps_the_calibration(make_frame):
    sample, full = (prepare(make_frame(), SENSOR_SETS[name], CONFIG) for name in ("C+none", "CL+CL"))
    assert sample["points"].shape == (0, 4)
    assert sample["points_infra"].shape == (0, 4)
    assert not sample["images_infra"].any()
    assert not sample["depth_maps_infra"].any()
    np.testing.assert_array_equal(sample["images"], full["images"])
    for key in ("trans_lidar_to_cam_infra", "trans_cam_to_img_infra", "ego_from_infra", "gt_boxes"):
        np.testing.assert_array_equal(sample[key], full[key])


def test_a_sensor_that_the_frame_lacks_is_absent(make_frame):
    frame = make_frame()
    bare = replace(frame, infra=AgentView(frame.infra.world_from_agent))
    sample = prepare(bare, ALL, CONFIG)
    assert sample["source_present"].tolist() == [True, True, False, False]
    np.testing.assert_array_equal(sample["trans_lidar_to_cam_infra"], np.eye(4))


def test_no_sensor_at_all_is_an_error(make_frame):
    frame = make_frame()
    blind = replace(frame, ego=AgentView(frame.ego.world_from_agent))
    with pytest.raises(SensorError, match=r"scene_0000/000000: none of the sensors"):
        prepare(blind, SENSOR_SETS["CL+none"], CONFIG)
    with pytest.raises(SensorError, match="none of the sensors"):
        prepare(frame, SensorSet(False, False, False, False), CONFIG)


def test_points_outside_the_range_are_dropped_and_the_rest_keep_their_order(make_frame):
    points = np.array(
        [
            [0, 0, 0, 0.1],
            [44.9, 0, 0, 0.2],
            [20, 30.2, 0, 0.3],
            [20, -30, 3.6, 0.4],
            [20, -30, 3.4, 0.5],
            [-1, 0, 0, 0.6],
        ],
        np.float32,
    )
    frame = make_frame()
    sample = prepare(replace(frame, ego=replace(frame.ego, points=points)), ALL, CONFIG)
    np.testing.assert_array_equal(sample["points"], points[[0, 4]])


@given(points=hnp.arrays(np.float32, (30, 4), elements=st.floats(-60, 60, width=32)))
@settings(max_examples=40, deadline=None)
def test_cropping_agrees_with_the_grid(make_frame, points):
    frame = make_frame()
    sample = prepare(replace(frame, infra=replace(frame.infra, points=points)), ALL, CONFIG)
    np.testing.assert_array_equal(sample["points_infra"], points[GRID.contains(points)])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_no_number_is_refused(make_frame, value):
    frame = make_frame()
    points = frame.ego.points.copy()
    points[5, 3] = value
    with pytest.raises(RecordError, match=r"frame scene_0000/000000: ego points: hold NaN or infinite"):
        prepare(replace(frame, ego=replace(frame.ego, points=points)), ALL, CONFIG)


def test_intensity_can_be_left_out(make_frame):
    config = replace(CONFIG, point_features=3)
    assert prepare(make_frame(), ALL, config)["points"].shape[1] == 3
    assert prepare(make_frame(), SENSOR_SETS["C+none"], config)["points"].shape == (0, 3)


def test_the_matrices_project_as_the_camera_does(make_frame):
    frame = make_frame()
    sample = prepare(frame, ALL, CONFIG)
    corners = box_corners(frame.labels.boxes)[0]
    for suffix, camera in (("", frame.ego.camera), ("_infra", frame.infra.camera)):
        homogeneous = np.concatenate([corners, np.ones((8, 1))], 1)
        image = homogeneous @ sample[f"trans_lidar_to_cam{suffix}"].T @ sample[f"trans_cam_to_img{suffix}"].T
        uv, depth = camera.project(corners)
        np.testing.assert_allclose(image[:, 2], depth, atol=1e-4)
        ahead = depth > 0
        np.testing.assert_allclose(image[ahead, :2] / image[ahead, 2:], uv[ahead], atol=1e-3)


def test_a_resized_image_takes_its_calibration_along(make_frame):
    frame = make_frame()
    image = np.zeros((36, 64, 3), np.uint8)
    image[18:20, 40:42] = 255  # one pixel after halving: row 9, column 20
    small = prepare(replace(frame, ego=replace(frame.ego, image=image)), ALL, replace(CONFIG, image_shape=(18, 32)))
    assert small["images"].shape == (18, 32, 3)
    assert small["images"][9, 20].tolist() == [1, 1, 1]
    assert small["images"].sum() == 3
    full = prepare(frame, ALL, CONFIG)
    np.testing.assert_allclose(small["trans_cam_to_img"][:2], full["trans_cam_to_img"][:2] / 2)
    assert small["image_shape"].tolist() == [18, 32]


def test_depth_is_the_nearest_known_one_of_each_block(make_frame):
    frame = make_frame()
    depth = np.zeros((36, 64), np.float32)
    depth[0, 0], depth[3, 3], depth[4, 0] = 9.0, 5.0, 7.0
    maps = prepare(replace(frame, ego=replace(frame.ego, depth=depth)), ALL, CONFIG)["depth_maps"]
    assert maps.shape == (9, 16)
    assert maps[0, 0] == 5.0
    assert maps[1, 0] == 7.0
    assert np.count_nonzero(maps) == 2


def test_a_depth_map_of_an_uneven_image_is_rounded_up(make_frame):
    frame = make_frame()
    depth = np.full((36, 64), 3.0, np.float32)
    depth[35] = 2.0
    config = replace(CONFIG, depth_downsample=5)
    maps = prepare(replace(frame, ego=replace(frame.ego, depth=depth)), ALL, config)["depth_maps"]
    assert maps.shape == config.depth_shape == (8, 13)
    assert (maps[7] == 2.0).all()
    assert (maps[:7] == 3.0).all()


def test_a_depth_map_is_resized_without_mixing(make_frame):
    frame = make_frame()
    depth = np.where(np.arange(64) < 32, 4.0, 20.0).astype(np.float32)[None].repeat(36, 0)
    config = replace(CONFIG, image_shape=(54, 96))
    maps = prepare(replace(frame, ego=replace(frame.ego, depth=depth)), ALL, config)["depth_maps"]
    assert set(np.unique(maps)) == {4.0, 20.0}


def test_a_pixel_of_a_resized_depth_map_is_the_one_under_its_centre(make_frame):
    """A third of the size: a new pixel covers three old ones a side, and its centre lies in the middle one."""
    frame = make_frame()
    depth = (1.0 + np.arange(63) + 100.0 * np.arange(36)[:, None]).astype(np.float32)
    config = replace(CONFIG, image_shape=(12, 21), depth_downsample=1)
    maps = prepare(replace(frame, ego=replace(frame.ego, depth=depth)), ALL, config)["depth_maps"]
    np.testing.assert_array_equal(maps, depth[1::3, 1::3])


def test_ground_truth_holds_what_is_in_range_and_wanted(make_frame):
    boxes = prepare(make_frame(), ALL, CONFIG)["gt_boxes"]  # a car, a pedestrian, and a car at x = 80
    np.testing.assert_allclose(boxes[:, [0, 1, 7]], [[12, 3, 1], [8, -4, 2]])
    pedestrians = prepare(make_frame(), ALL, replace(CONFIG, class_names=("Pedestrian",)))["gt_boxes"]
    np.testing.assert_allclose(pedestrians[:, [0, 1, 7]], [[8, -4, 1]])
    assert prepare(make_frame(), ALL, replace(CONFIG, grid=BevGrid(0, -1, 0, 1, 1, 1, 1)))["gt_boxes"].shape == (0, 8)


def test_preparing_changes_nothing_in_the_frame(make_frame):
    frame, untouched = make_frame(), make_frame()
    sample = prepare(frame, ALL, CONFIG)
    for key in ("points", "images", "gt_boxes", "ego_from_infra"):
        sample[key][...] = 7
    np.testing.assert_array_equal(frame.ego.points, untouched.ego.points)
    np.testing.assert_array_equal(frame.labels.boxes, untouched.labels.boxes)


WRONG = [
    ({"IMAGE_SHAPE": [540]}, r"IMAGE_SHAPE: expected \[rows, columns\], found \[540\]"),
    ({"DEPTH_DOWNSAMPLE": 0}, r"DEPTH_DOWNSAMPLE: expected 1 or more, found 0"),
    (
        {"POINT_FEATURE_ENCODING": {"used_feature_list": ["x", "y"]}},
        r"used_feature_list: expected .* found \['x', 'y'\]",
    ),
]


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_a_wrong_configuration_is_refused(change, message):
    good = {
        "POINT_CLOUD_RANGE": list(GRID.range),
        "VOXEL_SIZE": [0.64, 0.64, 4.0],
        "IMAGE_SHAPE": [36, 64],
        "DEPTH_DOWNSAMPLE": 4,
        "POINT_FEATURE_ENCODING": {"used_feature_list": ["x", "y", "z"]},
    }
    assert PrepareConfig.from_config(good, ["Car"]).point_features == 3
    with pytest.raises(ConfigError, match=message):
        PrepareConfig.from_config({**good, **change}, ["Car"])
    with pytest.raises(ConfigError, match=r"CLASS_NAMES: expected different ones of Car, Pedestrian, found \['Bus'\]"):
        PrepareConfig.from_config(good, ["Bus"])


@pytest.mark.parametrize("name", ["avp_full", "avp_small", "avp_tiny"])
def test_the_shipped_configurations_make_a_prepare_config(name, request):
    cfg = load_config(request.config.rootpath / "cfgs" / "dataset_configs" / f"{name}.yaml")
    config = PrepareConfig.from_config(cfg, ["Car", "Pedestrian"])
    assert config.depth_shape == {"avp_full": (135, 240), "avp_small": (68, 120), "avp_tiny": (27, 48)}[name]
