"""The one-cycle schedule against numbers worked out by hand, and against torch's own."""

import math

import pytest
import torch

from pcdet_avp.engine.training.optimizer import build_optimizer, set_point
from pcdet_avp.engine.training.schedule import OneCycle
from pcdet_avp.errors import ConfigError

CYCLE = OneCycle(total=1000, peak_lr=0.003)


def test_starts_at_a_tenth_peaks_at_forty_percent_ends_at_almost_nothing():
    assert CYCLE.at(0) == pytest.approx((0.0003, 0.95))
    assert CYCLE.at(400) == pytest.approx((0.003, 0.85))
    assert CYCLE.at(1000) == pytest.approx((0.0003 / 1e4, 0.95))


def test_half_way_up_and_down_is_the_mean_of_the_ends():
    assert CYCLE.at(200) == pytest.approx(((0.0003 + 0.003) / 2, 0.90))
    assert CYCLE.at(700) == pytest.approx(((0.003 + 3e-8) / 2, 0.90))


def test_a_quarter_up_lies_on_the_cosine():
    assert CYCLE.at(100)[0] == pytest.approx(0.003 - 0.0027 * (1 + math.cos(math.pi / 4)) / 2)


def test_is_torchs_one_cycle_where_the_peak_falls_on_an_iteration():
    # torch counts total - 1 steps between its ends and puts its peak at pct_start * total - 1: 401 of 1001 is 400.
    parameter = torch.nn.Parameter(torch.zeros(1))
    optimizer = torch.optim.AdamW([parameter], lr=1.0, betas=(0.9, 0.99))
    theirs = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, 0.003, total_steps=1001, pct_start=401 / 1001, div_factor=10, final_div_factor=1e4
    )
    for iteration in range(1001):
        group = optimizer.param_groups[0]
        assert (group["lr"], group["betas"][0]) == pytest.approx(CYCLE.at(iteration), rel=1e-9)
        optimizer.step()
        if iteration < 1000:
            theirs.step()


def test_a_cycle_shortened_at_the_start_has_the_same_shape():
    short = CYCLE.ending_at(10, iteration=0)
    assert [short.at(k) for k in range(11)] == [pytest.approx(CYCLE.at(100 * k)) for k in range(11)]


@pytest.mark.parametrize("total", [300, 1000, 5000])
@pytest.mark.parametrize("iteration", [200, 280])
def test_a_change_of_length_on_the_way_makes_no_jump_and_ends_at_the_end(total, iteration):
    changed = CYCLE.ending_at(total, iteration)
    assert changed.at(iteration) == pytest.approx(CYCLE.at(iteration))
    assert changed.at(total) == pytest.approx(CYCLE.at(1000))
    half = iteration + (total - iteration) / 2
    assert changed.share(half) == pytest.approx((iteration / 1000 + 1) / 2)


def test_values_are_plain_floats_that_a_safe_loader_accepts(tmp_path, toy):
    optimizer = build_optimizer(toy.ToyNetwork(), toy.OPTIMIZATION)
    set_point(optimizer, *CYCLE.at(123))
    torch.save(optimizer.state_dict(), tmp_path / "optimizer.pth")
    loaded = torch.load(tmp_path / "optimizer.pth", weights_only=True)
    assert loaded["param_groups"][0]["lr"] == CYCLE.at(123)[0]


@pytest.mark.parametrize("change", [{"LR": 0.0}, {"PCT_START": 1.0}, {"MOMS": [0.9]}, {"DIV_FACTOR": 0.5}])
def test_nonsense_is_refused(toy, change):
    with pytest.raises(ConfigError, match=next(iter(change))):
        OneCycle.from_config(toy.OPTIMIZATION | change, 10)


def test_no_iterations_is_refused():
    with pytest.raises(ConfigError, match="at least 1 iteration"):
        OneCycle(0, 0.003)
