"""Boxes instead of maps: three cars drawn on a floor."""

from types import SimpleNamespace

import numpy as np

from pcdet_avp.bandwidth.late_fusion import in_roadside_range, merge, message_bytes
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.pose import Pose

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


def test_size_of_the_message():
    assert message_bytes(0) == 121
    assert message_bytes(20) == 821
