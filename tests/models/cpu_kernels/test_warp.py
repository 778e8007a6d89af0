"""The warp's kernel against torch's operations: answers, and gradients."""

import math

import pytest
import torch

from pcdet_avp.models.cpu_kernels import warp as kernels
from pcdet_avp.models.cpu_kernels.dispatch import plain_operations
from pcdet_avp.models.fusion.warp import warp
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.pose import Pose

GRID = BevGrid(0.0, -3.2, -0.5, 4.8, 3.2, 3.5, cell_m=0.4)  # 16 rows x 12 columns
H, W = GRID.height, GRID.width
POSES = [(0.0, 0.0, 0.0), (1.3, -0.7, 0.4), (0.2, 0.0, 0.0), (4.5, 0.25, math.pi), (-0.9, 1.1, -1.2), (90.0, 0.0, 0.0)]


def inputs(*poses, channels=5):
    """Maps, masks and poses, one sample each."""
    generator, batch = torch.Generator().manual_seed(2), len(poses)
    X = torch.randn(batch, channels, H, W, generator=generator)
    mask = torch.rand(batch, 1, H, W, generator=generator) < 0.7
    matrices = [torch.tensor(Pose.from_xyz_yaw(x, y, yaw=yaw).matrix).float() for x, y, yaw in poses]
    return X, mask, torch.stack(matrices)


def compare(X, mask, pose):
    """By torch's operations and by the kernel: the same cells are present and hold the same."""
    with torch.no_grad():
        with plain_operations():
            expected, expected_present = warp(X, mask, pose, GRID)
        found, present = warp(X, mask, pose, GRID)
    assert torch.equal(present, expected_present)
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=1e-6)
    return found, present


@pytest.mark.parametrize("pose", POSES)
def test_equals_torch(pose):
    found, present = compare(*inputs(pose))
    assert present.any() == (pose[0] < 50)
    assert not found[(~present).expand_as(found)].any()


def test_every_sample_has_its_own_pose():
    compare(*inputs(*POSES))


@pytest.mark.parametrize("filled", [True, False])
def test_everything_or_nothing_present(filled):
    X, mask, pose = inputs(POSES[1])
    _, present = compare(X, torch.full_like(mask, filled), pose)
    assert present.any() == filled


def test_memory_layouts():
    X, mask, pose = inputs(*POSES)
    compare(X.contiguous(memory_format=torch.channels_last), mask, pose)
    compare(torch.stack([X, X + 1], 2).flatten(1, 2)[:, ::2], mask.mT.contiguous().mT, pose)


def test_identity_changes_no_bit_and_absent_cells_are_not_read():
    X, mask, pose = inputs(POSES[0])
    with torch.no_grad():
        found, present = warp(torch.where(mask, X, torch.nan), mask, pose, GRID)
    assert torch.equal(present, mask)
    assert torch.equal(found, torch.where(mask, X, 0))


def gradient(X, mask, pose):
    """Of X for a random sum of the answer, and the cells that are present in that."""
    X = X.clone().requires_grad_()
    warped, present = warp(X, mask, pose, GRID)
    toward = torch.randn(warped.shape, generator=torch.Generator().manual_seed(4))
    return torch.autograd.grad(warped, X, toward)[0], present


def test_gradients_equal_torch_s():
    X, mask, pose = inputs(*POSES)
    with plain_operations():
        expected, expected_present = gradient(X, mask, pose)
    found, present = gradient(torch.where(mask, X, torch.nan), mask, pose)
    assert torch.equal(present, expected_present)
    torch.testing.assert_close(found, torch.where(mask, expected, 0), atol=1e-6, rtol=1e-6)
    assert found[:5].flatten(1).any(1).all()
    assert not found[5].any()  # out of range


def test_gradient_by_hand():
    """An identity pose hands the gradient back where the map is present; half a cell away, two cells share it."""
    X, mask, _ = inputs(POSES[0])
    poses = [torch.tensor(Pose.from_xyz_yaw(x, 0.0).matrix).float()[None] for x in (0.0, GRID.cell_m / 2)]
    X.requires_grad_()
    (grad,) = torch.autograd.grad(warp(X, mask, poses[0], GRID)[0].sum(), X)
    assert torch.equal(grad, mask.expand_as(grad).float())
    (grad,) = torch.autograd.grad(warp(X, torch.ones_like(mask), poses[1], GRID)[0].sum(), X)
    torch.testing.assert_close(grad[..., 1:-1], torch.ones_like(grad[..., 1:-1]))


def test_other_precisions_do_without(monkeypatch):
    monkeypatch.setattr(kernels, "resample", None)  # a call would raise
    X, mask, pose = inputs(POSES[1])
    warp(X.double().requires_grad_(), mask, pose, GRID)[0].sum().backward()
    with torch.autocast("cpu", torch.bfloat16):
        warp(X.clone().requires_grad_(), mask, pose, GRID)
    with torch.no_grad():
        warp(X.double(), mask, pose, GRID)
        with pytest.raises(TypeError):
            warp(X, mask, pose, GRID)
