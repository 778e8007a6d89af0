"""The pillars' kernel against torch's operations, the formula that gradients go through."""

import numpy as np
import pytest
import torch
from easydict import EasyDict

from pcdet_avp.errors import SensorError
from pcdet_avp.models.backbones_3d.vfe import DynamicPillars, pillar_kernel
from pcdet_avp.models.cpu_kernels.dispatch import plain_operations

RANGE, VOXEL = [0.0, -22.4, -0.5, 44.8, 22.4, 3.5], [0.32, 0.32, 4.0]


def pillars(channels=4, filters=(16,), seed=0, **extra):
    torch.manual_seed(seed)
    vfe = DynamicPillars(EasyDict(NUM_FILTERS=list(filters), **extra), channels, VOXEL, RANGE)
    for layer in vfe.pfn_layers:
        torch.nn.init.normal_(layer.norm.weight)
        torch.nn.init.normal_(layer.norm.bias)
    return vfe.eval()


def cloud(points=4000, batch=2, channels=4, seed=0, on_borders=True):
    """Dense near the origin, some points out of range, and some exactly on cells' borders."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform([-1, -24, -0.8], [47, 24, 3.8], (points, 3)) * rng.choice([0.1, 1.0], (points, 1))
    if on_borders:
        xyz[::7, :2] = np.round(xyz[::7, :2] / 0.32) * 0.32
    rows = np.c_[rng.integers(0, batch, points), xyz, rng.uniform(0, 1, (points, channels - 3))]
    return torch.tensor(rows, dtype=torch.float32)


def both(vfe, points, batch=2):
    with torch.no_grad():
        with plain_operations():
            expected = vfe.encode(points, batch)
        return vfe.encode(points, batch), expected


@pytest.mark.parametrize("channels", [3, 4, 5])
@pytest.mark.parametrize("absolute", [True, False])
def test_equals_torch(channels, absolute):
    vfe = pillars(channels, USE_ABSLOTE_XYZ=absolute)
    (found, cells), (expected, expected_cells) = both(vfe, cloud(channels=channels))
    assert torch.equal(cells, expected_cells)
    torch.testing.assert_close(found, expected, atol=2e-4, rtol=1e-3)  # torch sums a pillar's positions in float32


def test_equals_double_precision():
    vfe, points = pillars(), cloud(on_borders=False)
    found = both(vfe, points)[0][0]
    with torch.no_grad():
        double = vfe.double().encode(points.double(), 2)[0]
    torch.testing.assert_close(found.double(), double, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("points", [cloud()[:0], cloud()[:1], cloud() + torch.tensor([0.0, 90.0, 0.0, 0.0, 0.0])])
def test_no_point_one_point_and_none_in_range(points):
    (found, cells), (expected, expected_cells) = both(pillars(), points)
    assert torch.equal(cells, expected_cells)
    torch.testing.assert_close(found, expected, atol=2e-5, rtol=1e-5)


def test_broken_points_and_stray_samples_are_refused():
    points = cloud()
    points[5, 4], points[9, 1] = torch.nan, torch.inf
    with torch.no_grad(), pytest.raises(SensorError, match="2 of 4000 rows hold NaN"):
        pillars().encode(points, 2)
    with torch.no_grad(), pytest.raises(SensorError, match="batch index outside 0 to 0"):
        pillars().encode(cloud(), 1)


def test_broken_weights_are_seen():
    vfe = pillars()
    with torch.no_grad():
        vfe.pfn_layers[0].norm.bias[3] = torch.nan
        assert vfe.encode(cloud(), 2)[0][:, 3].isnan().all()


def test_training_batch_norm_and_several_layers_do_without(monkeypatch):
    monkeypatch.setattr(pillar_kernel, "encode", None)  # a call would raise
    vfe = pillars()
    vfe.encode(cloud(), 2)[0].sum().backward()
    assert vfe.pfn_layers[0].linear.weight.grad.abs().sum() > 0
    with torch.no_grad():
        pillars(filters=(8, 16)).encode(cloud(), 2)
        pillars(NORM="batch").encode(cloud(), 2)
