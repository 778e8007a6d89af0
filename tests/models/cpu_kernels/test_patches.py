"""Patches of normalised images against torch's operations, one after the other."""

import pytest
import torch
from torch.nn import functional as F

from pcdet_avp.models.cpu_kernels.patches import fits, normalised_patches

MEAN, STD = torch.tensor([0.4, 0.5, 0.6]).view(3, 1, 1), torch.tensor([0.2, 0.3, 0.25]).view(3, 1, 1)


def by_torch(images, side):
    below, right = (-n % side for n in images.shape[2:])
    return F.pixel_unshuffle(F.pad((images - MEAN) / STD, (0, right, 0, below)), side)


@pytest.mark.parametrize("size", [(8, 12), (9, 14), (3, 2)])
@pytest.mark.parametrize("side", [2, 4])
def test_equals_torch(size, side):
    images = torch.rand(2, 3, *size)
    found = normalised_patches(images, MEAN, STD, side)
    assert found.is_contiguous(memory_format=torch.channels_last)
    torch.testing.assert_close(found, by_torch(images, side), rtol=1e-6, atol=1e-6)


def test_a_part_of_an_image():
    images = torch.rand(1, 3, 20, 16)[:, :, 4:]
    torch.testing.assert_close(normalised_patches(images, MEAN, STD, 4), by_torch(images, 4), rtol=1e-6, atol=1e-6)


def test_bf16_where_that_is_automatic():
    images = torch.rand(1, 3, 8, 8)
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        assert fits(images)
        found = normalised_patches(images, MEAN, STD, 4)
    assert torch.equal(found, by_torch(images, 4).bfloat16())


def test_training_does_without():
    assert not fits(torch.rand(1, 3, 8, 8))
