"""What an episode's record says of each roadside unit, by hand."""

import pytest

from pcdet_avp.closed_loop.perception.perceiver import Message
from pcdet_avp.closed_loop.sweep.episode_row import current_columns
from pcdet_avp.closed_loop.sweep.unit_figures import UnitFigures, parse_units, pooled_units, unit_figures
from pcdet_avp.errors import EvaluationError


def heard(*units):
    """A tick in which a camera map of each of these units was used."""
    return tuple(Message("infra_camera", 1000 * (unit + 1), 0.05 * (unit + 1), unit) for unit in units)


TICKS = [heard(), heard(0, 1), heard(0, 1), heard(0), heard(0), heard(0), heard(0, 1)]


def test_maps_sizes_ages_and_gaps_of_each_unit():
    first, second = parse_units(unit_figures(TICKS, 0.05))
    assert first == UnitFigures(0, 6, 1000.0, pytest.approx(0.05), pytest.approx(0.05))
    assert second == UnitFigures(1, 3, 2000.0, pytest.approx(0.1), pytest.approx(0.15))


def test_a_unit_that_fell_silent_for_good_has_a_gap_up_to_the_end():
    assert parse_units(unit_figures([heard(0, 1)] + 8 * [heard(0)], 0.05))[1].longest_gap_s == pytest.approx(0.4)


def test_two_modalities_of_a_unit_in_one_tick_are_two_maps_and_no_gap():
    both = (Message("infra_camera", 10, 0.0), Message("infra_lidar", 20, 0.1))
    assert unit_figures([both], 0.05) == "0:2/15/0.05/0"


def test_nobody_heard():
    assert unit_figures([heard(), heard()], 0.05) == ""
    assert unit_figures([], 0.0) == ""
    assert parse_units("") == []


def test_several_episodes_are_pooled_by_maps():
    pooled = pooled_units(["0:30/1000/0.05/0.1 4:1/7/0.2/3", "", "0:10/2000/0.09/0.4"])
    assert pooled == [UnitFigures(0, 40, 1250.0, pytest.approx(0.06), 0.4), UnitFigures(4, 1, 7.0, 0.2, 3.0)]


@pytest.mark.parametrize("text", ["0", "0:1/2/3", "a:1/2/3/4", "0:1/2/3/4/5", "0:x/2/3/4"])
def test_what_is_no_unit_is_refused(text):
    with pytest.raises(EvaluationError, match="column units"):
        parse_units(text)


def test_a_line_that_an_older_version_wrote_has_no_units():
    assert current_columns({"scenario": "pedestrian", "outcome": "none", "crashed": False})["units"] == ""
