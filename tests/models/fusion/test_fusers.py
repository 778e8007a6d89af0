"""The five fusers: equations, masks, order, gradients."""

import itertools

import pytest
import torch

from pcdet_avp.errors import SensorError
from pcdet_avp.models.fusion.channel_ada import ChannelAdaFusion, cell_shares
from pcdet_avp.models.fusion.pooled_statistics import cleared, descriptors, pooled_statistics
from pcdet_avp.models.fusion.spatial_ada import TwoMapConv3d
from pcdet_avp.registry import FUSERS
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SOURCES

B, C, H, W = 2, 6, 5, 7
NAMES = ("AverageFusion", "MaxFusion", "SpatialAdaFusion", "ChannelAdaFusion", "AdaFusion")


def make(name, seed=0, **cfg):
    torch.manual_seed(seed)
    return FUSERS[name](cfg)


def batch(sources=SOURCES, seed=0, share=0.8):
    generator = torch.Generator().manual_seed(seed)
    maps = {s: torch.randn(B, C, H, W, generator=generator).relu() for s in SOURCES}
    valid = {s: torch.rand(B, 1, H, W, generator=generator) < share for s in SOURCES}
    return {"bev_maps": {s: maps[s] for s in sources}, "bev_valid": {s: valid[s] for s in sources}}


def fused(fuser, batch_dict):
    return fuser(batch_dict)["spatial_features"]


def test_all_names_are_registered():
    assert set(NAMES) <= set(FUSERS)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_any_non_empty_subset_is_fused(name, count):
    for sources in itertools.combinations(SOURCES, count):
        out = fused(make(name), batch(sources))
        assert out.shape == (B, C, H, W)
        assert out.isfinite().all()


def test_no_map_at_all_is_an_error():
    with pytest.raises(SensorError, match="no feature map"):
        make("AdaFusion")({"bev_maps": {}, "bev_valid": {}})
    with pytest.raises(SensorError, match="radar"):
        make("AdaFusion")({"bev_maps": {"radar": torch.zeros(1)}, "bev_valid": {"radar": torch.zeros(1)}})


@pytest.mark.parametrize("name", NAMES)
def test_the_order_in_which_maps_arrive_changes_no_bit(name):
    data = batch()
    for order in ((3, 1, 0, 2), (2, 3, 1, 0)):
        shuffled = {k: {SOURCES[i]: v[SOURCES[i]] for i in order} for k, v in data.items()}
        assert torch.equal(fused(make(name), data), fused(make(name), shuffled))


@pytest.mark.parametrize("name", ["AverageFusion", "MaxFusion", "SpatialAdaFusion"])
def test_fusers_without_slots_are_symmetric(name):
    data = batch()
    rotated = {k: dict(zip(SOURCES, [*list(v.values())[1:], v[SOURCES[0]]], strict=True)) for k, v in data.items()}
    torch.testing.assert_close(fused(make(name), data), fused(make(name), rotated))


@pytest.mark.parametrize("name", NAMES)
def test_absent_and_all_masked_maps_give_the_same_bits(name):
    """Infra none, an infra map that is out of range everywhere, and one full of NaN behind its mask."""
    alone = fused(make(name), batch(SOURCES[:2]))
    for rubbish in (0.0, 1e9, torch.nan, -torch.inf):
        data = batch()
        for source in SOURCES[2:]:
            data["bev_maps"][source] = torch.full((B, C, H, W), rubbish)
            data["bev_valid"][source] = torch.zeros(B, 1, H, W, dtype=torch.bool)
        assert torch.equal(alone, fused(make(name), data))


@pytest.mark.parametrize("name", NAMES)
def test_masked_cells_never_leak(name):
    data, spoiled = batch(share=0.5), batch(share=0.5)
    spoiled["bev_maps"] = {s: torch.where(data["bev_valid"][s], X, torch.nan) for s, X in data["bev_maps"].items()}
    assert torch.equal(fused(make(name), data), fused(make(name), spoiled))


