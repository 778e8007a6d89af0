"""Boxes instead of maps: three cars drawn on a floor."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.bandwidth.late_fusion import from_objects, in_roadside_range, merge, moved, to_objects
from pcdet_avp.link import cpm
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.pose import Pose

CLASSES = ("Car", "Pedestrian")
POST = SimpleNamespace(max_overlaps=[0.1, 0.1], post_max=10)


def test_the_better_of_two_boxes_upon_each_other_survives(boxes_of):
    vehicle = boxes_of((10, 0, 0.6, 1), (20, 0, 0.9, 1))
    roadside = boxes_of((10.3, 0, 0.8, 1), (30, 0, 0.7, 1), (20, 0, 0.5, 2))
    merged = merge(vehicle, roadside, POST)
    # The roadside's (10.3), the vehicle's (20), what only the roadside sees (30), and a pedestrian upon a car.
    np.testing.assert_allclose(merged.scores, [0.9, 0.8, 0.7, 0.5])
    np.testing.assert_allclose(merged.boxes[:, 0], [20, 10.3, 30, 20])
    assert merged.labels.tolist() == [1, 1, 1, 2]


def test_nothing_from_either_side_is_fine(boxes_of):
    some = boxes_of((10, 0, 0.6, 1))
    assert len(merge(boxes_of(), boxes_of(), POST).scores) == 0
    assert len(merge(some, boxes_of(), POST).scores) == len(merge(boxes_of(), some, POST).scores) == 1


def test_boxes_beyond_the_roadsides_map_are_not_its_own(boxes_of):
    """The mast stands 30 m ahead and looks back: its map of 20 m covers 10 to 30 m before the vehicle."""
    grid = BevGrid.from_range([0, -10, 0, 20, 10, 4], [1, 1, 4])
    facing = Pose.from_xyz_yaw(30.0, 0.0, yaw=np.pi).matrix
    found = boxes_of((5, 0, 0.9, 1), (12, 0, 0.8, 1), (29, 0, 0.7, 1), (35, 0, 0.6, 1), (20, 12, 0.5, 1))
    np.testing.assert_allclose(in_roadside_range(found, facing, grid).boxes[:, 0], [12, 29])


def test_what_is_merged_went_through_a_message(boxes_of):
    """By hand: x = 10.004 lies between codes 1000 and 1001, so it is read as 10.005; a length of 4.6 m as 4.55 m."""
    sent = boxes_of((10.004, -3.0, 0.876, 1), (20, 0, 0.3, 2))
    objects = to_objects(sent, CLASSES)
    assert objects["position"][0].tolist() == [1001, -300, 80]
    assert [cpm.CLASS_NAMES[kind] for kind in objects["kind"]] == list(CLASSES)
    got = from_objects(objects, CLASSES)
    np.testing.assert_allclose(got.boxes[0], [10.005, -3.005, 0.795, 4.55, 1.85, 1.55, np.radians(-0.05)], atol=1e-6)
    np.testing.assert_allclose(got.scores, [0.88, 0.3])
    assert got.labels.tolist() == [1, 2]
    assert (objects["velocity"] == cpm.VELOCITY_UNAVAILABLE).all()


def test_the_classes_of_a_configuration_may_stand_in_any_order(boxes_of):
    sent, names = boxes_of((10, 0, 0.9, 1), (20, 0, 0.3, 2)), ("Pedestrian", "Car")
    assert [cpm.CLASS_NAMES[kind] for kind in to_objects(sent, names)["kind"]] == ["Pedestrian", "Car"]
    assert from_objects(to_objects(sent, names), names).labels.tolist() == [1, 2]


def test_a_box_that_no_message_can_place_is_not_merged(boxes_of):
    sent = boxes_of((10, 0, 0.9, 1), (2000, 0, 0.8, 1))
    assert from_objects(to_objects(sent, CLASSES), CLASSES).scores.tolist() == pytest.approx([0.9])


def test_moving_there_and_back_is_nothing(boxes_of):
    """A mast 30 m ahead that looks back: what lies 10 m before the vehicle lies 20 m before the mast."""
    facing, found = Pose.from_xyz_yaw(30.0, 0.0, yaw=np.pi), boxes_of((10, 2, 0.9, 1))
    sent = moved(found, facing.inverse())
    np.testing.assert_allclose(sent.boxes[0, [0, 1, 3]], [20, -2, 4.6], atol=1e-5)
    np.testing.assert_allclose(moved(sent, facing).boxes, found.boxes, atol=1e-5)
