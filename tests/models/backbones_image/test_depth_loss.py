"""Every part of the depth loss by hand, alone and together."""

import math

import pytest
import torch

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.backbones_image.depth_bins import MODES, DepthBins
from pcdet_avp.models.backbones_image.depth_loss import DepthLoss, expected_depth

BINS = DepthBins("UD", 3, 1.0, 4.0)  # centres 1.5, 2.5, 3.5
PLAIN = {"WEIGHT": 1, "ALPHA": 1, "GAMMA": 0}
NEITHER = torch.zeros(1, 1, 2, dtype=torch.bool)


def logits_of(*pixels):
    """(1, 4, 1, pixels) from the probabilities of three bins and of the outside."""
    return torch.log(torch.tensor(pixels)).T.reshape(1, len(pixels[0]), 1, len(pixels))


TWO = logits_of([0.5, 0.25, 0.125, 0.125], [0.1, 0.2, 0.3, 0.4])


def test_a_soft_target_is_shared_by_the_two_nearest_centres():
    """2.25 m lies at three quarters of the way from 1.5 to 2.5; 1.1 m lies before the first centre; 9 m is outside."""
    loss = DepthLoss({**PLAIN, "SOFT_TARGET": True})
    between = loss(TWO, torch.tensor([[[2.25, 0.0]]]), NEITHER, BINS)
    assert math.isclose(between.item(), -(0.25 * math.log(0.5) + 0.75 * math.log(0.25)), rel_tol=1e-5)
    ends = loss(TWO, torch.tensor([[[1.1, 9.0]]]), NEITHER, BINS)
    assert math.isclose(ends.item(), -(math.log(0.5) + math.log(0.4)) / 2, rel_tol=1e-5)


def test_a_soft_target_keeps_the_focal_factor_of_each_bin():
    loss = DepthLoss({"WEIGHT": 1, "ALPHA": 1, "GAMMA": 2, "SOFT_TARGET": True})
    found = loss(TWO, torch.tensor([[[2.0, 0.0]]]), NEITHER, BINS)
    expected = 0.5 * 0.5**2 * math.log(2) + 0.5 * 0.75**2 * math.log(4)
    assert math.isclose(found.item(), expected, rel_tol=1e-5)


def test_road_users_weigh_by_their_distance_within_bounds():
    """Weights 13 * 0.5 (1.2 / 10 is less), 13 * 3.9 / 2 and 13 * 3 (3.9 / 1 is more), over one known pixel each."""
    on_user = torch.tensor([[[True, False]]])
    for depth, reference, factor in ((1.2, 10.0, 0.5), (3.9, 2.0, 1.95), (3.9, 1.0, 3.0)):
        loss = DepthLoss({**PLAIN, "FG_DISTANCE_M": reference, "FG_DISTANCE_RANGE": [0.5, 3.0]})
        found = loss(TWO, torch.tensor([[[depth, 0.0]]]), on_user, BINS)
        probability = 0.5 if depth < 2 else 0.125
        assert math.isclose(found.item(), -13 * factor * math.log(probability), rel_tol=1e-5)


def test_the_expectations_relative_error_counts_road_users_inside_the_bins():
    """E = (0.5 * 1.5 + 0.25 * 2.5 + 0.125 * 3.5) / 0.875 = 2.0714 m, of 1.5 m: 38 %. The outside class has no part."""
    expected = (0.5 * 1.5 + 0.25 * 2.5 + 0.125 * 3.5) / 0.875
    assert math.isclose(expected_depth(TWO, BINS)[0, 0, 0].item(), expected, rel_tol=1e-6)
    both, depth = torch.tensor([[[True, True]]]), torch.tensor([[[1.5, 9.0]]])
    without = DepthLoss(PLAIN)(TWO, depth, both, BINS)
    found = DepthLoss({**PLAIN, "EXPECTATION_WEIGHT": 2.0})(TWO, depth, both, BINS)
    assert math.isclose((found - without).item(), 2 * (expected / 1.5 - 1), rel_tol=1e-4)


def test_an_image_without_road_users_has_no_expectation_term_and_images_add_up():
    loss = DepthLoss({**PLAIN, "EXPECTATION_WEIGHT": 2.0})
    depth, on_user = torch.tensor([[[1.5, 2.5]]]), torch.tensor([[[True, False]]])
    alone = loss(TWO, depth, on_user, BINS), loss(TWO, depth, NEITHER, BINS)
    assert alone[1] == DepthLoss(PLAIN)(TWO, depth, NEITHER, BINS)
    pair = loss(TWO.expand(2, -1, -1, -1), depth.expand(2, -1, -1), torch.cat([on_user, NEITHER]), BINS)
    torch.testing.assert_close(pair, sum(alone))


@pytest.mark.parametrize("mode", MODES)
def test_the_two_neighbours_give_the_depth_back(mode):
    """What lies between two centres, in bin position, is what their shares say; also for a single bin."""
    bins = DepthBins(mode, 9, 2.0, 40.0)
    depth = torch.linspace(2.05, 39.9, 50, dtype=torch.float64)
    pair, upper = bins.neighbours(depth)
    position = (pair[:, 0] + 0.5) * (1 - upper) + (pair[:, 1] + 0.5) * upper
    inner = bins.position(depth).clamp(0.5, 8.5)
    torch.testing.assert_close(position, inner)
    assert (pair >= 0).all()
    assert (pair < 9).all()
    torch.testing.assert_close(bins.position(bins.centres()), torch.arange(9, dtype=torch.float64) + 0.5)
    only = DepthBins(mode, 1, 2.0, 40.0).neighbours(torch.tensor([3.0, 50.0]))[0]
    assert only.tolist() == [[0, 0], [1, 1]]


def test_gradients_are_finite_where_nothing_is_known():
    logits = TWO.clone().requires_grad_()
    cfg = {"SOFT_TARGET": True, "FG_DISTANCE_M": 10.0, "EXPECTATION_WEIGHT": 2.0}
    DepthLoss(cfg)(logits, torch.zeros(1, 1, 2), ~NEITHER, BINS).backward()
    assert logits.grad.isfinite().all()
    assert not logits.grad.any()


def test_an_unknown_key_is_named():
    with pytest.raises(ConfigError, match=r"DEPTH\.LOSS: unknown key 'GAMA'; known: WEIGHT, ALPHA, GAMMA"):
        DepthLoss({"GAMA": 0})
    with pytest.raises(ConfigError, match="SOFT_TARGET must be bool, found 1"):
        DepthLoss({"SOFT_TARGET": 1})
