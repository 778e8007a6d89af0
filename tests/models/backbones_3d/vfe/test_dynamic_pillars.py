"""Pillar features against a loop over points and pillars; empty clouds; points on the right cells."""

import math

import numpy as np
import pytest
import torch
from easydict import EasyDict

from pcdet_avp.errors import ConfigError, SensorError
from pcdet_avp.models.backbones_2d.map_to_bev import PillarScatter
from pcdet_avp.models.backbones_3d.vfe import DynamicPillars
from pcdet_avp.models.backbones_3d.vfe.segment_max import segment_max

RANGE, VOXEL = [0.0, -2.0, -0.5, 4.0, 2.0, 3.5], [0.5, 0.5, 4.0]


def pillars(norm="batch", filters=(6,), **extra):
    torch.manual_seed(0)
    return DynamicPillars(EasyDict(NUM_FILTERS=list(filters), NORM=norm, **extra), 4, VOXEL, RANGE)


def cloud(points=60, batch=3, seed=0):
    rng = np.random.default_rng(seed)
    xyz = rng.uniform([-0.5, -2.5, -0.8], [4.5, 2.5, 3.8], (points, 3))
    rows = np.c_[np.sort(rng.integers(0, batch, points)), xyz, rng.uniform(0, 1, points)]
    return torch.tensor(rows, dtype=torch.float32)


def naive_pillars(vfe, points):
    """PointPillars by the book, in OpenPCDet's order of features: {(sample, row, column): feature vector}."""
    groups = {}
    for p in points.double().numpy():
        row, col = math.floor((p[2] + 2) / 0.5), math.floor(p[1] / 0.5)
        if 0 <= row < 8 and 0 <= col < 8 and -0.5 <= p[3] < 3.5:
            groups.setdefault((int(p[0]), row, col), []).append(p[1:])
    weight = vfe.pfn_layers[0].linear.weight.detach().double().numpy()
    features = {}
    for (sample, row, col), members in groups.items():
        mean = np.mean([m[:3] for m in members], 0)
        centre = np.array([(col + 0.5) * 0.5, -2 + (row + 0.5) * 0.5, 1.5])
        rows = [weight @ np.r_[m, m[:3] - mean, m[:3] - centre] for m in members]
        features[sample, row, col] = np.maximum(0, np.max(np.array(rows) / math.sqrt(1 + 1e-3), 0))
    return features


def test_equals_the_loop():
    vfe, points = pillars().eval(), cloud()
    expected = naive_pillars(vfe, points)
    features, coords = vfe.encode(points, 3)
    assert [(b, r, c) for b, _, r, c in coords.tolist()] == sorted(expected)
    for feature, coord in zip(features, coords.tolist(), strict=True):
        torch.testing.assert_close(
            feature.detach().double(), torch.tensor(expected[coord[0], coord[2], coord[3]]), atol=1e-5, rtol=1e-5
        )


def test_weight_names_and_shapes_are_openpcdets():
    state = pillars("batch", (64,)).state_dict()
    assert state["pfn_layers.0.linear.weight"].shape == (64, 10)
    assert state["pfn_layers.0.norm.running_mean"].shape == (64,)
    two = pillars("batch", (64, 64)).state_dict()
    assert two["pfn_layers.0.linear.weight"].shape == (32, 10)
    assert two["pfn_layers.1.linear.weight"].shape == (64, 64)
    assert pillars("batch", (64,), USE_ABSLOTE_XYZ=False).state_dict()["pfn_layers.0.linear.weight"].shape == (64, 7)


