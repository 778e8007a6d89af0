"""Deformable attention against a loop over queries, heads, points and corners; empty stays empty; absent is unseen."""

import math

import pytest
import torch
from easydict import EasyDict
from torch import nn

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.backbones_2d.deformable_bev_attention import (
    DeformableBevAttention,
    deformable_sum,
    ring_offsets,
)


def naive_sum(values, places, scores):
    """The definition, cell by cell; zero outside the map."""
    _, height, width, _, d = values.shape
    out = torch.zeros(*scores.shape[:4], d, dtype=values.dtype)
    for i in torch.cartesian_prod(*(torch.arange(n) for n in scores.shape)):
        n, r, c, m, k = i.tolist()
        x, y = places[n, r, c, m, k].tolist()
        for col in (math.floor(x), math.floor(x) + 1):
            for row in (math.floor(y), math.floor(y) + 1):
                if 0 <= col < width and 0 <= row < height:
                    weight = (1 - abs(x - col)) * (1 - abs(y - row)) * scores[n, r, c, m, k]
                    out[n, r, c, m] += weight * values[n, row, col, m]
    return out


def random_inputs(generator, b=2, height=5, width=4, heads=3, points=2, d=2, spread=7.0):
    values = torch.randn(b, height, width, heads, d, generator=generator)
    places = torch.rand(b, height, width, heads, points, 2, generator=generator) * spread - 1.5
    scores = torch.rand(b, height, width, heads, points, generator=generator)
    return values, places, scores


def random_attention(stride=1, channels=8):
    """A module away from its initial state, where all branches speak."""
    torch.manual_seed(3)
    attention = DeformableBevAttention(EasyDict(HEADS=2, POINTS=3, QUERY_STRIDE=stride), channels)
    for parameter in attention.parameters():
        nn.init.normal_(parameter, std=0.4)
    return attention


@pytest.mark.parametrize("training", [True, False])
def test_equals_the_loop_inside_and_outside_the_map(training):
    inputs = random_inputs(torch.Generator().manual_seed(0))
    with torch.set_grad_enabled(training):
        found = deformable_sum(*inputs)
    torch.testing.assert_close(found, naive_sum(*inputs), atol=1e-5, rtol=1e-5)


def test_gradients_by_finite_differences():
    inputs = random_inputs(torch.Generator().manual_seed(2), b=1, height=3, width=4, heads=2)
    assert torch.autograd.gradcheck(deformable_sum, [t.double().requires_grad_() for t in inputs])


def test_a_fresh_block_changes_nothing_and_looks_on_a_ring():
    attention = DeformableBevAttention(EasyDict(HEADS=4, POINTS=2), 8)
    x = torch.randn(1, 8, 6, 6)
    torch.testing.assert_close(attention(x, torch.ones(1, 1, 6, 6, dtype=torch.bool)), x)
    ring = ring_offsets(4, 2)
    torch.testing.assert_close(ring[0], torch.tensor([[1.0, 0.0], [2.0, 0.0]]))
    torch.testing.assert_close(ring[1], torch.tensor([[0.0, 1.0], [0.0, 2.0]]), atol=1e-6, rtol=0)


