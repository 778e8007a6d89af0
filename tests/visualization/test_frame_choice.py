"""Which frames are worth a picture: worked out by hand on labels."""

import numpy as np
import pytest

from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.frame import AgentView, Frame, Labels
from pcdet_avp.structures.pose import Pose
from pcdet_avp.visualization.frame_choice import TellingFrame, only_roadside_sees, telling_frames

GRID = BevGrid(0.0, -20.0, -0.5, 40.0, 20.0, 3.5, 0.5)
HIDDEN, SEEN = ("Pedestrian", 0, (3, 0, 0, 9)), ("Pedestrian", 8, (400, 50, 0, 0))


def frame(frame_id, *users, x=10.0):
    """users: class, visible vertices, (ego camera, ego LiDAR, roadside camera, roadside LiDAR) hits."""
    n = len(users)
    boxes = np.tile([x, 0.0, 0.9, 0.5, 0.5, 1.8, 0.0], (n, 1)).reshape(n, 7)
    names, vertices, hits = zip(*users, strict=True)
    labels = Labels(boxes, np.array(names), np.arange(n), np.array(vertices), np.array(hits))
    view = AgentView(Pose.identity())
    return Frame(frame_id, 0.0, view, view, labels)


@pytest.mark.parametrize(
    ("hits", "expected"),
    [
        ((29, 4, 30, 0), True),  # pixels of the roadside's camera
        ((29, 4, 0, 5), True),  # points of its LiDAR
        ((30, 0, 90, 90), False),  # the vehicle's camera sees it
        ((0, 5, 90, 90), False),  # the vehicle's LiDAR does
        ((0, 0, 29, 4), False),  # nobody does
    ],
)
def test_what_only_the_roadside_sees(hits, expected):
    labels = frame("0/0", ("Car", 0, hits)).labels
    assert only_roadside_sees(labels).tolist() == [expected]


def test_a_frame_needs_both_hidden_pedestrians_and_something_to_see():
    frames = [
        frame("0/0", *[HIDDEN] * 6),  # the vehicle faces a wall
        frame("1/0", HIDDEN, *[SEEN] * 9),
        frame("2/0", *[HIDDEN] * 3, *[SEEN] * 3),
        frame("3/0", HIDDEN, *[SEEN] * 4),
        frame("4/0", *[SEEN] * 12),  # nobody is hidden
    ]
    found = telling_frames(frames, GRID, 4)
    assert found[:3] == [TellingFrame("2/0", 3, 3), TellingFrame("1/0", 1, 9), TellingFrame("3/0", 1, 4)]
    assert found[3].frame_id == "4/0"


def test_of_a_scene_one_frame_is_shown_and_of_equals_the_first():
    frames = [frame(name, HIDDEN, SEEN) for name in ("1/1", "1/0", "0/3", "0/2")]
    assert [chosen.frame_id for chosen in telling_frames(frames, GRID, 5)] == ["0/2", "1/0"]


def test_hidden_cars_and_people_beyond_the_range_do_not_count():
    hidden_car = ("Car", 0, (0, 0, 200, 90))
    assert TellingFrame.of(frame("0/0", hidden_car, SEEN), GRID) == TellingFrame("0/0", 0, 1)
    assert TellingFrame.of(frame("0/0", HIDDEN, SEEN, x=50.0), GRID) == TellingFrame("0/0", 0, 0)
