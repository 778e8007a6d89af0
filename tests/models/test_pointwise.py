"""Convolutions without overlap as matrix products, against torch's convolutions in float64."""

import pytest
import torch
from torch import nn
from torch.nn import functional as F

from pcdet_avp.models import pointwise as module
from pcdet_avp.models.cpu_kernels.dispatch import plain_operations
from pcdet_avp.models.pointwise import (
    BlockConvTranspose2d,
    PointwiseConv2d,
    PointwiseConvTranspose2d,
    convolve_to_cells_last,
)


def image(layout=torch.contiguous_format):
    generator = torch.Generator().manual_seed(0)
    return torch.randn(2, 6, 5, 7, generator=generator).contiguous(memory_format=layout)


def result_and_gradients(layer, x):
    x = x.clone().requires_grad_()
    out = layer(x)
    toward = torch.randn(out.shape, generator=torch.Generator().manual_seed(1)).to(out)
    return out, *torch.autograd.grad(out, [x, *layer.parameters()], toward)


def compare(layer, reference, x):
    reference.load_state_dict(layer.state_dict())  # the same names and shapes
    expected = result_and_gradients(reference.double(), x.double())
    for found, exact in zip(result_and_gradients(layer, x), expected, strict=True):
        torch.testing.assert_close(found.double(), exact, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("bias", [False, True])
@pytest.mark.parametrize("stride", [1, 2])
def test_equals_the_convolution(stride, bias, layout):
    torch.manual_seed(0)
    layer = PointwiseConv2d(6, 4, stride, bias)
    compare(layer, nn.Conv2d(6, 4, 1, stride, bias=bias), image(layout))


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_cells_last_equals_the_convolution(layout):
    torch.manual_seed(0)
    layer = PointwiseConv2d(6, 4, cells_last=True)
    compare(layer, nn.Conv2d(6, 4, 1), image(layout))
    assert layer(image(layout)).permute(0, 2, 3, 1).is_contiguous()


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_equals_the_transposed_convolution(layout):
    torch.manual_seed(0)
    compare(PointwiseConvTranspose2d(6, 4), nn.ConvTranspose2d(6, 4, 1, bias=False), image(layout))


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("side", [2, 3])
def test_a_pixel_becomes_the_block_of_the_transposed_convolution(side, layout):
    torch.manual_seed(0)
    layer = BlockConvTranspose2d(6, 4, side)
    compare(layer, nn.ConvTranspose2d(6, 4, side, side, bias=False), image(layout))
    assert layer(image(layout)).is_contiguous(memory_format=layout)  # as what comes next reads it


def test_without_gradients_it_is_the_convolution_to_the_bit(monkeypatch):
    monkeypatch.setattr(module, "pointwise", None)  # a call would raise
    layer, x = PointwiseConv2d(6, 4), image()
    with torch.no_grad():
        assert torch.equal(layer(x), F.conv2d(x, layer.weight, layer.bias))
        assert torch.equal(convolve_to_cells_last(x, layer.weight, layer.bias), layer(x))
        assert not PointwiseConvTranspose2d(6, 4)(x * 0).any()
    with plain_operations():
        layer(x)
    with torch.autocast("cpu", torch.bfloat16):
        assert layer(x).dtype == torch.bfloat16
