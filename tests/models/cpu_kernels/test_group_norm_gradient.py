"""The training kernel of group norm, shortcut and ReLU in bf16 against torch's gradients in double precision."""

import pytest
import torch
from torch import nn
from torch.nn import functional as F

from pcdet_avp.models.cpu_kernels import group_norm_gradient as kernels
from pcdet_avp.models.cpu_kernels.dispatch import plain_operations
from pcdet_avp.models.norm import make_norm, norm_relu

ROUNDING = 2.0**-8  # of a number that is stored in bf16


def layer(channels=16):
    torch.manual_seed(4)
    norm = make_norm("group", channels)
    nn.init.normal_(norm.weight)
    nn.init.normal_(norm.bias)
    return norm


def maps(seed, mean=0.0, channels=16):
    """More pixels than one chunk, whole multiples of 1/16, which bf16 and float64 hold alike."""
    x = torch.randint(-32, 33, (2, channels, 9, 31), generator=torch.Generator().manual_seed(seed)) / 16 + mean
    return x.to(torch.bfloat16).contiguous(memory_format=torch.channels_last)


def gradients(norm, x, shortcut, grad):
    """Answer and gradients of x, shortcut, weight and bias."""
    inputs = [t for t in (x, shortcut) if t is not None]
    for t in inputs:
        t.requires_grad_()
    out = norm_relu(norm, x, shortcut)
    return out, *torch.autograd.grad(out, [*inputs, norm.weight, norm.bias], grad)


def in_double(norm, x, shortcut, grad):
    """The same by torch's operations in float64, with the ReLU of the bf16 answer, whose zeros may differ."""
    norm = make_norm("group", norm.num_channels).double()
    norm.load_state_dict(layer(norm.num_channels).state_dict())
    return gradients(norm, x.double(), None if shortcut is None else shortcut.double(), grad.double())


@pytest.mark.parametrize("mean", [0.0, -4.0])
@pytest.mark.parametrize("with_shortcut", [False, True])
@pytest.mark.parametrize("channels", [16, 12])
def test_equals_the_definition_up_to_the_rounding_of_bf16(channels, with_shortcut, mean):
    x, grad = maps(1, mean, channels), maps(2, channels=channels)
    shortcut = maps(3, channels=channels) if with_shortcut else None
    expected = in_double(layer(channels), x.detach(), shortcut if shortcut is None else shortcut.detach(), grad)
    with torch.autocast("cpu", torch.bfloat16):
        found = gradients(layer(channels), x, shortcut, grad)
    assert [t.dtype for t in found[:2]] == [torch.bfloat16] * 2
    for one, other in zip(found, expected, strict=True):
        error = (one.double() - other).abs()
        assert (error <= ROUNDING * other.abs() + 2e-3 * other.abs().max()).all()


def test_the_kernel_is_what_answers(monkeypatch):
    """And nowhere else: not in float32, not in other layouts, not where types are mixed, not among plain operations."""
    monkeypatch.setattr(kernels, "norm_relu", None)  # a call raises
    norm, x = layer(), maps(1)
    norm_relu(norm, x.float().requires_grad_()).sum().backward()
    with torch.autocast("cpu", torch.bfloat16):
        norm_relu(norm, x.contiguous().requires_grad_()).sum().backward()
        norm_relu(norm, x, maps(2).float())
        with plain_operations():
            norm_relu(norm, x)
        with torch.no_grad():
            norm_relu(norm, x.clone())
        with pytest.raises(TypeError):
            norm_relu(norm, x)


def test_a_broken_number_is_not_lost():
    x = maps(1)
    x[0, 3, 4, 4] = torch.nan
    with torch.autocast("cpu", torch.bfloat16):
        out, d_x, *_ = gradients(layer(), x, None, maps(2))
    for each in (out, d_x):
        assert each[0, :8].isnan().all()  # its group of eight channels
        assert not each[0, 8:].isnan().any()
        assert not each[1].isnan().any()


def test_a_step_of_training_goes_downhill():
    """The gradient is that of a loss: a small step against it lowers the loss by what the gradient says."""
    norm, wanted = layer(), maps(5).float()
    convolution = nn.Conv2d(16, 16, 3, padding=1)
    x = maps(1).float()

    def loss():
        with torch.autocast("cpu", torch.bfloat16):
            return F.mse_loss(norm_relu(norm, convolution(x)).float(), wanted)

    parameters = [*norm.parameters(), *convolution.parameters()]
    before = loss()
    d = torch.autograd.grad(before, parameters)
    squares = sum((g**2).sum() for g in d)
    step = 0.05 / squares.sqrt()
    with torch.no_grad():
        for p, g in zip(parameters, d, strict=True):
            p -= step * g
    assert (before - loss()).item() == pytest.approx((step * squares).item(), rel=0.15)