def test_one_hot_cell_reaches_the_cells_that_look_at_it():
    attention = DeformableBevAttention(EasyDict(HEADS=4, POINTS=1), 4)
    for layer in (attention.value, attention.output):
        layer.weight.data = torch.eye(4)
    x = torch.zeros(1, 4, 5, 5)
    x[0, :, 2, 2] = 1.0
    change = attention(x, torch.ones(1, 1, 5, 5, dtype=torch.bool)) - x
    # Head 0 looks one column up, so channel 0 of the hot cell is seen by the cell one column below, and so on.
    for channel, (row, col) in enumerate([(2, 1), (1, 2), (2, 3), (3, 2)]):
        expected = torch.zeros(5, 5)
        expected[row, col] = change[0, channel, row, col]
        assert expected[row, col] > 0
        torch.testing.assert_close(change[0, channel], expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize("stride", [1, 2])
def test_an_empty_neighbourhood_stays_exactly_zero(stride):
    attention = random_attention(stride)
    x = torch.zeros(1, 8, 40, 8)
    x[:, :, :4] = torch.randn(8, 4, 8)
    attention.offsets.weight.data.zero_()
    y = attention(x, torch.ones(1, 1, 40, 8, dtype=torch.bool))
    assert y[:, :, 20:].eq(0).all()
    assert y[:, :, :4].ne(0).any()
    assert attention(torch.zeros_like(x), torch.ones(1, 1, 40, 8, dtype=torch.bool)).eq(0).all()


def test_absent_cells_are_zero_and_what_they_hold_changes_nothing():
    attention = random_attention()
    present = torch.rand(2, 1, 6, 8, generator=torch.Generator().manual_seed(0)) > 0.4
    x = torch.randn(2, 8, 6, 8)
    y = attention(x, present)
    assert (y * ~present).eq(0).all()
    torch.testing.assert_close(attention(torch.where(present, x, 1e3), present), y, rtol=0, atol=0)


def test_samples_of_a_batch_do_not_mix():
    attention = random_attention(stride=2)
    x, present = torch.randn(3, 8, 6, 8), torch.rand(3, 1, 6, 8) > 0.2
    together = attention(x, present)
    for i in range(3):
        torch.testing.assert_close(attention(x[i : i + 1], present[i : i + 1])[0], together[i], atol=1e-5, rtol=1e-5)


def test_every_parameter_sits_in_a_leaf_module():
    attention = random_attention()
    in_leaves = {id(p) for m in attention.modules() if not list(m.children()) for p in m.parameters()}
    assert in_leaves == {id(p) for p in attention.parameters()}


def test_all_parameters_learn():
    attention = random_attention()
    attention(torch.randn(1, 8, 6, 8), torch.ones(1, 1, 6, 8, dtype=torch.bool)).square().sum().backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in attention.parameters())


def test_sizes_that_do_not_divide_are_refused():
    with pytest.raises(ConfigError, match="HEADS"):
        DeformableBevAttention(EasyDict(HEADS=3), 8)
    with pytest.raises(ConfigError, match="QUERY_STRIDE"):
        random_attention(stride=2)(torch.zeros(1, 8, 5, 4), torch.ones(1, 1, 5, 4, dtype=torch.bool))


@pytest.mark.parametrize("stride", [1, 2])
def test_the_block_equals_its_formula_written_with_its_own_layers(stride):
    """Norm, attention, norm, feed-forward, each as a layer of its own, as the scales inside the weights must act."""
    attention = random_attention(stride).double()
    present = torch.rand(2, 1, 6, 4) < 0.7
    x = torch.randn(2, 8, 6, 4, dtype=torch.float64) * present
    with torch.no_grad():
        normed = attention.norm(x, present).permute(0, 2, 3, 1)
        values = attention.value(normed).view(2, 6, 4, 2, 4)
        queries = normed.unflatten(1, (-1, stride)).unflatten(3, (-1, stride)).mean((2, 4))
        offsets = attention.offsets(queries).view(*queries.shape[:3], 2, 3, 2)
        row, column = torch.meshgrid(
            *(torch.arange(n) * stride + (stride - 1) / 2 for n in queries.shape[1:3]), indexing="ij"
        )
        places = offsets + torch.stack([column, row], -1)[:, :, None, None]
        scores = attention.scores(queries).view(*queries.shape[:3], 2, 3).softmax(-1)
        answer = attention.output(naive_sum(values, places, scores).flatten(3)).permute(0, 3, 1, 2)
        y = x + answer.repeat_interleave(stride, 2).repeat_interleave(stride, 3) * present
        hidden = attention.ffn_in(attention.ffn_norm(y, present).permute(0, 2, 3, 1)).relu()
        expected = y + attention.ffn_out(hidden).permute(0, 3, 1, 2)
        torch.testing.assert_close(attention(x, present), expected)
