"""Settings of a placement study: what cannot be meant is refused by name before anything is drawn."""

from copy import deepcopy

import numpy as np
import pytest

from pcdet_avp.config import load_config, plain
from pcdet_avp.errors import ConfigError
from pcdet_avp.placement.sensors import pitch_by_height
from pcdet_avp.placement.settings import PlacementSettings

SHIPPED = plain(load_config("cfgs/placement.yaml"))


def changed(key, value):
    cfg = deepcopy(SHIPPED)
    *sections, name = key.split(".")
    section = cfg
    for each in sections:
        section = section[each]
    section[name] = value
    return PlacementSettings.from_config(cfg)


def test_the_shipped_settings_are_the_defaults():
    settings = PlacementSettings.from_config(SHIPPED)
    assert settings == PlacementSettings()
    assert [settings.sensors.price(sensors) for sensors in ("C", "L", "CL")] == [1900, 5000, 5400]
    assert settings.sensors.hfov == pytest.approx(np.pi / 2)


def test_what_hangs_there_already_costs_nothing():
    assert changed("SENSORS.PRICE", {"UNIT": 0, "CAMERA": 0, "LIDAR": 1}).sensors.price("C") == 0


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("SENSORS.PRICE.UNIT", -5, "PRICE.UNIT: expected 0 or a number above it, found -5"),
        ("SENSORS.PRICE.UNIT", "1,500", "PRICE.UNIT: expected .*'1,500'"),
        ("SENSORS.PRICE.UNIT", float("nan"), "PRICE.UNIT"),
        ("SENSORS.PRICE.LIDER", 3000, "PRICE: unknown key 'LIDER'; known: UNIT, CAMERA, LIDAR"),
        ("SENSORS.PRICE", None, "PRICE: expected UNIT, CAMERA, LIDAR, found None"),
        ("SENSORS.LIDAR", {"BEAMS": 64}, "LIDAR: missing key 'COLUMNS'"),
        ("SENSORS.CAMERA.PIXELS", 0, "PIXELS: expected a whole number, 1 or more, found 0"),  # all would be seen
        ("SENSORS.LIDAR.RETURNS", 0, "RETURNS"),
        ("SENSORS.LIDAR.BEAMS", 1, "BEAMS: expected a whole number, 2 or more, found 1"),  # no angle between beams
        ("SENSORS.LIDAR.ELEVATION_MIN_DEG", 40, "ELEVATION_MIN_DEG below ELEVATION_MAX_DEG"),
        ("SENSORS.CAMERA.HFOV_DEG", 190, "HFOV_DEG: expected degrees from 5 to below 180"),
        ("SENSORS.CAMERA.HFOV_DEG", 1.57, "HFOV_DEG: expected degrees"),  # radians
        ("SENSORS.RATE_HZ", -3, "SENSORS.RATE_HZ: expected a number above 0"),
        ("SENSORS.MAP_BYTE", 72000, "SENSORS: unknown key 'MAP_BYTE'"),
        ("SENSORS", 3, "SENSORS: expected a section"),
        ("YAWS", 0, "YAWS: expected a whole number"),
        ("SETBACK_M", -1, "SETBACK_M"),
        ("AHEAD_M", ["6 m"], "AHEAD_M"),
        ("AHEAD_M", [], "AHEAD_M"),
        ("OCCUPANCY", [0.9, 1.1], "OCCUPANCY: expected a list of 2, each a number from 0 to 1"),
        ("VEHICLE", "L", "VEHICLE: expected C or CL, found 'L'"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_name(key, value, message):
    with pytest.raises(ConfigError, match=message):
        changed(key, value)


def test_the_file_of_a_mistake_is_named(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("VEHICLE: L\n")
    with pytest.raises(ConfigError, match=r"mine\.yaml: placement: VEHICLE: expected C or CL, found 'L'"):
        PlacementSettings.read(str(file))


@pytest.mark.parametrize(("z_m", "degrees"), [(2.8, 10.0), (7.0, 30.0), (4.9, 20.0), (1.0, 5.0), (9.0, 35.0)])
def test_a_sensor_looks_down_as_the_low_ceilings_and_the_papers_do(z_m, degrees):
    """2.8 m: 10 degrees (avp_low_ceiling.yaml), 7 m: 30 (the paper), a straight line through both, within 5 to 35."""
    assert np.degrees(pitch_by_height(z_m)) == pytest.approx(degrees)
