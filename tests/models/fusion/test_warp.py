"""The warp against a slow loop, against encoding in the other frame, and at its borders."""

import numpy as np
import pytest
import torch

from pcdet_avp.models.fusion.warp import WarpToEgo, warp
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.pose import Pose

GRID = BevGrid(0.0, -3.2, -0.5, 4.8, 3.2, 3.5, cell_m=0.4)  # 16 rows x 12 columns
H, W = GRID.height, GRID.width


def pose(x=0.0, y=0.0, yaw=0.0, dtype=torch.float32):
    return torch.tensor(Pose.from_xyz_yaw(x, y, yaw=yaw).matrix, dtype=dtype)[None]


def random_map(batch=1, channels=5, seed=0, dtype=torch.float32):
    return torch.randn(batch, channels, H, W, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def slow_warp(X, mask, ego_from_infra, grid):
    """One cell at a time, in metres, in numpy."""
    out, present = np.zeros(X.shape), np.zeros((grid.height, grid.width), dtype=bool)
    infra_from_ego = np.linalg.inv(ego_from_infra)
    xs, ys = grid.cell_centres()
    for r, y in enumerate(ys):
        for c, x in enumerate(xs):
            px, py = (infra_from_ego @ [x, y, 0, 1])[:2]
            u, v = (px - grid.x_min_m) / grid.cell_m - 0.5, (py - grid.y_min_m) / grid.cell_m - 0.5
            share, value = 0.0, np.zeros(X.shape[0])
            for i in (int(np.floor(v)), int(np.floor(v)) + 1):
                for j in (int(np.floor(u)), int(np.floor(u)) + 1):
                    if 0 <= i < grid.height and 0 <= j < grid.width and mask[i, j]:
                        weight = (1 - abs(v - i)) * (1 - abs(u - j))
                        share, value = share + weight, value + weight * X[:, i, j]
            if share >= 0.5:
                out[:, r, c], present[r, c] = value / share, True
    return out, present


@pytest.mark.parametrize(("x", "y", "yaw"), [(1.3, -0.7, 0.4), (4.5, 0.25, np.pi), (-0.9, 1.1, -1.2)])
def test_equals_a_slow_loop(x, y, yaw):
    X = random_map(dtype=torch.float64)
    mask = torch.rand(1, 1, H, W, generator=torch.Generator().manual_seed(1)) < 0.7
    matrix = pose(x, y, yaw, torch.float64)
    warped, present = warp(X, mask, matrix, GRID)
    expected, expected_present = slow_warp(X[0].numpy(), mask[0, 0].numpy(), matrix[0].numpy(), GRID)
    np.testing.assert_array_equal(present[0, 0].numpy(), expected_present)
    np.testing.assert_allclose(warped[0].numpy(), expected, atol=1e-12)


def test_identity_pose_changes_no_bit():
    X, mask = random_map(batch=2), torch.ones(2, 1, H, W, dtype=torch.bool)
    mask[:, :, 3:5] = False
    warped, present = warp(X, mask, pose().expand(2, 4, 4), GRID)
    assert torch.equal(present, mask)
    assert torch.equal(warped, torch.where(mask, X, 0))


def test_a_map_made_in_the_infra_frame_lands_where_the_ego_would_make_it():
    """A smooth field over the floor, sampled on the infra grid and warped, equals the field sampled on the ego grid."""
    ego_from_infra = Pose.from_xyz_yaw(4.0, 0.5, yaw=2.8)
    xs, ys = GRID.cell_centres()
    centres = np.stack([*np.meshgrid(xs, ys), np.zeros((H, W))], -1)

    def field(points_in_ego):
        return np.sin(0.7 * points_in_ego[..., 0]) + np.cos(0.9 * points_in_ego[..., 1])

    infra_map = torch.tensor(field(ego_from_infra.apply(centres)))[None, None]
    everywhere = torch.ones(1, 1, H, W, dtype=torch.bool)
    warped, present = warp(infra_map, everywhere, torch.tensor(ego_from_infra.matrix)[None], GRID)
    error, present = np.abs(warped[0, 0].numpy() - field(centres)), present[0, 0].numpy()
    in_infra = ego_from_infra.inverse().apply(centres)
    margin = np.array([GRID.cell_m / 2, GRID.cell_m / 2, 0])
    interior = GRID.contains_bev(in_infra - margin) & GRID.contains_bev(in_infra + margin)
    assert interior.mean() > 0.3
    assert error[interior].max() < 0.2**2  # bilinear: about (cell / 2)^2 times the curvature
    assert error[present].max() < 0.2 * 1.2  # at the border: half a cell times the slope
    assert (present == GRID.contains_bev(in_infra)).mean() > 0.97


def test_a_single_point_keeps_its_cell():
    """The one bright cell of the infra grid, the one that a point falls in, is bright where the ego has the point."""
    ego_from_infra = Pose.from_xyz_yaw(4.4, 0.4, yaw=np.pi)  # whole cells and half a turn
    point = np.array([1.5, -0.9, 0.0])
    (row, col), (ego_row, ego_col) = GRID.cell_of(point), GRID.cell_of(ego_from_infra.apply(point))
    X = torch.zeros(1, 1, H, W)
    X[0, 0, row, col] = 1
    matrix = torch.tensor(ego_from_infra.matrix, dtype=torch.float32)[None]
    warped, _ = warp(X, torch.ones(1, 1, H, W, dtype=torch.bool), matrix, GRID)
    assert warped[0, 0, ego_row, ego_col] == pytest.approx(1, abs=1e-4)


def test_empty_cells_are_present_and_out_of_range_cells_are_absent():
    X, mask = torch.zeros(1, 2, H, W), torch.ones(1, 1, H, W, dtype=torch.bool)
    _, present = warp(X, mask, pose(x=1.6), GRID)  # four columns
    assert not present[..., :4].any()
    assert present[..., 4:].all()
    _, far = warp(X, mask, pose(x=100.0), GRID)
    assert not far.any()


def test_masked_values_do_not_leak():
    X, mask = random_map(), torch.ones(1, 1, H, W, dtype=torch.bool)
    mask[..., 5:] = False
    spoiled, matrix = torch.where(mask, X, torch.nan), pose(0.1, 0.1, 0.1)
    for clean, dirty in zip(warp(X, mask, matrix, GRID), warp(spoiled, mask, matrix, GRID), strict=True):
        assert torch.equal(clean, dirty)


def test_gradient_reaches_the_map():
    X = random_map(channels=2, dtype=torch.float64).requires_grad_()
    mask = torch.ones(1, 1, H, W, dtype=torch.bool)
    matrix = pose(0.5, 0.3, 0.2, torch.float64)
    warp(X, mask, matrix, GRID)[0].square().sum().backward()
    step = 1e-6
    bumped = X.detach().clone()
    bumped[0, 1, 7, 6] += step
    before, after = (warp(m, mask, matrix, GRID)[0].square().sum() for m in (X.detach(), bumped))
    assert X.grad[0, 1, 7, 6] == pytest.approx(float(after - before) / step, rel=1e-4)


def test_the_stage_warps_only_roadside_maps():
    maps = {source: random_map(seed=k) for k, source in enumerate(("ego_lidar", "infra_camera"))}
    valid = {source: torch.ones(1, 1, H, W, dtype=torch.bool) for source in maps}
    out = WarpToEgo(GRID)({"bev_maps": maps, "bev_valid": valid, "ego_from_infra": pose(x=1.6)})
    assert out["bev_maps"]["ego_lidar"] is maps["ego_lidar"]
    assert not out["bev_valid"]["infra_camera"].all()
    assert valid["infra_camera"].all()  # the input is left alone


def test_each_map_is_warped_by_its_own_pose_or_by_the_common_one():
    maps = {source: random_map(seed=k) for k, source in enumerate(("infra_camera", "infra_lidar"))}
    everywhere, common, own = torch.ones(1, 1, H, W, dtype=torch.bool), pose(x=1.6, yaw=0.3), pose(y=-0.7)
    batch = {"bev_maps": maps, "bev_valid": dict.fromkeys(maps, everywhere), "ego_from_infra": common}
    for poses in ({}, {"infra_lidar": own}, {"infra_camera": own, "infra_lidar": common}):
        out = WarpToEgo(GRID)({**batch, "ego_from_sender": poses})
        for source, X in maps.items():
            expected, present = warp(X, everywhere, poses.get(source, common), GRID)
            assert torch.equal(out["bev_maps"][source], expected)
            assert torch.equal(out["bev_valid"][source], present)
