"""Sums over four neighbouring pixels against the sum written out, and its gradients by torch."""

import torch
from torch.nn import functional as F

from pcdet_avp.models.backbones_2d.map_to_bev.pixel_bags import (
    add_table_gradient,
    bag_sum,
    bag_sum_with_weight_gradient,
    corner_offsets,
)

COLUMNS = 5
CORNERS = corner_offsets(COLUMNS)


def inputs(voxels=17, rows=4, channels=2):
    generator = torch.Generator().manual_seed(0)
    table = torch.randn(rows * COLUMNS, channels, generator=generator)
    row = torch.randint(0, rows - 1, (voxels,), generator=generator)
    first = (row * COLUMNS + torch.randint(0, COLUMNS - 1, (voxels,), generator=generator)).int()
    return table, first, torch.rand(voxels, 4, generator=generator)


def test_corners_of_an_image_five_pixels_wide():
    assert CORNERS == (0, 1, 5, 6)


def test_equals_the_sum_written_out():
    table, first, weights = inputs()
    expected = torch.zeros(len(first), table.shape[1])
    for voxel in range(len(first)):
        for corner, offset in enumerate(CORNERS):
            expected[voxel] += weights[voxel, corner] * table[int(first[voxel]) + offset]
    torch.testing.assert_close(bag_sum(table, first, weights, CORNERS), expected)


def test_gradients_equal_torchs():
    table, first, weights = (t.requires_grad_(t.is_floating_point()) for t in inputs())
    rows = (first[:, None] + torch.tensor(CORNERS)).long()
    out = (F.embedding(rows, table) * weights[..., None]).sum(1)
    grad = torch.randn(out.shape, generator=torch.Generator().manual_seed(1))
    d_table, d_weights = torch.autograd.grad(out, (table, weights), grad)
    found = torch.zeros_like(table.detach())
    add_table_gradient(found, first, weights.detach(), CORNERS, grad)
    torch.testing.assert_close(found, d_table)
    sums, found = bag_sum_with_weight_gradient(table, first, weights, CORNERS, grad)
    torch.testing.assert_close(found, d_weights)
    torch.testing.assert_close(sums, out.detach())
