"""Normalisation: samples do not mix, zero stays zero, and weights of another kind of norm are noticed."""

import pytest
import torch
from torch import nn

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.norm import FrozenBatchNorm2d, ScaleNorm, drop_foreign_norms, make_norm


def test_group_norm_gives_a_sample_the_same_in_any_batch():
    norm, x = make_norm("group", 16), torch.randn(3, 16, 4, 5)
    torch.testing.assert_close(norm(x)[1], norm(x[1:2])[0])


def test_groups_hold_eight_channels_or_all():
    assert make_norm("group", 64).num_groups == 8
    assert make_norm("group", 12).num_groups == 1


def test_batch_norm_is_openpcdets():
    norm = make_norm("batch", 4)
    assert (norm.eps, norm.momentum) == (1e-3, 0.01)


def test_frozen_batch_norm_equals_batch_norm_in_evaluation_and_takes_its_weights():
    plain, frozen = nn.BatchNorm2d(6), FrozenBatchNorm2d(6)
    for tensor in plain.state_dict().values():
        if tensor.is_floating_point():
            tensor.copy_(torch.rand(6) + 0.5)
    frozen.load_state_dict({k: v for k, v in plain.state_dict().items() if k != "num_batches_tracked"})
    x = torch.randn(2, 6, 3, 3)
    torch.testing.assert_close(frozen(x), plain.eval()(x), atol=1e-5, rtol=1e-5)
    assert list(frozen.parameters()) == []


def test_an_unknown_norm_lists_the_known():
    with pytest.raises(ConfigError, match="group, batch, frozen_batch"):
        make_norm("layer", 4)


def test_scale_norm_brings_the_present_cells_to_unit_power_and_keeps_zero():
    norm = ScaleNorm(4)
    present = torch.zeros(2, 1, 4, 4, dtype=torch.bool)
    present[:, :, :2] = True
    x = torch.randn(2, 4, 4, 4) * torch.tensor([0.01, 30.0]).view(2, 1, 1, 1) * present
    y = norm(x, present)
    torch.testing.assert_close(y[:, :, :2].square().mean((1, 2, 3)), torch.ones(2), atol=0.02, rtol=0)
    assert y[:, :, 2:].eq(0).all()
    assert norm(torch.zeros_like(x), present).eq(0).all()
    assert norm(torch.zeros_like(x), torch.zeros_like(present)).eq(0).all()


def test_scale_norm_of_an_empty_map_has_finite_gradients():
    x = torch.zeros(1, 4, 3, 3, requires_grad=True)
    ScaleNorm(4)(x, torch.ones(1, 1, 3, 3, dtype=torch.bool)).sum().backward()
    assert x.grad.isfinite().all()


@pytest.mark.parametrize(("trained", "own"), [("batch", "group"), ("group", "batch"), ("frozen_batch", "group")])
def test_weights_of_another_norm_are_left_out_and_named(trained, own):
    def network(kind):
        return nn.Sequential(nn.Conv2d(3, 8, 1), make_norm(kind, 8))

    kept, dropped = drop_foreign_norms(network(trained).state_dict(), network(own))
    assert set(kept) == {"0.weight", "0.bias"}
    assert {"1.weight", "1.bias"} <= set(dropped)


def test_weights_of_the_same_norm_are_kept():
    for kind in ("group", "batch"):
        state = nn.Sequential(make_norm(kind, 8)).state_dict()
        assert drop_foreign_norms(state, nn.Sequential(make_norm(kind, 8))) == (state, [])


def test_a_layer_behind_scale_norm_may_take_its_scale_into_the_weights():
    norm, present = ScaleNorm(4), torch.ones(2, 1, 3, 3, dtype=torch.bool)
    nn.init.normal_(norm.weight)
    x, layer = torch.randn(2, 4, 3, 3), nn.Conv2d(4, 5, 1, bias=False)
    scaled = torch.einsum("bc,oc,bchw->bohw", norm.scale(x, present), layer.weight[..., 0, 0], x)
    torch.testing.assert_close(scaled, layer(norm(x, present)))
