"""The depth table by hand numbers and against the camera model."""

import json
import math

import numpy as np
import pytest
import torch

from pcdet_avp.engine.testing.depth_table import DepthErrors, DepthResult, floor_pixels
from pcdet_avp.structures.camera import PinholeCamera


@pytest.mark.parametrize(("height", "pitch"), [(1.8, 0.0), (7.0, 30.0)])
def test_floor_pixels_are_the_rows_between_two_floor_points_of_the_camera_model(height, pitch):
    camera = PinholeCamera.looking_ahead(480, 270, math.pi / 2, 0.3, height, math.radians(pitch))
    floor = np.c_[[8.0, 12.0, 25.0, 26.0], np.zeros((4, 2))]
    uv, depth = camera.project(floor)
    to_cam = torch.tensor(camera.agent_from_camera.inverse().matrix).float().repeat(2, 1, 1)
    to_img = torch.tensor(np.c_[camera.intrinsics, np.zeros(3)]).float().repeat(2, 1, 1)
    found = floor_pixels(torch.tensor(depth[::2]), torch.tensor(depth[1::2]), to_cam, to_img)
    np.testing.assert_allclose(found, np.abs(np.diff(uv[:, 1])[::2]), rtol=1e-5)


def test_one_pixel_at_fifteen_metres_is_half_a_metre():
    """d^2 / (f h) with f = 240 px and h = 1.8 m, to first order."""
    to_cam = torch.tensor([[[0.0, -1, 0, 0], [0, 0, -1, 1.8], [1, 0, 0, 0], [0, 0, 0, 1]]])
    to_img = torch.tensor([[[240.0, 0, 240, 0], [0, 240, 135, 0], [0, 0, 1, 0]]])
    found = floor_pixels(torch.tensor([15.0]), torch.tensor([15.0 + 225 / 432]), to_cam, to_img)
    assert math.isclose(found.item(), 1.0, rel_tol=0.05)


ERRORS = DepthErrors(
    depth_m=np.array([5.0, 9.9, 10.0, 15.0, 12.0, 46.0, 47.5]),
    error_m=np.array([0.1, 0.5, 0.2, 0.3, 1.0, 3.0, 9.0]),
    error_px=np.array([0.5, 1.0, 0.4, 0.6, 2.0, 0.7, 9.0]),
)


def test_rows_by_hand():
    near, middle, far, farthest = ERRORS.rows("ego_camera")
    assert near == {
        "source": "ego_camera",
        "depth_m": [0.0, 10.0],
        "pixels": 2,
        "median_m": 0.3,
        "p80_m": 0.42,
        "median_px": 0.75,
        "within_0.3m": 0.5,
    }
    assert (middle["pixels"], middle["median_m"], middle["median_px"]) == (3, 0.3, 0.6)
    assert math.isclose(middle["within_0.3m"], 2 / 3, abs_tol=1e-4)
    assert math.isclose(middle["p80_m"], 0.3 + 0.6 * 0.7, rel_tol=1e-9)
    assert far["pixels"] == 0
    assert far["median_m"] is None
    assert (farthest["pixels"], farthest["p80_m"]) == (1, 3.0)  # 47.5 m is beyond the table


def test_parts_of_several_ranks_are_one_table():
    parts = [DepthErrors(*(column[part] for column in vars(ERRORS).values())) for part in (slice(0, 3), slice(3, None))]
    assert DepthErrors.joined(parts).rows("x") == ERRORS.rows("x")
    assert DepthErrors.joined([]).rows("x")[0]["pixels"] == 0


def test_the_text_and_the_files(tmp_path):
    result = DepthResult({"config": "c", "frames": 3, "split": "val"}, ERRORS.rows("ego_camera"))
    assert "| ego_camera | 0-10 | 2 | 0.30 | 0.42 | 0.75 | 50.0 % |" in result.tables
    assert "| ego_camera | 20-30 | 0 | - | - | - | - |" in result.tables
    result.write(tmp_path, tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text())["rows"] == result.rows
    assert (tmp_path / "depth.md").read_text() == result.tables + "\n"
    assert result.scalars["depth/ego_camera/10-20"] == 0.3
    assert "depth/ego_camera/20-30" not in result.scalars
