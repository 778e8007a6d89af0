"""Shares counted by hand on a frame of four objects."""

import numpy as np
import pytest

from pcdet_avp.datasets.avp.statistics import Statistics
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.frame import AgentView, Frame, Labels
from pcdet_avp.structures.pose import Pose

GRID = BevGrid(0, -30.08, -0.5, 44.8, 30.08, 3.5, 0.32)


def frame_of(rows):
    """rows: (x, class name, visible vertices, hits of the four sources)."""
    boxes = np.array([[x, 0, 0.8, 4, 2, 1.6, 0] for x, *_ in rows], dtype=float)
    labels = Labels(
        boxes, np.array([r[1] for r in rows]), np.arange(len(rows)), np.array([r[2] for r in rows]),
        np.array([r[3] for r in rows]),
    )  # fmt: skip
    ego, infra = AgentView(Pose.from_xyz_yaw(-30, -1.7)), AgentView(Pose.from_xyz_yaw(0, 0, yaw=np.pi))
    return Frame("0000/000", 0.0, ego, infra, labels)


ROWS = [
    (5, "Car", 8, [100, 50, 0, 0]),
    (10, "Car", 3, [29, 4, 30, 0]),
    (20, "Pedestrian", 0, [0, 0, 0, 5]),
    (60, "Car", 8, [999, 999, 999, 999]),  # out of range: does not count
]


@pytest.fixture
def statistics():
    return Statistics.of([frame_of(ROWS)], GRID)


def test_difficulties_of_objects_in_range(statistics):
    assert statistics.difficulty_shares("Car").tolist() == [0.5, 0.5, 0]
    assert statistics.difficulty_shares("Pedestrian").tolist() == [0, 0, 1]


def test_shares_seen_per_sensor_and_combination(statistics):
    car, pedestrian = statistics.seen_shares("Car"), statistics.seen_shares("Pedestrian")
    assert car["ego_camera"].tolist() == [0.5, 0.5]
    assert car["ego_lidar"].tolist() == [1.0, 0.5]  # 50 and 4 points
    assert car["C+none"].tolist() == [0.5, 0.5]
    assert car["C+C"].tolist() == [1.0, 1.0]
    assert car["CL+none"].tolist() == [1.0, 0.5]
    assert pedestrian["CL+none"].tolist() == [0, 0]
    assert pedestrian["CL+C"].tolist() == [0, 0]
    assert pedestrian["C+CL"].tolist() == [1, 1]


def test_report_names_every_class_and_combination(statistics):
    text = statistics.text()
    for word in ("Car", "Pedestrian", "C+none", "CL+CL", "both LiDARs", "invisible", "25-35 m 100%"):
        assert word in text


def test_a_class_without_objects_is_left_out_of_the_shares():
    text = Statistics.of([frame_of(ROWS[:1])], GRID).text()
    assert "nan" not in text


def test_nothing_is_said_of_sensors_that_were_not_captured():
    cameras = Statistics.of([frame_of(ROWS)], GRID, ("ego_camera", "infra_camera"))
    assert set(cameras.seen_shares("Car")) == {"ego_camera", "infra_camera", "C+none", "C+C"}
    assert cameras.seen_shares("Car")["C+C"].tolist() == [1.0, 1.0]
    assert "lidar" not in cameras.text().lower()
