"""The pages in docs/ say what is so: their code runs, and the configuration page knows every key."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

import pcdet_avp.models.fusion  # noqa: F401 - the registry is filled before a test puts it back as it was
from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.perception import factory
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.registry import FUSERS
from pcdet_avp.sim.scenarios import table
from pcdet_avp.structures.sensor_set import SensorSet

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


def python_blocks(page):
    return re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)


def run(code):
    names = {"__name__": "page"}
    exec(compile(code, "page", "exec"), names)
    return names


def keys_of(value):
    """Every key of a nested mapping, those inside lists included."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield key
            yield from keys_of(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from keys_of(inner)


NETWORKS = ("avp/cp_full.yaml", "avp/cp_small.yaml", "avp/cp_small_depth.yaml")
SECTIONS = {"_BASE_CONFIG_", "DATA_CONFIG", "MODEL", "OPTIMIZATION"}
VALUES = {"Car", "Pedestrian", "ego", "infra", "train", "test"}  # keys that are classes, agents and modes


@pytest.mark.parametrize("file", [*NETWORKS, "dataset_configs/avp_full.yaml", "closed_loop.yaml"])
def test_the_configuration_page_has_every_key(file):
    named = set(re.findall(r"`(\w+)`", (DOCS / "configuration.md").read_text(encoding="utf-8")))
    content = yaml.safe_load((ROOT / "cfgs" / file).read_text(encoding="utf-8"))
    parts = {key for key in keys_of(content) if "." in key}  # of a network, by parameters' names
    missing = set(keys_of(content)) - named - SECTIONS - VALUES - parts
    assert not missing


def test_a_map_travels_as_the_wire_page_shows(capsys):
    (code,) = python_blocks("wire_format.md")
    names = run(code)
    assert all(len(segment) <= 1475 for segment in names["segments"])
    np.testing.assert_array_equal(names["received"].values, names["latent"])
    assert capsys.readouterr().out.strip().endswith("1.5")


def test_a_frame_is_captured_as_the_simulator_page_shows(capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    (code,) = python_blocks("simulator.md")
    frame = run(code)["frame"]
    assert frame.ego.image.shape == (108, 192, 3)
    assert len(frame.labels.boxes) > 0


def test_the_fuser_of_the_extension_page_takes_the_longest_vector(monkeypatch):
    monkeypatch.setattr(FUSERS, "_classes", dict(FUSERS._classes), raising=False)
    fuser = run(python_blocks("extend.md")[0])["StrongestFusion"]({})
    maps = {0: torch.full((1, 2, 3, 4), 1.0), 2: torch.zeros(1, 2, 3, 4)}
    maps[2][0, 0, 1, 1] = 5.0
    present = {slot: torch.ones(1, 1, 3, 4, dtype=torch.bool) for slot in maps}
    fused = fuser.fuse(maps, present)
    assert fused[0, :, 1, 1].tolist() == [5.0, 0.0]
    assert fused[0, :, 0, 0].tolist() == [1.0, 1.0]


def test_the_perception_and_the_scenario_of_the_extension_page_drive(monkeypatch):
    monkeypatch.setattr(factory, "PERCEPTIONS", dict(factory.PERCEPTIONS))
    monkeypatch.setattr(table, "SCENARIOS", dict(table.SCENARIOS))
    _, perception, scenario = python_blocks("extend.md")
    run(perception)
    run(scenario)
    drive = table.find_scenario("children").scenario(0, 0, 4.0)
    settings = PerceiverSettings({"POINT_CLOUD_RANGE": [0, -30, -1, 44, 30, 3], "VOXEL_SIZE": [0.32, 0.32, 4]})
    perceiver = factory.build_perceiver("nearsighted", settings)
    log = run_episode(drive, perceiver, SensorSet.parse("C+none"))
    assert len(log.times) > 20
    heights = {actor.spec.size[2] for actor in drive.actors if actor.name == "Pedestrian"}
    assert heights
    assert max(heights) <= 1.3  # children only
