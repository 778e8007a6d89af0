"""Loss rates and burst lengths against the two-state chain's closed forms."""

import numpy as np
import pytest

from pcdet_avp.errors import LinkError
from pcdet_avp.link import LossModel
from pcdet_avp.link.loss import LossProcess

BLOCKS = 100_000


def losses(model, slots=None, seed=0):
    process = LossProcess(model, np.random.default_rng(seed))
    return np.array([process.loses(slot) for slot in (range(1, BLOCKS + 1) if slots is None else slots)])


def burst_lengths(lost):
    edges = np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]])))
    return edges[1::2] - edges[::2]


@pytest.mark.parametrize("share", [0.0, 0.05, 0.2, 1.0])
def test_independent_losses(share):
    lost = losses(LossModel.independent(share))
    assert lost.mean() == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / BLOCKS))
    pairs = (lost[1:] & lost[:-1]).mean()
    assert pairs == pytest.approx(share**2, abs=0.005)


def test_bursts_have_their_mean_length_and_share():
    model = LossModel.bursty(0.1, mean_burst_slots=8)
    lost = losses(model)
    assert model.mean_loss == pytest.approx(0.1)
    assert lost.mean() == pytest.approx(0.1, abs=0.015)
    assert burst_lengths(lost).mean() == pytest.approx(8, rel=0.1)


def test_gilbert_elliott_loses_in_both_states():
    model = LossModel(good_to_bad=0.02, bad_to_good=0.08, loss_in_good=0.01, loss_in_bad=0.6)
    assert model.mean_loss == pytest.approx(0.2 * 0.6 + 0.8 * 0.01)
    assert losses(model).mean() == pytest.approx(model.mean_loss, abs=0.015)


def test_idle_slots_pass_too():
    """Every 100th slot only: far longer than a burst, so neighbours are independent."""
    model = LossModel.bursty(0.2, mean_burst_slots=5)
    lost = losses(model, slots=range(1, 100 * 20_000, 100))
    assert lost.mean() == pytest.approx(0.2, abs=0.02)
    assert (lost[1:] & lost[:-1]).mean() == pytest.approx(0.04, abs=0.01)


def test_same_seed_same_losses():
    model = LossModel.bursty(0.2, 5)
    assert (losses(model, range(1, 500), seed=3) == losses(model, range(1, 500), seed=3)).all()


@pytest.mark.parametrize("make", [lambda: LossModel.independent(1.1), lambda: LossModel.bursty(0.1, 0.5),
                                  lambda: LossModel.bursty(1.0, 5), lambda: LossModel.bursty(0.9, 1),
                                  lambda: LossModel.independent(float("nan"))])  # fmt: skip
def test_what_is_no_probability_is_refused(make):
    with pytest.raises(LinkError):
        make()
