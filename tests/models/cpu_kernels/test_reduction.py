"""The compressor's convolution and pooling in one pass against torch's, bit for bit."""

import pytest
import torch
from easydict import EasyDict
from torch.nn import functional as F

from pcdet_avp.models.compression.map_codec import MapCodec
from pcdet_avp.models.cpu_kernels.reduction import fits, reduced_and_pooled


def maps(batch=2, channels=16, height=6, width=10):
    return torch.randn(batch, channels, height, width, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_equals_torch_to_the_bit(layout):
    x, weight = maps().contiguous(memory_format=layout), torch.randn(4, 16, 1, 1)
    expected = F.max_pool2d(F.conv2d(x.double(), weight.double()).float(), 2)
    assert torch.equal(reduced_and_pooled(x, weight), expected)


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("cell", [(2, 4), (3, 4), (2, 5), (3, 5)])
def test_what_is_no_number_stays(value, cell):
    x, weight = maps(), torch.ones(4, 16, 1, 1)
    x[0, 3, cell[0], cell[1]] = value
    expected = F.max_pool2d(F.conv2d(x.double(), weight.double()).float(), 2)
    torch.testing.assert_close(reduced_and_pooled(x, weight), expected, equal_nan=True)


def test_only_for_inference_and_pooling_by_two():
    x, weight = maps(), torch.ones(4, 16, 1, 1)
    assert not fits(x, weight, 2)
    with torch.no_grad():
        assert fits(x, weight, 2)
        assert not fits(x, weight, 1)


def test_the_codec_sends_the_same_as_in_training():
    codec, x = MapCodec(EasyDict(), 16), maps()
    trained = codec.compress(x)[0].detach()
    with torch.no_grad():
        assert torch.equal(codec.compress(x)[0], trained)
