"""Pictures of misses: every object in the colour of its kind, at its metres."""

import numpy as np

from pcdet_avp.evaluation.error_kinds import OBJECT_KINDS
from pcdet_avp.evaluation.inputs import Detections
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.frame import AgentView, Frame, Labels
from pcdet_avp.structures.pose import Pose
from pcdet_avp.visualization.misses import KIND_COLORS, LEGEND_PX, miss_picture

GRID = BevGrid(0.0, -20.0, -0.5, 40.0, 20.0, 3.5, 0.5)
X_M = (8.0, 16.0, 24.0)  # three cars on the axis, the last of them not counted
BOXES = np.array([[x, 0.0, 0.8, 4.0, 2.0, 1.6, 0.0] for x in X_M])


def picture(kinds):
    labels = Labels(BOXES, np.full(3, "Car"), np.arange(3), np.zeros(3, int), np.zeros((3, 4), int))
    camera = PinholeCamera.looking_ahead(160, 90, np.pi / 2, 0.0, 1.8, 0.0)
    ego = AgentView(Pose.identity(), camera, np.zeros((90, 160, 3), np.uint8))
    frame = Frame("s/0", 0.0, ego, AgentView(Pose.from_xyz_yaw(40.0, 0.0, yaw=np.pi)), labels)
    nothing = Detections("s/0", np.zeros((0, 7)), np.zeros(0, str), np.zeros(0))
    return miss_picture(frame, GRID, "t", nothing, {"Car": np.array(kinds)})[:-LEGEND_PX, 800:]


def test_objects_have_the_colour_of_their_kind():
    misplaced, not_found = (OBJECT_KINDS.index(kind) for kind in ("misplaced", "not found"))
    image, px_per_m = picture([misplaced, not_found, -1]), 800 / 43
    for kind, x_m in ((misplaced, X_M[0]), (not_found, X_M[1])):
        columns = np.nonzero(np.abs(image.astype(int) - KIND_COLORS[kind]).max(-1) < 30)[1]
        assert abs((columns.min() + columns.max()) / 2 - (3 + x_m) * px_per_m) <= 3
        assert abs(np.ptp(columns) - 4 * px_per_m) <= 5


def test_what_is_not_counted_has_no_colour():
    image = picture([-1, -1, -1])[40:].astype(int)  # below the title
    assert np.ptp(image, axis=-1).max() < 12
