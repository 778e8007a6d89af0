"""benchmarks/pose_safety.py: which episodes are driven again."""

from argparse import Namespace
from types import SimpleNamespace

import pytest


@pytest.fixture
def pose_safety(load_benchmark, monkeypatch):
    module = load_benchmark("pose_safety")
    figures = SimpleNamespace(
        crashed=False, min_distance_m=1.0, mean_speed_mps=7.0, false_brake_share=0.0, first_detection_m=20.0
    )
    scenario = SimpleNamespace(scenario=lambda *_: None)
    monkeypatch.setattr(module, "find_scenario", lambda _: scenario)
    monkeypatch.setattr(module, "build_perceiver", lambda *_: None)
    module.driven = []
    monkeypatch.setattr(module, "run_episode", lambda *_: module.driven.append(1) or SimpleNamespace(figures=figures))
    return module


def test_episodes_are_driven_once_and_anew_with_other_sensors(pose_safety, tmp_path):
    args = Namespace(scenario="pedestrian_late", speed=8.0, trials=2, combos="C+CL", perceptions="los", seed=0)
    for height, driven in ((7.0, 2), (7.0, 2), (2.8, 4), (7.0, 4)):
        rows = pose_safety.episodes(args, {"SENSORS": {"Z_M": height}}, tmp_path / "episodes.json")
        assert len(rows) == 2
        assert len(pose_safety.driven) == driven
