"""The sweep that a command line asks for: names and numbers however they are written, and what a folder is held to."""

import sys
from pathlib import Path

import pytest

from pcdet_avp.cli import load_arguments_config
from pcdet_avp.closed_loop.sweep.arguments import sweep_meta, sweep_of
from pcdet_avp.closed_loop.sweep.journal import open_journal
from pcdet_avp.commands.safety_eval import parse_arguments
from pcdet_avp.config import config_hash
from pcdet_avp.errors import ConfigError, RecordError, SensorError

LOOP_FILE = Path("cfgs", "closed_loop.yaml")


@pytest.fixture
def arguments(monkeypatch):
    def of(*words, scenario="pedestrian"):
        monkeypatch.setattr(sys, "argv", ["safety_eval.py", "--scenario", scenario, *words])
        return parse_arguments()

    return of


@pytest.fixture
def sweep(arguments):
    return lambda *words, **named: sweep_of(arguments(*words, **named), LOOP_FILE)


def test_combinations_and_speeds_count_once_and_may_have_spaces(sweep):
    asked = sweep(
        "--perception", "los", "--combos", "C+CL, C+none,C+CL ,", "--speeds", "5", "3", "5.0", "5.00000000000001"
    )
    assert asked.combos == ("C+CL", "C+none")
    assert asked.speeds == (5.0, 3.0)
    assert len(sweep("--perception", "los", "--combos", " all").combos) == 6


@pytest.mark.parametrize("combos", ["c+cl", "all,C+CL", "CL"])
def test_other_names_are_refused(sweep, combos):
    with pytest.raises(SensorError, match=r"unknown sensor combination"):
        sweep("--perception", "los", "--combos", combos)


def test_no_combination_at_all_is_refused(sweep):
    with pytest.raises(ConfigError, match="at least one speed and one sensor combination"):
        sweep("--perception", "los", "--combos", ",")


@pytest.mark.parametrize(
    ("fault", "idle", "works"),
    [
        ("link_cut", "C+none,CL+none", "C+none,C+C"),
        ("phantom", "CL+none", "CL+C"),
        ("dead_infra_lidar", "C+none,CL+C", "CL+CL"),
        ("dead_ego_lidar", "C+CL", "CL+none"),
        ("late_200ms", "C+none", "C+CL"),
    ],
)
def test_a_fault_that_changes_nothing_for_any_combination_is_refused(sweep, fault, idle, works):
    words = ("--perception", f"los@{fault}", "--combos")
    assert sweep(*words, works).perception == f"los@{fault}"
    with pytest.raises(ConfigError, match=rf"--fault {fault}: expected a combination with .* changes nothing"):
        sweep(*words, idle)


def test_a_plan_without_a_roadside_unit_serves_no_combination_that_has_one(sweep, tmp_path):
    text = Path("cfgs/plans/low_deck.yaml").read_text()
    bare = tmp_path / "bare.yaml"
    bare.write_text(text.partition("    units:\n")[0])
    words, scenario = ("--perception", "los", "--combos"), f"pedestrian@{bare}"
    with pytest.raises(ConfigError, match=r"expected a roadside unit \(units: ...\) for C\+C, CL\+CL, found none"):
        sweep(*words, "C+none,C+C,CL+CL", scenario=scenario)
    assert sweep(*words, "C+none,CL+none", scenario=scenario).combos == ("C+none", "CL+none")
    assert sweep("--perception", "oracle", scenario=scenario).scenario == scenario  # it needs no sensors


def test_units_of_a_drawn_garage_do_not_stand_on_a_plan(sweep):
    """Their frame is that of the drawn garages, whose mast is its origin; on a plan each site has another one."""
    words = ("--perception", "los", "--cfg", "cfgs/avp/cp_small_two_units.yaml")
    with pytest.raises(ConfigError, match=r"ROADSIDE_UNITS: places in a drawn garage; expected none with the plan"):
        sweep(*words, scenario="pedestrian@cfgs/plans/low_deck.yaml")
    assert len(sweep(*words).perceiver["data_cfg"]["ROADSIDE_UNITS"]) == 2


WIDER = ("--set", "DATA_CONFIG.POINT_CLOUD_RANGE", "[0, -22.4, -3, 44.8, 22.4, 5]")
LOWER = ("--set", "DATA_CONFIG.SENSORS.INFRA.CAMERA.Z_M", "5.0")


@pytest.mark.parametrize(
    ("perception", "change", "other"),
    [("oracle", WIDER, True), ("oracle", LOWER, False), ("los", WIDER, True), ("los", LOWER, True)]
    + [(blind, WIDER, False) for blind in ("blind", "always_slow")],
)
def test_a_folder_is_held_to_what_its_results_depend_on(sweep, tmp_path, perception, change, other):
    """The oracle knows whoever is on the vehicle's map: on another map, others."""
    with open_journal(tmp_path, sweep("--perception", perception).identity):
        pass
    changed = sweep("--perception", perception, *change).identity
    if not other:
        with open_journal(tmp_path, changed):
            return
    told = "other sensors than those of this --cfg" if perception == "los" else f"another {perception}; choose"
    with pytest.raises(RecordError, match=told), open_journal(tmp_path, changed):
        pass


def test_a_folder_of_a_version_that_did_not_say_goes_on_and_says_it_then(sweep, tmp_path):
    with open_journal(tmp_path, {"oracle": {}}):
        pass
    with open_journal(tmp_path, sweep("--perception", "oracle").identity):
        pass
    wider = sweep("--perception", "oracle", *WIDER).identity
    with pytest.raises(RecordError, match="another oracle"), open_journal(tmp_path, wider):
        pass


def test_the_hash_in_the_results_is_that_of_the_configuration_that_was_driven_with(arguments, tmp_path):
    """As in ``tools/test.py``, whose configuration has what ``--ignore_config`` says."""
    (tmp_path / "any.pth").write_bytes(b"weights that nobody reads here")
    words = ("--perception", "model", "--cfg", "cfgs/avp/cp_tiny.yaml", "--ckpt", str(tmp_path / "any.pth"))
    hashes = []
    for ignored in ((), ("--ignore_config", "CLASS_NAMES")):
        args = arguments(*words, *ignored)
        sweep = sweep_of(args, LOOP_FILE)
        meta = sweep_meta(args, sweep, 0.0)
        driven = sweep.identity["model"]["config_hash"]
        assert meta["config_hash"] == meta["perceptions"]["model"]["config_hash"] == driven
        assert driven == config_hash(load_arguments_config(args))
        hashes.append(driven)
    assert hashes[0] != hashes[1]
