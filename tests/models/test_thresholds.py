"""Thresholds of POST_PROCESSING by class."""

import pytest

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.thresholds import per_class


def test_a_class_that_is_not_detected_may_have_a_threshold():
    """cp_small has one for pedestrians, and is trained on recordings that label cars alone."""
    both = {"Pedestrian": 0.2, "Car": 0.3}
    assert per_class(both, ["Car", "Pedestrian"], "K") == [0.3, 0.2]
    assert per_class(both, ["Car"], "K") == [0.3]
    assert per_class(0.1, ["Car", "Pedestrian"], "K") == [0.1, 0.1]


@pytest.mark.parametrize("value", [{"Car": 0.3}, {"Car": 0.3, "Pedestrian": 0.2, "Truck": 0.1}, {}])
def test_a_missing_class_and_an_unknown_one_are_refused(value):
    with pytest.raises(ConfigError, match=r"POST_PROCESSING.K: expected Car, Pedestrian, found"):
        per_class(value, ["Car", "Pedestrian"], "K")
