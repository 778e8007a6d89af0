"""Frames and detections at the door of the metrics: what is understood, what is refused."""

import numpy as np
import pytest

from pcdet_avp.errors import EvaluationError, GeometryError
from pcdet_avp.evaluation import (
    Detections,
    GroundTruth,
    Region,
    evaluate,
)
from pcdet_avp.evaluation.inputs import wedge_rows
from pcdet_avp.structures.camera import AGENT_FROM_OPTICAL, PinholeCamera
from pcdet_avp.structures.frame import Labels
from pcdet_avp.structures.pose import Pose

REGIONS = (Region.camera_fov(apex_x_m=0.5), Region.full_range())


def test_annotations_of_openpcdet_are_understood_and_empty_ones_too():
    annotation = {
        "frame_id": "a/1",
        "boxes_lidar": np.ones((2, 7), np.float32),
        "name": ["Car", "Car"],
        "score": [1, 0],
    }
    assert Detections.from_annotation(annotation).scores.tolist() == [1.0, 0.0]
    none = {"frame_id": "a/1", "boxes_lidar": np.zeros((0, 7)), "name": np.array([]), "score": np.array([])}
    truth = GroundTruth.from_labels("a/1", Labels.empty())
    assert np.isnan(evaluate([truth], [Detections.from_annotation(none)], REGIONS)[1]["Car_overall_0.7"])


def test_bad_detections_are_refused_with_the_frame_they_came_in():
    with pytest.raises(EvaluationError, match=r"'a/7'.*NaN"):
        Detections("a/7", np.ones((1, 7)), np.array(["Car"]), np.array([np.nan]))
    with pytest.raises(GeometryError, match=r"'a/7'.*NaN"):
        Detections("a/7", np.full((1, 7), np.nan), np.array(["Car"]), np.array([0.5]))
    with pytest.raises(EvaluationError, match=r"'a/7'.*2 rows"):
        Detections("a/7", np.ones((1, 7)), np.array(["Car", "Car"]), np.array([0.5]))


def test_lists_and_bytes_mean_what_arrays_mean():
    """A list of names compared with a name is False as a whole: everything would be missed in silence."""
    box, far = [10.0, 0, 1, 4, 2, 1.5, 0], [30.0, 0, 1, 4, 2, 1.5, 7.0]
    truth = GroundTruth("a/1", [box, far], ["Car", "Car"], [0, 1])
    for names in (["Car", "Car"], np.array([b"Car", b"Car"]), np.array(["Car", "Car"], object)):
        found = Detections("a/1", [box, far], names, [1, 0.5])
        assert evaluate([truth], [found], REGIONS)[1]["Car_overall_0.7"] == 100.0
    nothing = Detections("a/1", [], [], [])
    assert evaluate([truth], [nothing], REGIONS)[1]["Car_overall_0.7"] == 0.0


def test_numbers_for_names_and_difficulties_that_there_are_not_are_refused():
    with pytest.raises(EvaluationError, match=r"'a/1': names: expected class names, found int64"):
        Detections("a/1", np.ones((1, 7)), [1], [0.5])
    for wrong in (-1, 3, 0.5):  # KITTI calls an unknown difficulty -1
        with pytest.raises(EvaluationError, match=r"'a/1': difficulty: expected 0 \(easy\), 1 \(hard\), 2 \(invis"):
            GroundTruth("a/1", np.ones((1, 7)), ["Car"], [wrong])


def camera(yaw=0.0, x=0.5, y=0.0, width=640, fx=320.0, cx=320.0, pitch_down=0.0):
    mount = Pose.from_xyz_yaw(x, y, 1.8, yaw, pitch_down)
    optical = np.eye(4)
    optical[:3, :3] = AGENT_FROM_OPTICAL
    return PinholeCamera(width, 360, fx, fx, cx, 180.0, mount @ Pose(optical))


CAMERAS = {
    "ahead": camera(),
    "left": camera(np.pi / 2),
    "backwards": camera(np.pi, x=-2.0),
    "half to the right, beside the axis": camera(-np.pi / 4, y=-0.9),
    "narrow": camera(fx=1000.0),
    "principal point off centre": camera(0.3, cx=100.0),
    "across the cut of the angle": camera(3.1),
    "pitched": camera(0.4, pitch_down=0.2),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_a_wedge_holds_what_projects_between_the_images_edges(name):
    """Independent: points at the camera's own optical height line are projected by the pin-hole itself."""
    cam = CAMERAS[name]
    rng = np.random.default_rng(0)
    points = np.c_[rng.uniform(-40, 40, (4000, 2)), np.full(4000, 1.8)]
    if name == "pitched":  # a wedge is that of the same camera held level
        cam_level = camera(0.4)
    else:
        cam_level = cam
    uv, depth = cam_level.project(points)
    with np.errstate(invalid="ignore"):
        seen = (depth > 0) & (uv[:, 0] >= 0) & (uv[:, 0] <= cam.width)
    truth = GroundTruth.from_labels("a/1", Labels.empty(), cam)
    found = Region.own_camera_fov().contains(points, np.repeat(wedge_rows([truth]), len(points), 0))
    assert np.array_equal(found, seen)
    assert 0 < seen.sum() < 2000


def test_a_camera_that_looks_ahead_gives_bit_by_bit_the_region_of_all_frames():
    rng = np.random.default_rng(1)
    points = rng.uniform(-40, 40, (20000, 3))
    edge = np.c_[np.arange(0.5, 20, 0.5), np.abs(np.arange(0.5, 20, 0.5) - 0.5), np.zeros(39)]
    points = np.r_[points, edge, edge * [1, -1, 1]]
    cam = PinholeCamera.looking_ahead(960, 540, np.radians(90), 0.5, 1.8)
    hfov = 2 * np.arctan(cam.width / 2 / cam.fx)
    truth = GroundTruth.from_labels("a/1", Labels.empty(), cam)
    own = Region.own_camera_fov().contains(points, wedge_rows([truth]))
    bearing = np.arctan2(points[:, 1], points[:, 0] - float(cam.agent_from_camera.translation[0]))
    assert np.array_equal(own, np.abs(bearing) <= hfov / 2)
    assert np.array_equal(own, Region.camera_fov(0.5, hfov).contains(points))


def test_frames_without_a_camera_count_nothing_in_its_view_and_all_without_one_are_refused():
    car = np.array([[10.0, 0, 0.8, 4.5, 1.9, 1.6, 0]])
    labels = Labels(car, np.array(["Car"]), np.array([1]), np.array([8]), np.zeros((1, 4), int))
    truths = [GroundTruth.from_labels(f"a/{i}", labels, cam) for i, cam in enumerate((camera(), None))]
    found = [
        Detections("a/0", car, np.array(["Car"]), np.ones(1)),
        Detections("a/1", car[:0], np.array([], str), np.zeros(0)),
    ]
    numbers = evaluate(truths, found, [Region.own_camera_fov(), Region.full_range()])[1]
    assert (numbers["Car_overall_0.7"], numbers["full_range/Car_overall_0.7"]) == (100.0, 50.0)
    with pytest.raises(EvaluationError, match="no frame's ground truth says where its camera looks"):
        evaluate(truths[1:], found[1:], [Region.own_camera_fov()])
    with pytest.raises(EvaluationError, match="needs each frame's camera"):
        Region.own_camera_fov().contains(car)
