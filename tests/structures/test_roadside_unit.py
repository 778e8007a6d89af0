"""Roadside units from a configuration: what they say, and what is refused."""

import math

import numpy as np
import pytest

from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.roadside_unit import MountedUnit, mounted_units

SECTION = {"X_M": -30.0, "Y_M": 2.5, "Z_M": 2.8, "YAW_DEG": 90, "PITCH_DOWN_DEG": 15}


def test_degrees_become_radians_and_both_sensors_are_there():
    unit = MountedUnit.from_config(SECTION)
    assert unit == MountedUnit(-30.0, 2.5, 2.8, math.pi / 2, math.pi / 12)
    assert unit.sources == ("infra_camera", "infra_lidar")
    assert MountedUnit.from_config({**SECTION, "CAMERA": False}).sources == ("infra_lidar",)
    assert MountedUnit.from_config({**SECTION, "LIDAR": False}).sources == ("infra_camera",)


def test_its_frame_stands_on_the_floor_below_it_and_faces_as_it_does():
    """One metre ahead of a unit that faces +y is one metre farther along y."""
    np.testing.assert_allclose(MountedUnit.from_config(SECTION).world_from_unit.apply([1.0, 0.0, 0.0]), [-30, 3.5, 0])


@pytest.mark.parametrize("change", [{}, {"CAMERA": False}, {"YAW_DEG": -179.3, "PITCH_DOWN_DEG": 0.7}])
def test_a_unit_survives_being_written(change):
    written = MountedUnit.from_config({**SECTION, **change}).as_config()
    assert written == {**SECTION, "CAMERA": True, "LIDAR": True, **change}


def test_units_are_numbered_by_their_place_and_an_absent_section_has_none():
    assert mounted_units(None) == ()
    assert [unit.x_m for unit in mounted_units([SECTION, {**SECTION, "X_M": 4}])] == [-30.0, 4.0]


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ([], "ROADSIDE_UNITS: expected a list of at least one"),
        ({"X_M": 1}, "ROADSIDE_UNITS: expected a list of at least one"),
        ([SECTION, 3], r"ROADSIDE_UNITS\.1: expected a section"),
        ([{**SECTION, "YAW": 3}], r"ROADSIDE_UNITS\.0: unknown key YAW; known: X_M"),
        ([{key: value for key, value in SECTION.items() if key != "Z_M"}], "missing key Z_M"),
        ([{**SECTION, "X_M": "far"}], r"X_M: expected a number, found 'far'"),
        ([{**SECTION, "LIDAR": 1}], r"LIDAR: expected true or false, found 1"),
        ([{**SECTION, "Z_M": 0.0}], "height above 0"),
        ([{**SECTION, "PITCH_DOWN_DEG": 91}], "pitch of -90 to 90"),
        ([{**SECTION, "Y_M": float("nan")}], "finite"),
        ([{**SECTION, "CAMERA": False, "LIDAR": False}], "a camera, a LiDAR or both"),
    ],
)
def test_what_cannot_be_is_one_clear_error(section, message):
    with pytest.raises(ConfigError, match=message):
        mounted_units(section)
