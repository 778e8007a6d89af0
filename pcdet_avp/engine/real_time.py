"""What one half of the network can say of itself after it has run in real time: rate, stages, ages, ticks, memory.

Ticks are numbered by a clock that both halves share, ``rate_hz`` of them a second. One that a half had no time for is
dropped: there is no queue in which old frames wait. Importing this module imports no torch.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from pcdet_avp.deploy.runtime import allowed_threads
from pcdet_avp.structures.stage_times import Durations, StageTimes

PERCENTILES = (50, 95, 99)
MEMORY_PERIOD_S = 5.0
MEGABYTE = 1 << 20
STATM = Path("/proc/self/statm")  # Linux: pages of this process, resident ones second
FRAME = "whole frame"


def resident_mb() -> float | None:
    """Resident memory of this process in MB (2^20 bytes); None where the system does not say."""
    if not sys.platform.startswith("linux"):
        return None
    import resource

    return int(STATM.read_text().split()[1]) * resource.getpagesize() / MEGABYTE


def largest_mb() -> float | None:
    """The largest that ``resident_mb`` ever was, compiling and loading included."""
    if not sys.platform.startswith("linux"):
        return None
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


class MemorySamples:
    """Resident memory over time: one sample every ``period_s``."""

    def __init__(self, period_s: float = MEMORY_PERIOD_S) -> None:
        self._period_s, self._began_s = period_s, time.monotonic()
        self.samples: list[tuple[float, float]] = []  # seconds since the start, MB

    def sample(self) -> None:
        """Take one, where the last is old enough."""
        now_s = time.monotonic() - self._began_s
        if not self.samples or now_s >= self.samples[-1][0] + self._period_s:
            found = resident_mb()
            if found is not None:
                self.samples.append((round(now_s, 1), round(found, 1)))

    @property
    def growth_mb_per_minute(self) -> float | None:
        """Slope of the line through the second half's samples (least squares); None of fewer than three samples."""
        later = np.array([s for s in self.samples if s[0] >= self.samples[-1][0] / 2])
        return float(60 * np.polyfit(*later.T, 1)[0]) if len(later) >= 3 else None

    def as_json(self) -> dict[str, Any]:
        """first, last and peak of the samples (MB), growth_mb_per_minute of the second half, the samples [[s, MB]];
        and largest_ever_mb of the process."""
        sizes = [size for _, size in self.samples] or [None]
        growth = self.growth_mb_per_minute
        return {
            "first_mb": sizes[0],
            "last_mb": sizes[-1],
            "peak_mb": max(sizes, key=lambda size: size or 0),
            "growth_mb_per_minute": None if growth is None else round(growth, 3),
            "largest_ever_mb": largest_mb() and round(largest_mb(), 1),
            "samples": [list(sample) for sample in self.samples],
        }


class RealTimeReport:
    """One half's figures. ``half``: its name for a reader; ``runtime``: torch, onnxruntime or openvino."""

    def __init__(self, half: str, runtime: str, rate_hz: float) -> None:
        self.half, self.runtime, self.rate_hz = half, f"{runtime} {_version(runtime)}", rate_hz
        self.clear()

    def clear(self) -> None:
        """Begin anew: the time in which things were compiled, or nobody was there, does not count."""
        self.times, self.ages, self.memory = StageTimes(), Durations(), MemorySamples()
        self._first, self._last, self.done, self._began_s = None, None, 0, time.monotonic()

    def tick(self, number: int) -> None:
        """A frame of this tick is done."""
        self._first = number if self._first is None else self._first
        self._last, self.done = max(number, self._last or 0), self.done + 1
        self.memory.sample()

    @property
    def due(self) -> int:
        """Ticks from the first that was done to the last."""
        return 0 if self._first is None else self._last - self._first + 1

    def as_json(self, **more: Any) -> dict[str, Any]:
        """The keys that docs/deploy.md lists; ``more`` go beside them."""
        seconds = time.monotonic() - self._began_s
        return {
            "half": self.half,
            "runtime": self.runtime,
            "threads": allowed_threads(),
            "seconds": round(seconds, 1),
            "ticks": {"asked_hz": self.rate_hz, "due": self.due, "done": self.done, "dropped": self.due - self.done},
            "rate_hz": round(self.done / seconds, 2) if self.done else 0.0,
            "age_ms": _in_ms(self.ages) if self.ages.count else None,
            "stages": {
                stage: {"wall_ms": _in_ms(wall), "processor_ms": _in_ms(self.times.processor[stage])}
                for stage, wall in self.times.wall.items()
            },
            "memory": self.memory.as_json(),
            **more,
        }


def table(report: dict[str, Any]) -> Iterator[str]:
    """Lines for a terminal of what ``RealTimeReport.as_json`` gives."""
    ticks, memory = report["ticks"], report["memory"]
    yield f"{report['half']}: {report['runtime']}, threads: {report['threads']}, {report['seconds']:.0f} s"
    yield (
        f"  {report['rate_hz']:.1f} of {ticks['asked_hz']:g} Hz: {ticks['done']} of {ticks['due']} ticks, "
        f"{ticks['dropped']} dropped"
    )
    heads = f"{'wall: p50':>10}{'p95':>8}{'p99':>8}{'largest':>9}  {'processor: p50':>15}{'mean':>8}"
    yield f"  {'ms':<22}{'calls':>7}  {heads}"
    rows = {stage: (of["wall_ms"], of["processor_ms"]) for stage, of in report["stages"].items()}
    if report["age_ms"]:
        rows["age of the maps"] = (report["age_ms"], None)
    for stage, (wall, processor) in rows.items():
        cells = f"{wall['p50']:10.1f}{wall['p95']:8.1f}{wall['p99']:8.1f}{wall['largest']:9.1f}"
        more = f"  {processor['p50']:15.1f}{processor['mean']:8.1f}" if processor else ""
        yield f"  {stage:<22}{wall['count']:7}  {cells}{more}"
    yield f"  memory: {_memory_line(memory)}"


def _memory_line(memory: dict[str, Any]) -> str:
    if memory["first_mb"] is None:
        return "not measured on this system"
    growth = memory["growth_mb_per_minute"]
    slope = "too short for a slope" if growth is None else f"{growth:+.2f} MB a minute in the second half"
    ever = f"largest since the process began {memory['largest_ever_mb']:.0f}"
    return f"{memory['first_mb']:.0f} MB, at the end {memory['last_mb']:.0f}, {ever}; {slope}"


def _in_ms(durations: Durations) -> dict[str, float]:
    percentiles = {f"p{p}": durations.percentile_s(p) for p in PERCENTILES}
    found = {**percentiles, "largest": durations.largest_s, "mean": durations.mean_s}
    return {"count": durations.count, **{name: round(1e3 * s, 3) for name, s in found.items() if not math.isnan(s)}}


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "(not installed)"