@pytest.mark.parametrize("name", NAMES)
def test_a_batch_of_mixed_presence_equals_single_samples(name):
    data = batch()
    data["bev_valid"]["infra_lidar"][0] = False
    data["bev_valid"]["ego_lidar"][1] = False
    together = fused(make(name), data)
    for i in range(B):
        single = {k: {s: t[i : i + 1] for s, t in v.items()} for k, v in data.items()}
        torch.testing.assert_close(together[i : i + 1], fused(make(name), single), atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_cells_without_any_map_are_zero(name):
    data = batch()
    for mask in data["bev_valid"].values():
        mask[:, :, 2, 3] = False
    assert (fused(make(name), data)[:, :, 2, 3] == 0).all()


def test_average_and_maximum_by_hand():
    data = batch(SOURCES[:3])
    for value, source in zip((1.0, 2.0, -4.0), SOURCES, strict=False):
        data["bev_maps"][source] = torch.full((B, C, H, W), value)
        data["bev_valid"][source] = torch.ones(B, 1, H, W, dtype=torch.bool)
    data["bev_valid"][SOURCES[1]][:, :, 0] = False
    X_avg, X_max = fused(make("AverageFusion"), data), fused(make("MaxFusion"), data)
    assert (X_avg[:, :, 0] == -1.5).all()
    torch.testing.assert_close(X_avg[:, :, 1:], torch.full((B, C, H - 1, W), -1 / 3))
    assert (X_max[:, :, 0] == 1).all()
    assert (X_max[:, :, 1:] == 2).all()


@pytest.mark.parametrize("channels", [3, 16, 20, 40])
def test_blockwise_convolution_equals_conv3d(channels):
    torch.manual_seed(0)
    conv, x = TwoMapConv3d().double(), torch.randn(2, 2, channels, 5, 4, dtype=torch.float64)
    torch.nn.init.normal_(conv.weight)
    torch.nn.init.normal_(conv.bias)
    expected = torch.nn.functional.conv3d(x, conv.weight, conv.bias, padding=1).squeeze(1)
    torch.testing.assert_close(conv(x[:, 0], x[:, 1]), expected)


def test_descriptors_see_present_cells_only():
    X, mask = torch.zeros(2, 2, 2, 2), torch.zeros(2, 1, 2, 2, dtype=torch.bool)
    X[0, :, 0, 0], X[0, 0, 0, 1], X[0, :, 1, 1] = -3.0, -1.0, 50.0
    mask[0, 0, 0] = True  # the row with 50 is masked, all of sample 1 is absent
    highest, mean = descriptors(torch.where(mask, X, 0), mask)
    assert highest.tolist() == [0.0, 0.0]  # the second channel of cell (0, 1) holds 0
    assert mean.tolist() == [(-3 - 3 - 1 + 0) / 4, 0.0]


def test_channel_weights_are_normalised_per_cell_and_uniform_where_they_are_all_zero():
    W = torch.tensor([[3.0, 1.0, 0.0, 0.0]])
    masks = {0: torch.tensor([True, False, True]), 1: torch.tensor([True, True, False]), 2: torch.tensor([True] * 3)}
    shares = cell_shares(W, {i: m.view(1, 1, 1, 3) for i, m in masks.items()})
    assert shares[0].flatten().tolist() == [0.75, 0.0, 1.0]
    assert shares[1].flatten().tolist() == [0.25, 1.0, 0.0]
    uniform = cell_shares(torch.zeros(1, 4), {i: m.view(1, 1, 1, 3) for i, m in masks.items()})
    assert uniform[2].flatten().tolist() == pytest.approx([1 / 3, 1 / 2, 1 / 2])


def test_original_form_is_the_plain_weighted_sum():
    data, fuser = batch(share=1.1), make("ChannelAdaFusion", ORIGINAL_FORM=True)
    maps = dict(enumerate(data["bev_maps"].values()))
    D = torch.stack([X.amax((1, 2, 3)) for X in maps.values()] + [X.mean((1, 2, 3)) for X in maps.values()], 1)
    weights = (torch.sigmoid(D @ fuser.hidden.weight.T) @ fuser.weights.weight.T).relu()
    torch.testing.assert_close(fuser.map_weights([0, 1, 2, 3], D[:, :4], D[:, 4:]), weights)
    expected = torch.einsum("bn,nbchw->bchw", weights, torch.stack(list(maps.values())))
    torch.testing.assert_close(fused(fuser, data), expected)
    with torch.no_grad():
        fuser.weights.weight.fill_(-1)
    assert (fused(fuser, data) == 0).all()  # what the default form avoids
    ours = make("ChannelAdaFusion")
    ours.load_state_dict(fuser.state_dict())
    torch.testing.assert_close(fused(ours, data), fused(make("AverageFusion"), data))


@pytest.mark.parametrize("combo", SENSOR_SETS)
@pytest.mark.parametrize("name", ["SpatialAdaFusion", "ChannelAdaFusion", "AdaFusion"])
def test_gradient_reaches_every_parameter_that_can_matter(name, combo):
    """With one map alone the inner channel weights cancel; everything else always has a gradient."""
    sources = [s for s, present in zip(SOURCES, SENSOR_SETS[combo].mask, strict=True) if present]
    fuser = make(name)
    fused(fuser, batch(sources)).square().sum().backward()
    for key, parameter in fuser.named_parameters():
        assert parameter.grad.isfinite().all()
        cancels = len(sources) == 1 and (isinstance(fuser, ChannelAdaFusion) or key.startswith("channel."))
        assert bool((parameter.grad.abs() > 1e-4).any()) != cancels, key


def test_every_parameter_sits_in_a_leaf_module():
    for name in NAMES:
        for module in make(name).modules():
            assert not list(module.children()) or not list(module.parameters(recurse=False))


def masked_maps(n, seed=0):
    generator = torch.Generator().manual_seed(seed)
    masks = [torch.rand(2, 1, 3, 4, generator=generator) < 0.6 for _ in range(n)]
    maps = [torch.randn(2, 3, 3, 4, generator=generator, dtype=torch.float64) * m for m in masks]
    return maps, masks


@pytest.mark.parametrize("n", [1, 2, 4])
def test_gradients_of_the_statistics(n):
    """Against finite differences where a map is present; zero where it is absent."""
    maps, masks = masked_maps(n)

    def flat(*maps):
        stats = pooled_statistics(list(maps), masks)
        alone = [d for X, m in zip(maps, masks, strict=True) for d in descriptors(X, m)]
        return torch.cat([v.flatten() for v in (stats.X_max, stats.X_avg, stats.map_max, stats.map_avg, *alone)])

    jacobian = torch.autograd.functional.jacobian(flat, tuple(maps))
    for k, m in enumerate(masks):
        present = m.expand_as(maps[k])
        assert not jacobian[k][:, ~present].any()
        for place in present.nonzero()[::5].tolist():
            bumped = [X.clone() for X in maps]
            bumped[k][tuple(place)] += 1e-6
            slope = (flat(*bumped) - flat(*maps)) / 1e-6
            torch.testing.assert_close(jacobian[k][(slice(None), *place)], slope, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("original_form", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_absent_cells_have_no_gradient(name, original_form):
    data = batch(share=0.6)
    maps = {s: X.requires_grad_() for s, X in data["bev_maps"].items()}
    fused(make(name, ORIGINAL_FORM=original_form), data).square().sum().backward()
    for source, X in maps.items():
        present = data["bev_valid"][source].expand_as(X)
        assert not X.grad[~present].any()
        assert X.grad[present].any()


def test_statistics_equal_plain_formulas():
    maps, masks = masked_maps(4)
    stats = pooled_statistics(maps, masks)
    X_max, X_avg = stats.X_max, stats.X_avg
    for b, r, c in itertools.product(range(2), range(3), range(4)):
        here = [X[b, :, r, c] for X, m in zip(maps, masks, strict=True) if m[b, 0, r, c]]
        expected = torch.stack(here) if here else torch.zeros(1, 3, dtype=torch.float64)
        torch.testing.assert_close(X_max[b, :, r, c], expected.amax(0))
        torch.testing.assert_close(X_avg[b, :, r, c], expected.mean(0))


def test_equal_maps_share_one_gradient_of_the_maximum():
    """Cells that all maps agree on are the rule (empty ones); the gradient must not be counted once per map."""
    maps = [torch.zeros(1, 2, 2, 2, requires_grad=True) for _ in range(3)]
    masks = [torch.ones(1, 1, 2, 2, dtype=torch.bool)] * 3
    pooled_statistics(maps, masks).X_max.sum().backward()
    assert sum(X.grad for X in maps).tolist() == torch.ones(1, 2, 2, 2).tolist()


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_cleared_cells_are_zero_whatever_they_hold_and_the_others_keep_every_bit(dtype):
    X, mask = torch.randn(2, 3, 4, 5).to(dtype), torch.rand(2, 1, 4, 5) < 0.5
    X[0, 0, 0], X[1, 2, 3] = torch.nan, -torch.inf
    assert torch.equal(cleared(X, mask).nan_to_num(7.0), torch.where(mask, X, 0).nan_to_num(7.0))
    assert not cleared(X, mask)[~mask.expand_as(X)].signbit().any()
