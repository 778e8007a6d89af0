"""Age of information on sequences small enough to draw."""

import numpy as np
import pytest

from pcdet_avp.errors import LinkError
from pcdet_avp.link.age import age_at, mean_age_s


def test_the_saw_tooth():
    """Captures at 0, 1, 2 s, each 0.25 s on the way: the age climbs from 0.25 to 1.25 s, mean 0.75 s."""
    captures = np.arange(3.0)
    assert mean_age_s(captures, captures + 0.25, 0.25, 2.25) == pytest.approx(0.75)
    np.testing.assert_allclose(age_at([0.2, 0.25, 1.0, 2.0], captures, captures + 0.25), [np.inf, 0.25, 1.0, 1.0])


def test_a_capture_that_was_overtaken_changes_nothing():
    captures, arrivals = np.array([0.0, 1.0, 2.0]), np.array([0.5, 3.0, 2.5])
    np.testing.assert_allclose(age_at([2.0, 2.5, 3.5], captures, arrivals), [2.0, 0.5, 1.5])
    assert mean_age_s(captures, arrivals, 0.5, 3.5) == pytest.approx((2 * 1.5 + 1 * 1.0) / 3)


def test_the_interval_must_begin_with_a_map():
    for start, stop in ((0.0, 1.0), (1.0, 1.0)):
        with pytest.raises(LinkError):
            mean_age_s(np.array([0.0]), np.array([0.5]), start, stop)
    with pytest.raises(LinkError):
        mean_age_s(np.array([]), np.array([]), 0.0, 1.0)
