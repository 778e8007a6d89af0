"""The paper's six combinations and their names."""

from itertools import product

import pytest

from pcdet_avp.errors import SensorError
from pcdet_avp.structures.sensor_set import (
    EGO_SOURCES,
    INFRA_SOURCES,
    SENSOR_SETS,
    SOURCES,
    SensorSet,
    agent_of,
    combos_with,
    modality_of,
)


def test_six_combinations_in_the_order_of_the_papers_tables():
    assert list(SENSOR_SETS) == ["C+none", "C+C", "C+CL", "CL+none", "CL+C", "CL+CL"]


@pytest.mark.parametrize("name", SENSOR_SETS)
def test_a_name_says_which_sources_are_present(name):
    vehicle, infra = name.split("+")
    expected = ("C" in vehicle, "L" in vehicle, "C" in infra, "L" in infra)
    sensors = SensorSet.parse(name)
    assert dict(zip(SOURCES, sensors.mask, strict=True)) == dict(zip(SOURCES, expected, strict=True))
    assert sensors.sources == tuple(source for source, present in zip(SOURCES, expected, strict=True) if present)
    assert sensors.name == name
    assert sensors.uses_infra == (infra != "none")


def test_each_agent_has_a_camera_and_a_lidar():
    assert (*EGO_SOURCES, *INFRA_SOURCES) == SOURCES
    for agent, sources in (("ego", EGO_SOURCES), ("infra", INFRA_SOURCES)):
        assert [(agent_of(source), modality_of(source)) for source in sources] == [(agent, "camera"), (agent, "lidar")]


@pytest.mark.parametrize("name", ["", "c+c", "L+none", "CL", "CL+L", "CL+CL "])
def test_unknown_names_are_refused_with_the_known_ones(name):
    with pytest.raises(SensorError, match=r"C\+none, C\+C, .*CL\+CL"):
        SensorSet.parse(name)


def test_a_set_outside_the_paper_has_no_short_name():
    named = 0
    for mask in product([False, True], repeat=4):
        sensors = SensorSet(*mask)
        if sensors in SENSOR_SETS.values():
            named += bool(sensors.name)
        else:
            with pytest.raises(SensorError, match="none of the combinations"):
                _ = sensors.name
    assert named == 6


@pytest.mark.parametrize(
    ("sources", "combos"),
    [
        (SOURCES, list(SENSOR_SETS)),
        (("ego_lidar", "infra_lidar"), ["CL+none", "CL+CL"]),
        (("ego_camera", "infra_camera"), ["C+none", "C+C"]),
        (("ego_camera", "ego_lidar"), ["C+none", "CL+none"]),
        (("ego_lidar",), ["CL+none"]),
        (("ego_camera", "infra_lidar"), ["C+none", "C+CL"]),
        (("infra_camera", "infra_lidar"), []),
    ],
)
def test_recordings_show_the_combinations_that_their_sensors_make_each_once(sources, combos):
    assert combos_with(sources) == combos
