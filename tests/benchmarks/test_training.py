"""The benchmark of training iterations: who begins, what is printed. No network runs here."""

from pathlib import Path

import pytest


@pytest.fixture
def benchmark(load_benchmark, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))  # it shares a script's helpers
    return load_benchmark("training")


def test_every_round_begins_with_another_side(benchmark):
    asked = []

    class Side:
        def __init__(self, name):
            self.name = name

        def ask(self, what):
            asked.append(self.name)
            return {benchmark.STEP: [(0.5, 9.0), (0.7, 9.0)]}

    sides = {name: Side(name) for name in benchmark.SIDES}
    numbers = [benchmark.run_round(sides, i, batch=2) for i in range(3)]
    assert asked[0::3] == list(benchmark.SIDES)
    assert numbers == [dict.fromkeys(benchmark.SIDES, pytest.approx(300.0))] * 3  # 0.6 s for two frames


def test_ratios_are_those_of_single_rounds(benchmark):
    rounds = [{"old": 100.0, "new": 50.0}, {"old": 200.0, "new": 120.0}, {"old": 400.0, "new": 280.0}]
    old, new = benchmark.table(rounds)
    assert "200 ms a frame" in old
    assert "1.00 (1.00-1.00)" in old
    assert "120 ms a frame" in new
    assert "0.60 (0.55-0.65)" in new
