"""The decoding kernel against torch's operations."""

import math

import pytest
import torch

from pcdet_avp.models.cpu_kernels.dispatch import plain_operations
from pcdet_avp.models.dense_heads import decode_kernel
from pcdet_avp.models.dense_heads.box_coder import decode, turn_into_sector


def inputs(bins, count=3000):
    generator = torch.Generator().manual_seed(1)
    codes = torch.randn(2, count, 7, generator=generator) * 3
    anchors = torch.rand(count, 7, generator=generator) * 4 + 0.3
    anchors[:, 6] = torch.randint(-3, 4, (count,), generator=generator) * math.pi / 4
    return codes, torch.randn(2, count, bins, generator=generator), anchors


@pytest.mark.parametrize("bins", [1, 2, 4])
def test_equals_torch(bins):
    codes, directions, anchors = inputs(bins)
    codes[:, ::5, 6] = 0  # headings on the borders of sectors
    expected = decode(codes, anchors)
    heading = turn_into_sector(expected[..., 6], directions.argmax(-1), math.pi / 4, bins)
    found = decode_kernel.decode(codes, directions, anchors, math.pi / 4)
    torch.testing.assert_close(found[..., :6], expected[..., :6], atol=1e-5, rtol=1e-5)
    apart = (found[..., 6] - heading).abs()
    inner = torch.ones(codes.shape[1], dtype=torch.bool)
    inner[::5] = False  # there rounding decides between both ends of a sector
    assert torch.minimum(apart, 2 * math.pi - apart)[:, inner].max() < 1e-5
    assert (found[..., 6] >= -math.pi - 1e-6).all()
    assert (found[..., 6] < math.pi).all()


def test_equal_directions_are_the_first_one_and_broken_numbers_stay_broken():
    codes, directions, anchors = inputs(2, 4)
    codes.zero_()
    directions.zero_()
    codes[0, 1], codes[0, 2, 3], codes[0, 3, 3] = torch.nan, torch.inf, -torch.inf
    boxes = decode_kernel.decode(codes, directions, anchors, 0.0)
    assert ((boxes[1, :, 6] >= 0) & (boxes[1, :, 6] < math.pi)).all()
    assert boxes[0, 1].isnan().all()
    assert boxes[0, 2, 3] == pytest.approx(math.exp(4) * anchors[2, 3].item(), rel=1e-5)
    assert boxes[0, 3, 3] == pytest.approx(math.exp(-4) * anchors[3, 3].item(), rel=1e-5)


def test_when_it_serves():
    codes, directions, anchors = inputs(2)
    with torch.no_grad():
        assert decode_kernel.fits(codes, directions, anchors)
        assert not decode_kernel.fits(codes, None, anchors)
        assert not decode_kernel.fits(codes.double(), directions, anchors)
        with plain_operations():
            assert not decode_kernel.fits(codes, directions, anchors)
    assert not decode_kernel.fits(codes, directions, anchors)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_only_anchors_that_may_score_high_are_picked(dtype):
    """Of a cell's outputs first come all logits, then all codes, then all directions."""
    K, classes, bins, H, W = 3, 2, 2, 4, 5
    generator = torch.Generator().manual_seed(2)
    outputs = torch.randn(1, K * (classes + 7 + bins), H, W, generator=generator).to(dtype)
    outputs[0, 3, 1, 2] = torch.nan  # the second class of the second anchor
    anchors = torch.rand(H * W * K, 7, generator=generator) + 0.5
    rows = outputs[0].permute(1, 2, 0).reshape(H * W, -1).float()
    logits, codes, directions = rows.split([K * classes, K * 7, K * bins], 1)
    logits, directions = logits.reshape(-1, classes), directions.reshape(-1, bins)
    min_scores = [0.7, 0.8]
    wanted = ((logits.sigmoid() > torch.tensor(min_scores)) | logits.isnan()).any(1)
    assert 5 < wanted.sum() < H * W * K
    expected = decode_kernel.decode(codes.reshape(1, -1, 7), directions[None], anchors, 0.3)[:, wanted]
    found = decode_kernel.likely_boxes(outputs, classes, bins, anchors, 0.3, min_scores)
    torch.testing.assert_close(found[0], logits[None, wanted], rtol=0, atol=0, equal_nan=True)
    torch.testing.assert_close(found[1], expected, rtol=0, atol=0)
    everything = decode_kernel.likely_boxes(outputs, classes, bins, anchors, 0.3, [0.0, 0.0])
    assert everything[0].shape[1] == H * W * K
    assert not decode_kernel.likely_boxes(outputs.nan_to_num(), classes, bins, anchors, 0.3, [1.0, 1.0])[0].numel()
