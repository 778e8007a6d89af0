"""The lanes of a garage as strips: they meet without gaps, are as wide as lanes, and keep to the right."""

import numpy as np
import pytest

from pcdet_avp.closed_loop.export.lanelets import strips
from pcdet_avp.sim.garage import LANE_WIDTH_M
from pcdet_avp.sim.layouts import draw_layout


@pytest.fixture(scope="module")
def lanes():
    return {strip.name: strip for strip in strips(draw_layout(np.random.default_rng(0)))}


def test_there_are_six_straights_and_six_ways_across(lanes):
    assert len(lanes) == 12
    assert sum("-" in name for name in lanes) == 6


def test_lanes_meet_with_both_borders(lanes):
    for strip in lanes.values():
        for name in strip.ahead:
            following = lanes[name]
            assert strip.name in following.behind
            for border in ("left", "centre", "right"):
                np.testing.assert_allclose(getattr(strip, border)[-1], getattr(following, border)[0], atol=1e-9)


def test_lanes_are_as_wide_as_lanes_and_never_fold(lanes):
    for strip in lanes.values():
        width = np.hypot(*(strip.left - strip.right).T)
        np.testing.assert_allclose(width, LANE_WIDTH_M)
        along = np.diff(strip.centre, axis=0)
        for border in (strip.left, strip.right):
            assert (np.einsum("pi,pi->p", np.diff(border, axis=0), along) > 0).all()


def test_the_opposite_lane_lies_to_the_left(lanes):
    for strip in (lane for lane in lanes.values() if lane.opposite):
        np.testing.assert_allclose(strip.left, lanes[strip.opposite].left[::-1], atol=1e-9)
