"""The attention's kernels against torch's operations: answers, and gradients."""

import numba
import pytest
import torch
from easydict import EasyDict
from torch import nn
from torch.utils.checkpoint import checkpoint

from pcdet_avp.models.backbones_2d.deformable_bev_attention import DeformableBevAttention
from pcdet_avp.models.cpu_kernels import attention as kernels
from pcdet_avp.models.cpu_kernels import attention_gradient
from pcdet_avp.models.cpu_kernels.dispatch import plain_operations


def random_attention(stride, heads=2, channels=16):
    """A module away from its initial state; its queries look up to some cells away, beyond the map's border, too."""
    torch.manual_seed(3)
    attention = DeformableBevAttention(EasyDict(HEADS=heads, POINTS=3, QUERY_STRIDE=stride), channels)
    for parameter in attention.parameters():
        nn.init.normal_(parameter, std=0.4)
    return attention.eval()


def sparse_map(batch=2, channels=16, height=12, width=8, share=0.2):
    """Maps whose cells are mostly zero, and which of them are present."""
    generator = torch.Generator().manual_seed(5)
    x = torch.randn(batch, channels, height, width, generator=generator)
    x *= torch.rand(batch, 1, height, width, generator=generator) < share
    return x, torch.rand(batch, 1, height, width, generator=generator) < 0.7


def both(attention, x, present):
    """By torch's operations and by the kernels."""
    with torch.no_grad():
        with plain_operations():
            expected = attention(x, present)
        return expected, attention(x, present)


@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("stride", [1, 2])
def test_equals_torch(stride, share):
    expected, found = both(random_attention(stride), *sparse_map(share=share))
    torch.testing.assert_close(found, expected, atol=2e-5, rtol=1e-5)
    assert torch.equal(found == 0, expected == 0)


@pytest.mark.parametrize(("batch", "present"), [(1, 0), (2, 0), (2, 1)])
def test_nothing_present_and_all_present(batch, present):
    x, _ = sparse_map(batch)
    expected, found = both(random_attention(2), x, torch.full_like(x[:, :1], present, dtype=torch.bool))
    torch.testing.assert_close(found, expected, atol=2e-5, rtol=1e-5)


def test_bands_of_rows_change_no_bit_and_call_for_no_other_kernel(monkeypatch):
    """For other types of arguments a kernel would be compiled anew, in the middle of a drive."""
    attention, (x, present) = random_attention(2), sparse_map()
    add, before, answers, types = kernels.add_answers, torch.get_num_threads(), [], []
    monkeypatch.setattr(kernels, "add_answers", lambda *args: types.append([*map(numba.typeof, args)]) or add(*args))
    for threads in (1, 2):
        torch.set_num_threads(threads)
        answers.append(both(attention, x, present)[1])
    torch.set_num_threads(before)
    assert torch.equal(*answers)
    assert types[:2] == types[2:]


@pytest.mark.parametrize("layout", ["channels_last", "every second channel", "transposed"])
def test_memory_layouts(layout):
    x, present = sparse_map()
    if layout == "channels_last":
        x = x.contiguous(memory_format=torch.channels_last)
    elif layout == "every second channel":
        x = torch.stack([x, x + 1], 2).flatten(1, 2)[:, ::2]
    else:
        x, present = (t.mT.contiguous().mT for t in (x, present))
    expected, found = both(random_attention(2), x, present)
    torch.testing.assert_close(found, expected, atol=2e-5, rtol=1e-5)


def test_the_input_is_left_as_it_is():
    x, present = sparse_map()
    before = x.clone()
    both(random_attention(2), x, present)
    assert torch.equal(x, before)


def test_a_broken_number_is_not_lost():
    x, present = sparse_map()
    x[0, 3, 4, 4], present[0, :, 4, 4] = torch.nan, True
    _, found = both(random_attention(2), x, present)
    assert found[0, :, 4, 4].isnan().any()


def gradients(attention, x, present):
    """Of the map and all weights, for a random sum of the answer; the map has come out of a ReLU."""
    x = x.clone().requires_grad_()
    out = attention(torch.relu(x), present)
    toward = torch.randn(out.shape, generator=torch.Generator().manual_seed(4))
    return out, torch.autograd.grad(out, [x, *attention.parameters()], toward)


@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("stride", [1, 2])
def test_gradients_equal_torch_s(stride, share):
    attention, inputs = random_attention(stride), sparse_map(share=share)
    with plain_operations():
        expected, by_torch = gradients(attention, *inputs)
    found, by_kernels = gradients(attention, *inputs)
    torch.testing.assert_close(found, expected, atol=2e-5, rtol=1e-5)
    for mine, theirs in zip(by_kernels, by_torch, strict=True):
        assert theirs.any() or not share
        torch.testing.assert_close(mine, theirs, atol=1e-5 * max(1.0, float(theirs.abs().max())), rtol=1e-4)


def test_gradients_by_finite_differences():
    """Along a random direction of all weights; places that move over a cell's border are few."""
    attention, (x, present) = random_attention(2), sparse_map(share=0.5)
    _, (_, *grads) = gradients(attention, x, present)
    toward = torch.randn(x.shape, generator=torch.Generator().manual_seed(4)).double()
    generator, step = torch.Generator().manual_seed(6), 1e-6
    along = [torch.randn(g.shape, generator=generator).double() for g in grads]

    def moved(by):
        twin = random_attention(2).double()
        with torch.no_grad():
            for parameter, direction in zip(twin.parameters(), along, strict=True):
                parameter += by * direction
            return (twin(torch.relu(x).double(), present) * toward).sum()

    slope = (moved(step) - moved(-step)) / (2 * step)
    found = sum((g.double() * direction).sum() for g, direction in zip(grads, along, strict=True))
    torch.testing.assert_close(found, slope, rtol=1e-4, atol=0)


def test_gradients_are_the_same_bits_every_time():
    first, second = (gradients(random_attention(2), *sparse_map())[1] for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def test_computing_again_in_the_backward_pass_changes_no_bit():
    attention, (x, present) = random_attention(2), sparse_map()
    found = []
    for module in (attention, lambda *inputs: checkpoint(attention, *inputs, use_reentrant=False)):
        leaf = x.clone().requires_grad_()
        found.append(torch.autograd.grad(module(leaf, present).square().sum(), [leaf, *attention.parameters()]))
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))


def test_other_precisions_do_without(monkeypatch):
    monkeypatch.setattr(kernels, "attend", None)  # a call would raise
    monkeypatch.setattr(attention_gradient, "attend", None)
    attention, (x, present) = random_attention(2), sparse_map()
    with torch.autocast("cpu", torch.bfloat16):
        attention(x, present).sum().backward()
    assert attention.value.weight.grad.abs().sum() > 0
    attention.double()(x.double(), present)
    with torch.no_grad(), pytest.raises(TypeError):
        attention.float()(x, present)
    with pytest.raises(TypeError):
        attention(x, present)
