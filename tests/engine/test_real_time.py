"""What a half says of itself after it has run: ticks, memory, and the table of both."""

import mmap
import sys

import pytest

from pcdet_avp.engine import real_time
from pcdet_avp.engine.real_time import MemorySamples, RealTimeReport, resident_mb, table


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands until it is moved on."""

    class Clock:
        now_s = 100.0

        def monotonic(self):
            return self.now_s

    clock = Clock()
    monkeypatch.setattr(real_time, "time", clock)
    return clock


def test_ticks_between_the_first_and_the_last_that_were_not_done_are_dropped(clock):
    report = RealTimeReport("vehicle", "numpy", 20.0)
    for number in (7, 8, 10, 14):
        report.tick(number)
    clock.now_s += 8.0
    found = report.as_json()
    assert found["ticks"] == {"asked_hz": 20.0, "due": 8, "done": 4, "dropped": 4}
    assert found["rate_hz"] == 0.5
    report.clear()
    assert report.as_json()["ticks"]["due"] == 0


def test_a_leak_is_the_slope_of_the_second_half(clock, monkeypatch):
    sizes = iter([300.0, 400.0, 401.0, 402.0, 403.0])  # a step while it warms up, then 1 MB every 30 s
    monkeypatch.setattr(real_time, "resident_mb", lambda: next(sizes))
    memory = MemorySamples(period_s=5.0)
    memory.sample()
    for _ in range(4):
        clock.now_s += 3.0
        memory.sample()  # too early
        clock.now_s += 27.0
        memory.sample()
    found = memory.as_json()
    assert found["samples"] == [[0.0, 300.0], [30.0, 400.0], [60.0, 401.0], [90.0, 402.0], [120.0, 403.0]]
    assert (found["first_mb"], found["last_mb"], found["peak_mb"]) == (300.0, 403.0, 403.0)
    assert found["growth_mb_per_minute"] == pytest.approx(2.0)


def test_where_memory_is_not_known_there_is_no_figure(monkeypatch):
    for known in ("resident_mb", "largest_mb"):
        monkeypatch.setattr(real_time, known, lambda: None)
    memory = MemorySamples()
    memory.sample()
    none = dict.fromkeys(["first_mb", "last_mb", "peak_mb", "growth_mb_per_minute", "largest_ever_mb"])
    assert memory.as_json() == {**none, "samples": []}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_resident_memory_counts_what_is_written_to():
    before = resident_mb()
    with mmap.mmap(-1, 64 << 20) as fresh:  # pages of its own: an allocator may hand out what it holds already
        for page in range(0, len(fresh), mmap.PAGESIZE):
            fresh[page] = 1
        assert 60 < resident_mb() - before < 90
    assert real_time.largest_mb() > before


def test_the_table_has_a_row_for_every_stage_and_one_for_the_age(clock):
    report = RealTimeReport("vehicle", "numpy", 20.0)
    for stage, seconds in (("fuse", 0.010), ("fuse", 0.030)):
        with report.times(stage):
            pass
        report.times.wall[stage].add(seconds)
    report.ages.add(0.08)
    report.tick(1)
    clock.now_s += 1.0
    head, ticks, titles, fuse, age, memory = table(report.as_json())
    assert head.startswith("vehicle: numpy 2")
    assert "1 of 1 ticks, 0 dropped" in ticks
    assert [titles.split()[i] for i in (0, -1)] == ["ms", "mean"]
    assert fuse.split()[:2] == ["fuse", "4"]
    assert age.split()[-5:] == ["1", "80.0", "80.0", "80.0", "80.0"]
    assert "too short for a slope" in memory or "not measured" in memory
