"""What is computed around the graphs: the same as torch computes inside the network."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from easydict import EasyDict
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.deploy import frustum, pillars, warp
from pcdet_avp.deploy.network import CameraInput, DepthBinning, PillarInput
from pcdet_avp.errors import SensorError
from pcdet_avp.models.backbones_2d.map_to_bev.voxel_projection import project_voxels
from pcdet_avp.models.backbones_3d.vfe.dynamic_pillars import DynamicPillars
from pcdet_avp.models.backbones_image.depth_bins import DepthBins
from pcdet_avp.models.fusion.warp import infra_cells
from pcdet_avp.models.fusion.warp import neighbours as neighbours_in_torch
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.pose import Pose

GRID = BevGrid(0.0, -4.8, 0.0, 9.6, 4.8, 4.0, cell_m=0.4)


@pytest.mark.parametrize("mode", ["UD", "SID", "LID", "INV"])
@pytest.mark.parametrize("sampling", ["trilinear", "nearest"])
def test_voxels_meet_the_pixels_and_bins_that_torch_finds(mode, sampling):
    eye = PinholeCamera.looking_ahead(60, 36, 1.5, 0.2, 1.9, pitch_down=0.1)
    to_cam, to_img = eye.agent_from_camera.inverse().matrix, np.hstack([eye.intrinsics, np.zeros((3, 1))])
    camera = CameraInput(4, 4, 5, sampling, DepthBinning(mode, 12, 1.0, 9.0))
    matrix = frustum.image_from_agent(to_cam, to_img, camera.crop_px)
    ours = frustum.tables(matrix, GRID, camera, (32, 60))
    theirs = project_voxels(
        torch.from_numpy(matrix), GRID, 5, DepthBins(mode, 12, 1.0, 9.0), (32, 60), 4, sampling == "nearest"
    )
    np.testing.assert_array_equal(np.flatnonzero(ours.row_of_cell), theirs.columns)
    np.testing.assert_array_equal(ours.row_of_cell[theirs.columns], 1 + np.arange(len(theirs.columns)))
    np.testing.assert_array_equal(ours.pixels, theirs.pixels)
    np.testing.assert_allclose(ours.weights, theirs.weights, atol=1e-6)
    position = ours.bins + ours.bin_shift  # a bin's border may round to either side
    np.testing.assert_allclose(position, theirs.bins + theirs.bin_shift, atol=1e-5)


def test_a_camera_that_sees_no_cell_has_tables_of_no_rows():
    upwards = PinholeCamera.looking_ahead(60, 36, 1.0, 0.0, 1.9, pitch_down=-1.5)
    matrix = upwards.intrinsics @ upwards.agent_from_camera.inverse().matrix[:3]
    camera = CameraInput(0, 4, 2, "trilinear", DepthBinning("UD", 4, 1.0, 9.0))
    tables = frustum.tables(matrix, BevGrid(0.0, -2.0, 0.0, 4.0, 2.0, 0.5, 0.5), camera, (36, 60))
    assert not tables.row_of_cell.any()
    assert tables.weights.shape == (0, 2, 4)


@given(x=st.floats(-30, 30), y=st.floats(-30, 30), yaw=st.floats(-3.2, 3.2))
def test_warped_cells_are_torchs(x, y, yaw):
    pose = Pose.from_xyz_yaw(x, y, yaw=yaw).matrix.copy()
    cells, weights = warp.neighbours(pose, GRID)
    theirs = neighbours_in_torch(*infra_cells(torch.from_numpy(pose)[None], GRID))
    used = weights > 0
    np.testing.assert_array_equal(cells[used], theirs[0].numpy()[used])
    np.testing.assert_allclose(weights, theirs[1], atol=1e-6)


def test_the_identity_takes_every_cell_from_its_own_place():
    cells, weights = warp.neighbours(np.eye(4), GRID)
    np.testing.assert_array_equal((weights * cells).sum(1), np.arange(GRID.height * GRID.width))


@pytest.mark.parametrize(
    "section",
    [
        {},
        {"USE_ABSLOTE_XYZ": False},
        {"NORM": "batch"},
        {"NORM": "batch", "AS_OPENPCDET": {"LIDAR_HEIGHT_M": 1.7, "Z_RANGE_M": [-3.0, 1.0], "MAX_POINTS": 3}},
    ],
)
def test_points_are_decorated_as_in_torch(section):
    vfe = DynamicPillars(EasyDict(NUM_FILTERS=[8], **section), 4, [0.4, 0.4, 4.0], GRID.range)
    other = vfe.as_openpcdet or SimpleNamespace(lidar_height_m=0.0, centre_z_m=2.0, max_points=0)
    how = PillarInput(1, vfe.absolute, not vfe.batch_norm, other.lidar_height_m, other.centre_z_m, other.max_points)
    points = np.random.default_rng(0).uniform(-1, 10, (400, 4)).astype(np.float32)
    rows, cells = pillars.decorate(points, GRID, how)
    kept = vfe._in_range(torch.from_numpy(np.insert(points, 0, 0, 1)))
    ids, occupied = vfe._pillars(kept, 1)
    expected = vfe._decorate(kept, ids, occupied)
    if vfe.as_openpcdet:
        expected, ids = vfe.as_openpcdet.fill(expected, ids, len(occupied))
    np.testing.assert_array_equal(cells, occupied[ids])
    np.testing.assert_allclose(rows, expected, atol=2e-6)
    assert len(rows) < len(points) or vfe.as_openpcdet


def test_a_pillar_holds_its_largest_features_and_an_empty_one_nothing():
    x = np.array([[1.0, 5.0], [3.0, 2.0], [0.5, 0.5]], np.float32)
    np.testing.assert_array_equal(pillars.maxima(x, np.array([2, 2, 0]), 3), [[0.5, 0.5], [0, 0], [3, 5]])


def test_points_that_are_no_numbers_are_refused():
    points = np.zeros((5, 4), np.float32)
    points[3, 1] = np.nan
    with pytest.raises(SensorError, match="1 of 5 rows hold NaN"):
        pillars.decorate(points, GRID, PillarInput(1, True, True, 0.0, 2.0, 0))
