"""Losses by hand."""

import math

import pytest
import torch

from pcdet_avp.models.dense_heads.losses import box_loss, shared_normaliser, sigmoid_focal_loss


def test_focal_loss_by_hand():
    """A positive at p = 0.5: 0.25 * 0.5^2 * ln 2 = 0.0433; a negative at p = 0.9: 0.75 * 0.9^2 * ln 10 = 1.3988."""
    logits = torch.tensor([0.0, math.log(9)])
    loss = sigmoid_focal_loss(logits, torch.tensor([1.0, 0.0]))
    assert loss.tolist() == pytest.approx([0.25 * 0.25 * math.log(2), 0.75 * 0.81 * math.log(10)], rel=1e-5)
    assert loss[0].item() == pytest.approx(0.04332, abs=1e-5)


def test_focal_loss_gradient():
    logits = torch.linspace(-6, 6, 9, dtype=torch.float64, requires_grad=True)
    targets = torch.tensor([0.0, 1, 0, 1, 0, 1, 0, 1, 0], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: sigmoid_focal_loss(x, targets), logits)


def test_box_loss_by_hand():
    """Beyond beta = 1/9 the loss is |e| - beta / 2, below it e^2 / (2 beta)."""
    codes = torch.tensor([[1.0, 0.05, 0, 0, 0, 0, 0.3]])
    loss = box_loss(codes, torch.zeros(1, 7), torch.ones(7))[0]
    assert loss[0].item() == pytest.approx(1 - 1 / 18)
    assert loss[1].item() == pytest.approx(0.05**2 * 9 / 2)
    assert loss[6].item() == pytest.approx(math.sin(0.3) - 1 / 18)


def test_half_a_turn_costs_nothing_and_weights_scale_the_error():
    codes = torch.zeros(1, 7)
    codes[0, 6] = math.pi
    assert box_loss(codes, torch.zeros(1, 7), torch.ones(7)).sum().item() == pytest.approx(0, abs=1e-10)
    codes[0, 6] = math.pi / 2
    weights = torch.tensor([1.0] * 6 + [0.0])
    assert box_loss(codes, torch.zeros(1, 7), weights).sum() == 0


def test_normaliser_of_one_process():
    assert shared_normaliser(torch.tensor([0, 5])).tolist() == [1.0, 5.0]
