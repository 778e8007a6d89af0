"""The documented adaptation of a network to one garage (docs/placement.md), in tiny form and from end to end."""

import csv
import json
import sys
from pathlib import Path

import pytest
from plan_files import STRAIGHT, written

from pcdet_avp.models.weights.checkpoint_file import read_checkpoint
from pcdet_avp.sim.plans.read import read_plan

CFG = Path(__file__).parents[2] / "cfgs" / "avp" / "cp_tiny.yaml"
MORE = """\
      - {id: side, start: [30, -20], hdg_deg: 90, geometry: [{line_m: 20}], lanes: {right: [3], left: [3]}}
    junctions:
      - {id: J, kind: t, at: [30, 0], roads: [main, side]}
    rows:
      - {road: main, side: left, s_m: 8, count: 8, width_m: 2.5, length_m: 5}
      - {road: main, side: right, s_m: 8, count: 6, width_m: 2.5, length_m: 5}
    lamp_rows:
      - {road: main, spacing_m: 8}
"""


@pytest.mark.slow
def test_a_network_is_adapted_to_a_plan_with_its_placed_units(call, load_tool, trained, tmp_path, monkeypatch):
    """Place sensors; data with them; test, fine-tune and test again; drive before and after."""
    monkeypatch.chdir(tmp_path)

    def tool(name, *words):
        monkeypatch.setattr(sys, "argv", [name, *map(str, words)])
        load_tool(name).main()

    sizes = "--candidates 8 --occupancies 2 --units 2 --members 0 --milp_seconds 0 --workers 1"
    tool("place_sensors", "--plan", written(tmp_path, STRAIGHT, MORE), "--out", "placement", *sizes.split())
    placed = tmp_path / "placement" / "placed.yaml"
    units = json.loads((tmp_path / "placement" / "placement.json").read_text())["front"][-1]["units"]
    assert {unit.id for unit in read_plan(placed).floors[0].units} <= {unit["id"] for unit in units}

    data = tmp_path / "site"
    site = {"data": data, "overrides": ("DATA_CONFIG.GENERATE.PLAN", placed, "DATA_CONFIG.GENERATE.SCENES", 4)}
    at_site = ("--set", "DATA_CONFIG.DATA_PATH", data, *site["overrides"])
    tool("create_data", "--cfg", CFG, "--workers", 1, *at_site)
    generator = json.loads((data / "dataset.json").read_text())["generator"]["GENERATE"]
    assert "placed.yaml" in str(generator["PLAN"])

    before = trained / "ckpt" / "checkpoint_epoch_2.pth"
    call(tmp_path, "test", "--ckpt", before, "--json", tmp_path / "before.json", **site)
    call(tmp_path, "train", "--pretrained_model", before, "--epochs", 1, "--max_minutes", 5, "--no_eval", **site)
    after = tmp_path / "output" / "avp" / "cp_tiny" / "default" / "ckpt" / "checkpoint_epoch_1.pth"
    assert read_checkpoint(after)["it"] > 0
    call(tmp_path, "test", "--ckpt", after, "--json", tmp_path / "after.json", **site)
    rows = [json.loads((tmp_path / f"{name}.json").read_text())["rows"] for name in ("before", "after")]
    assert [row["combo"] for row in rows[0]] == [row["combo"] for row in rows[1]]

    for name, ckpt in (("before", before), ("after", after)):
        how = ("--scenario", "t_junction", "--speeds", 5, "--trials", 1, "--combos", "C+CL", "--out", name)
        wheel = ("--cfg", CFG, "--plan", placed, "--perception", "model", "--ckpt", ckpt, "--workers", 1)
        tool("safety_eval", *wheel, *how, *at_site)
        with (tmp_path / name / "episodes.csv").open() as file:
            driven = [row for row in csv.DictReader(file) if row["perception"] == "model"]
        assert [(row["combo"], row["trial"]) for row in driven] == [("C+CL", "0")]
