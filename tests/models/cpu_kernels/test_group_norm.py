"""The kernel of group norm, shortcut and ReLU against torch's operations, the formula that gradients go through."""

import pytest
import torch
from easydict import EasyDict
from torch import nn

from pcdet_avp.models.backbones_2d.base_bev_backbone import BaseBEVBackbone
from pcdet_avp.models.backbones_image.resnet import ResNet
from pcdet_avp.models.cpu_kernels import group_norm as kernels
from pcdet_avp.models.cpu_kernels.dispatch import plain_operations
from pcdet_avp.models.norm import make_norm, norm_relu


def layer(channels=16):
    torch.manual_seed(4)
    norm = make_norm("group", channels)
    nn.init.normal_(norm.weight)
    nn.init.normal_(norm.bias)
    return norm


def maps(batch=2, channels=16, height=9, width=31, mean=0.0):
    """More pixels than one chunk, in the layout that convolutions answer in."""
    generator = torch.Generator().manual_seed(6)
    x = torch.randn(batch, channels, height, width, generator=generator) + mean
    return x.contiguous(memory_format=torch.channels_last)


def both(norm, x, shortcut=None):
    """By the definition in double precision, and by the kernel, which may overwrite what it is given."""
    expected = norm.double()(x.double()) + (0 if shortcut is None else shortcut)
    with torch.no_grad():
        return expected.relu().float(), norm_relu(norm.float(), x.clone(), shortcut)


@pytest.mark.parametrize("mean", [0.0, -300.0])
@pytest.mark.parametrize("with_shortcut", [False, True])
@pytest.mark.parametrize("channels", [16, 12])
def test_equals_the_definition(channels, with_shortcut, mean):
    x = maps(channels=channels, mean=mean)
    shortcut = maps(channels=channels).flip(3) if with_shortcut else None
    expected, found = both(layer(channels), x, shortcut)
    torch.testing.assert_close(found, expected, atol=2e-6 if not mean else 2e-4, rtol=1e-5)


def test_a_constant_map_and_one_pixel():
    constant = torch.full_like(maps(), 7.3).contiguous(memory_format=torch.channels_last)
    torch.testing.assert_close(*both(layer(), constant)[::-1], atol=2e-3, rtol=0)  # of 7.3 / sqrt(eps) = 2300
    torch.testing.assert_close(*both(layer(), maps(height=1, width=1))[::-1], atol=2e-6, rtol=1e-5)


def test_the_shortcut_is_left_as_it_is():
    x, shortcut = maps(), maps().flip(2)
    before = shortcut.clone()
    both(layer(), x, shortcut)
    assert torch.equal(shortcut, before)


def test_a_broken_number_is_not_lost():
    x = maps()
    x[0, 3, 4, 4] = torch.nan
    _, found = both(layer(), x)
    assert found[0, :8].isnan().all()  # its group of eight channels
    assert not found[0, 8:].isnan().any()


def test_other_layouts_training_and_precisions_do_without(monkeypatch):
    monkeypatch.setattr(kernels, "norm_relu", None)  # a call would raise
    norm, x = layer(), maps()
    norm_relu(norm, x.requires_grad_()).sum().backward()
    assert x.grad.abs().sum() > 0
    with torch.no_grad():
        norm_relu(norm, x.contiguous(memory_format=torch.contiguous_format))
        norm_relu(make_norm("batch", 16).eval(), x)
        norm_relu(norm, x[:0])
        with torch.autocast("cpu", torch.bfloat16):
            norm_relu(norm, x)
        with pytest.raises(TypeError):
            norm_relu(norm, x)


@pytest.mark.parametrize("block", ["basic", "bottleneck"])
def test_a_residual_network_answers_as_before(block):
    torch.manual_seed(0)
    network = ResNet([2, 1], [16, 24], block, "group", stem=16).eval()
    images = torch.rand(2, 3, 33, 40).contiguous(memory_format=torch.channels_last)
    with torch.no_grad():
        with plain_operations():
            expected = network(images)
        found = network(images)
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)


def test_the_map_backbone_answers_as_before_and_as_a_plain_sequence():
    cfg = EasyDict(LAYER_NUMS=[1, 1], LAYER_STRIDES=[1, 2], NUM_FILTERS=[16, 24])
    cfg.update(UPSAMPLE_STRIDES=[1, 2], NUM_UPSAMPLE_FILTERS=[8, 8])
    torch.manual_seed(0)
    backbone, x = BaseBEVBackbone(cfg, 8).eval(), maps(channels=8, height=8, width=12)
    with torch.no_grad():
        with plain_operations():
            expected = backbone.encode(x)
            stage = nn.Sequential(*backbone.blocks[0])(x)
        torch.testing.assert_close(backbone.encode(x), expected, atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(backbone.blocks[0](x), stage, atol=1e-5, rtol=1e-5)
