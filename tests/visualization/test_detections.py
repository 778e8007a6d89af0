"""Pictures of detections: what is drawn lies where it should."""

import numpy as np

from pcdet_avp.evaluation.inputs import Detections
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.frame import AgentView, Frame
from pcdet_avp.structures.pose import Pose
from pcdet_avp.visualization.detections import bev_panel, class_colors, comparison
from pcdet_avp.visualization.draw import camera_panel
from pcdet_avp.visualization.palette import CLASS_COLORS

GRID = BevGrid(0.0, -20.0, -0.5, 40.0, 20.0, 3.5, 0.5)
CAMERA = PinholeCamera.looking_ahead(160, 90, np.pi / 2, 0.0, 1.8, 0.0)
CAR = np.array([[20.0, 5.0, 0.8, 4.0, 2.0, 1.6, 0.0]])
FOUND = Detections("s/0", CAR, np.array(["Car"]), np.array([0.9]))
NOTHING = FOUND.select(np.array([False]))


def _frame(points=None):
    ego = AgentView(Pose.identity(), CAMERA, np.zeros((90, 160, 3), np.uint8), None, points)
    return Frame("s/0", 0.0, ego, AgentView(Pose.from_xyz_yaw(40.0, 0.0, yaw=np.pi)))


def _pixels(image, color):
    """Rows and columns that have nearly this colour."""
    return np.nonzero(np.abs(image.astype(int) - color).max(-1) < 40)


def test_a_detection_lies_at_its_metres_in_the_view_from_above():
    image = bev_panel(_frame(), FOUND, GRID, "t", width=430)  # 43 m, 10 pixels each
    rows, columns = _pixels(image, CLASS_COLORS["Car"])
    assert abs((rows.min() + rows.max()) / 2 - (20 - 5) * 10) <= 2
    assert abs((columns.min() + columns.max()) / 2 - (3 + 20) * 10) <= 2
    assert abs(columns.max() - columns.min() - 40) <= 4


def test_a_detection_lies_at_its_pixels_in_the_camera():
    image = camera_panel(_frame().ego, CAR, class_colors(FOUND.names), "t", width=160)
    _, columns = _pixels(image, CLASS_COLORS["Car"])
    # Nearest and farthest edge: 80 - 80 * y / x for y = 6 at x = 18 and y = 4 at x = 22, focal length 80 px.
    assert abs(columns.min() - (80 - 80 * 6 / 18)) <= 2
    assert abs(columns.max() - (80 - 80 * 4 / 22)) <= 2


def test_only_the_clouds_that_were_used_are_shown():
    cloud = np.random.default_rng(0).uniform([10, -10, 0, 0], [30, 10, 1, 1], (5000, 4)).astype(np.float32)
    light = [bev_panel(_frame(points), NOTHING, GRID, "", width=430).mean() for points in (None, cloud)]
    assert light[1] > light[0] + 1


def test_a_comparison_has_the_cameras_above_and_every_result_below():
    results = {"alone": (_frame(), NOTHING), "together": (_frame(), FOUND)}
    image = comparison(_frame(), GRID, results)
    assert image.shape[1] == 1600
    left, right = image[450:, :800], image[450:, 800:]
    assert len(_pixels(right, CLASS_COLORS["Car"])[0]) > len(_pixels(left, CLASS_COLORS["Car"])[0]) == 0


def test_an_unknown_class_has_a_colour_too():
    assert class_colors(np.array(["Truck", "Car"])).shape == (2, 3)
    assert class_colors(np.array([], str)).shape == (0, 3)
