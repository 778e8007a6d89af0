"""Sums over four neighbouring pixels: gradients by finite differences and against torch's own."""

import torch
from torch.nn import functional as F

from pcdet_avp.models.pixel_bags import add_table_gradient, bag_sum, bag_sum_with_weight_gradient, corner_offsets


def inputs(samples=3, bags=7, rows=4, cols=5, channels=2):
    generator = torch.Generator().manual_seed(0)
    table = torch.randn(rows * cols, channels, generator=generator)
    first = torch.randint(0, rows - 1, (bags, samples), generator=generator) * cols
    first = (first + torch.randint(0, cols - 1, (bags, samples), generator=generator)).int()
    weights = torch.rand(bags, samples, 4, generator=generator)
    return table, first, weights, corner_offsets(cols, 1, first)


def test_corners_of_a_table_with_two_rows_per_pixel():
    assert corner_offsets(5, 2, torch.zeros(1, dtype=torch.int32)).tolist() == [0, 2, 10, 12]


def test_equals_the_sum_written_out():
    table, first, weights, corners = inputs()
    expected = sum(
        table[(first + offset).long()] * weights[..., i, None] for i, offset in enumerate(corners.tolist())
    ).sum(1)
    torch.testing.assert_close(bag_sum(table, first, weights, corners), expected)


def test_gradients_equal_those_of_the_written_out_sum():
    table, first, weights, corners = inputs()
    table.requires_grad_(), weights.requires_grad_()
    rows = (first[..., None] + corners).long()
    out = (F.embedding(rows, table) * weights[..., None]).sum((1, 2))
    grad = torch.randn(out.shape, generator=torch.Generator().manual_seed(1))
    d_table, d_weights = torch.autograd.grad(out, (table, weights), grad)
    found = torch.zeros_like(table.detach())
    add_table_gradient(found, first, weights.detach(), corners, grad)
    torch.testing.assert_close(found, d_table)
    sums, found = bag_sum_with_weight_gradient(table, first, weights, corners, grad)
    torch.testing.assert_close(found, d_weights)
    torch.testing.assert_close(sums, out.detach())
