"""A small, whole frame made by hand, for the tests of records and samples."""

import numpy as np
import pytest

from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.frame import AgentView, Frame, Labels
from pcdet_avp.structures.lidar_scan import LidarModel, LidarScan
from pcdet_avp.structures.pose import Pose


def _scan(rng, pitch_down, z_m, span):
    mount = Pose.from_xyz_yaw(0.3, 0.0, z_m, pitch_down=pitch_down)
    model = LidarModel(8, 60, np.radians(-25.0), np.radians(2.0), span, mount)
    hit = rng.random((8, 60)) < 0.9
    ranges = np.where(hit, rng.integers(1, 65536, (8, 60)), 0).astype(np.uint16)
    return LidarScan(model, ranges, np.where(hit, rng.integers(0, 256, (8, 60)), 0).astype(np.uint8))


def _view(rng, pose, pitch_down, z_m, span, point_list):
    camera = PinholeCamera.looking_ahead(64, 36, np.pi / 2, 0.2, z_m, pitch_down)
    image = rng.integers(0, 256, (36, 64, 3), dtype=np.uint8)
    depth = (rng.integers(0, 65536, (36, 64)).astype(np.float32)) * np.float32(0.001)
    scan = _scan(rng, pitch_down, z_m, span)
    if point_list:
        points = rng.uniform([0, -30, 0, 0], [44, 30, 3, 1], (200, 4)).astype(np.float32)
        return AgentView(pose, camera, image, depth, points)
    return AgentView(pose, camera, image, depth, scan.points(), scan)


@pytest.fixture(scope="session")
def make_frame():
    """``make_frame(frame_id, seed, point_list)``: both agents with all sensors and three labels."""

    def make(frame_id="scene_0000/000000", seed=0, point_list=False) -> Frame:
        rng = np.random.default_rng(seed)
        ego = _view(rng, Pose.from_xyz_yaw(-30.0, -1.7, 0.0, 0.05), 0.0, 1.8, 2 * np.pi, point_list)
        infra = _view(rng, Pose.from_xyz_yaw(0.0, 0.0, 0.0, np.pi), 0.5, 7.0, 2.0, point_list)
        boxes = np.array(
            [[12.0, 3.0, 0.8, 4.5, 1.9, 1.6, 1.57], [8.0, -4.0, 0.9, 0.375, 0.375, 1.8, 0.0], [80.0, 0, 1, 4, 2, 2, 3]]
        )
        names = np.array(["Car", "Pedestrian", "Car"])
        labels = Labels(boxes, names, np.array([4, 9, 2]), np.array([8, 3, 0]), rng.integers(0, 99, (3, 4)))
        return Frame(frame_id, 1.25, ego, infra, labels)

    return make
