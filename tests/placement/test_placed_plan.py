"""A plan written with other units reads back as them, and nothing else of it changes."""

from dataclasses import replace

import pytest
from plan_files import PLANS, floor_of

from pcdet_avp.errors import ConfigError
from pcdet_avp.placement.placed_plan import write_placed_plan
from pcdet_avp.sim.plans.read import read_plan

PLAN = PLANS / "low_deck.yaml"
PLACE = {"x_m": 30.0, "y_m": 1.5, "height_m": 2.25, "on": "ceiling"}
UNITS = [
    {"id": "U1", "mount": "ceiling_7", **PLACE, "yaw_deg": 45.0, "pitch_down_deg": 7.25, "sensors": "L", "price": 5000},
    {"id": "south_east", "mount": "x", **PLACE, "x_m": 10.0, "yaw_deg": 180.0, "pitch_down_deg": 5.0, "sensors": "CL"},
]


def test_a_placed_plan_reads_back(tmp_path):
    file = write_placed_plan(tmp_path / "placed.yaml", PLAN, "D1", UNITS)
    (floor,), old = read_plan(file).floors, floor_of("low_deck")
    first, second = floor.units
    assert (first.id, first.x_m, first.y_m, first.z_m) == ("U1", 30.0, 1.5, 2.25)
    assert (first.camera, first.lidar, second.camera, second.lidar) == (False, True, True, True)
    assert [mount.id for mount in floor.mounts] == ["ramp_top", "south_west", "north_middle", "U1", "south_east"]
    assert second.x_m == 10.0  # the mount of that name is now where the placement says
    assert replace(floor, units=old.units, mounts=old.mounts) == old


def test_an_unknown_floor(tmp_path):
    with pytest.raises(ConfigError, match="expected a floor D1, found 'D2'"):
        write_placed_plan(tmp_path / "placed.yaml", PLAN, "D2", UNITS)
