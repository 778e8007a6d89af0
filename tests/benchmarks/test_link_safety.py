"""benchmarks/link_safety.py: what each setting changes, and how its episodes become a line."""

from argparse import Namespace
from types import SimpleNamespace

import pytest


@pytest.fixture(scope="module")
def link_safety(load_benchmark):
    return load_benchmark("link_safety")


def test_every_vehicle_drives_once_without_the_roadside(link_safety):
    found = link_safety.settings(Namespace(combos="C+C,C+CL,CL+CL", loss=[0.2], delays=[50.0]))
    assert found == {
        "no roadside": {"combos": "C+none,CL+none"},
        "20 % of blocks lost": {"block_loss": 0.2},
        "50 ms later": {"delay_ms": 50.0},
    }


def episode(message_age_s, **figures):
    return SimpleNamespace(figures=SimpleNamespace(**figures), message_age_s=message_age_s)


def test_a_line_counts_crashes_and_averages_what_was_measured(link_safety):
    episodes = [
        episode(crashed=True, first_detection_m=4.0, mean_speed_mps=8.0, message_age_s=None),
        episode(crashed=False, first_detection_m=float("inf"), mean_speed_mps=6.0, message_age_s=0.05),
    ]
    row = link_safety.line("50 ms later", "C+CL", 8.0, episodes)
    assert row["ci95"] == pytest.approx([0.0126, 0.9874], abs=1e-4)  # 1 of 2: (0.025 / 2, 1 - 0.025 / 2) nearly
    assert link_safety.shown(row) == ["50 ms later", "C+CL", "8", "1/2", "[1, 99]", "4.0 m", "7.0 m/s", "50 ms"]
    assert link_safety.shown(row | {"message_age_s": None})[-1] == "-"