@pytest.mark.parametrize("norm", ["group", "batch"])
@pytest.mark.parametrize("filters", [(6,), (8, 6)])
def test_the_order_of_points_changes_nothing_and_pillars_do_not_mix(norm, filters):
    vfe, points = pillars(norm, filters).eval(), cloud()
    features, coords = vfe.encode(points, 3)
    shuffled, same = vfe.encode(points[torch.randperm(len(points), generator=torch.Generator().manual_seed(1))], 3)
    assert torch.equal(coords, same)
    torch.testing.assert_close(features, shuffled, atol=1e-5, rtol=1e-5)
    alone, _ = vfe.encode(points[points[:, 0] == 1] * torch.tensor([0.0, 1, 1, 1, 1]), 1)
    torch.testing.assert_close(features[coords[:, 0] == 1], alone, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("norm", ["group", "batch"])
@pytest.mark.parametrize("training", [False, True])
def test_empty_clouds(norm, training):
    vfe = pillars(norm).train(training)
    scatter = PillarScatter(EasyDict(NUM_BEV_FEATURES=6), [8, 8, 1])
    points = cloud()
    points = points[points[:, 0] != 2]  # the last sample is empty
    whole = scatter.scatter(*vfe.encode(points, 3), 3)
    assert whole.shape == (3, 6, 8, 8)
    assert whole[2].eq(0).all()
    assert whole[0].ne(0).any()
    nothing = scatter.scatter(*vfe.encode(points[:0], 3), 3)
    assert nothing.shape == (3, 6, 8, 8)
    assert nothing.eq(0).all()
    assert len(vfe.encode(points[:1], 3)[0]) <= 1  # one point: no statistics over points, and no error
    (whole.sum() + nothing.sum()).backward()


def test_a_point_fills_its_cell_and_no_other():
    vfe, scatter = pillars("group"), PillarScatter(EasyDict(NUM_BEV_FEATURES=6), [8, 8, 1])
    point = torch.tensor([[1.0, 1.26, 0.74, 0.9, 0.5]])  # x 1.26 is column 2, y 0.74 is row 5
    canvas = scatter.scatter(*vfe.encode(point, 2), 2)
    filled = canvas.ne(0).any(1).nonzero().tolist()
    assert filled == [[1, 5, 2]]


def test_points_on_the_border_of_the_range():
    _, coords = pillars().encode(
        torch.tensor([[0, 0.0, -2.0, -0.5, 0], [0, 4.0, 0, 0, 0], [0, 1, 2.0, 0, 0], [0, 1, 1, 3.5, 0]]), 1
    )
    assert coords.tolist() == [[0, 0, 0, 0]]
    almost = np.nextafter(np.float32(4.0), np.float32(0))
    _, coords = pillars().encode(torch.tensor([[0, almost, 1.9999999, 0, 0]]), 1)
    assert coords.tolist() == [[0, 0, 7, 7]]


def test_nan_points_are_an_error_that_counts_them():
    points = cloud()
    points[3, 2] = float("nan")
    with pytest.raises(SensorError, match="1 of 60"):
        pillars().encode(points, 3)


def test_batch_dict_keys():
    vfe, scatter = pillars(), PillarScatter(EasyDict(NUM_BEV_FEATURES=6), np.array([8, 8, 1]))
    batch = scatter(vfe({"points": cloud(), "batch_size": 4}))
    assert batch["spatial_features"].shape == (4, 6, 8, 8)
    assert batch["voxel_coords"].shape == (len(batch["pillar_features"]), 4)
    assert vfe.get_output_feature_dim() == scatter.num_bev_features == 6


def test_scaled_inputs_let_the_shape_inside_a_pillar_speak():
    """Under group norm two points 0.1 m apart must differ, although they are 40 m away."""
    torch.manual_seed(0)
    vfe = DynamicPillars(
        EasyDict(NUM_FILTERS=[32], NORM="group"), 4, [0.16, 0.16, 4.0], [0, -30.08, -0.5, 44.8, 30.08, 3.5]
    )
    corner = torch.tensor([0.0, 40.0, 8.0, 0.0, 0.0])  # of two neighbouring pillars, the second 0.16 m further
    shape = torch.tensor([[0, 0.02, 0.02, 1.0, 0.5], [0, 0.12, 0.02, 1.0, 0.5], [0, 0.18, 0.02, 1.0, 0.5]])
    features, _ = vfe.encode(corner + shape, 1)
    assert len(features) == 2
    assert (features[0] - features[1]).abs().max() > 0.1


def test_segment_max_and_its_gradient():
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(20, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    rank = torch.cat([torch.arange(4), torch.randint(0, 4, (16,), generator=generator)])
    expected = torch.stack([x[rank == s].max(0).values for s in range(4)])
    assert torch.equal(segment_max(x, rank, 4), expected)
    assert torch.autograd.gradcheck(lambda t: segment_max(t, rank, 4), x)


def test_the_same_points_give_the_same_bits():
    vfe, points = pillars("group", (16,)), cloud(500)
    runs = []
    for _ in range(2):
        vfe.zero_grad()
        vfe.encode(points, 3)[0].square().sum().backward()
        runs.append(vfe.pfn_layers[0].linear.weight.grad.clone())
    assert torch.equal(*runs)


def test_an_unknown_norm_is_refused():
    with pytest.raises(ConfigError, match=r"VFE\.NORM"):
        pillars("frozen_batch")
