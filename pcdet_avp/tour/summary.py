"""What the roadside changed, in words and numbers of one tour."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pcdet_avp.closed_loop.sweep.crash_statistics import Tally, max_safe_speed
from pcdet_avp.closed_loop.sweep.results import Cell, Results
from pcdet_avp.evaluation.average_precision import STRICT_IOU
from pcdet_avp.tour.results import Benchmark
from pcdet_avp.tour.tables import first_detection, metres, one_decimal
from pcdet_avp.visualization.page import Comparison

ALONE, TOGETHER = "CL+none", "CL+CL"
FEW_EPISODES = 20  # of the paper's cells
VEHICLES = {"C": "with a camera alone", "CL": "with camera and LiDAR"}
PLURALS = {"Car": "cars", "Pedestrian": "pedestrians"}


@dataclass(frozen=True)
class Findings:
    """The results of a tour that are there already; both sweeps are of one scenario, ``model`` at ``speed_mps``."""

    scenario: str
    speed_mps: float
    benchmark: Benchmark | None = None
    bandwidth: Mapping[str, Any] | None = None
    line_of_sight: Results | None = None
    model: Results | None = None

    def limit(self, combo: str) -> Tally:
        """Crashes by cruising speed with whatever is in line of sight known."""
        return self.line_of_sight.tally(self.scenario, "los", combo)

    def driven(self, combo: str) -> Cell:
        """Episodes with the network."""
        return self.model.row(self.scenario, "model", combo)[self.speed_mps]


def summary(findings: Findings) -> str:
    """One paragraph of markdown; of what has not been run yet, it says nothing."""
    sentences = []
    if findings.benchmark:
        sentences.append(_ap_sentence(findings.benchmark))
    if findings.bandwidth:
        sentences.append(_bytes_sentence(findings.bandwidth))
    if findings.line_of_sight:
        sentences.append(_limit_sentence(findings))
    if findings.model:
        sentences.append(_model_sentence(findings))
    return " ".join(sentences) or "Nothing has been measured yet."


def comparisons(findings: Findings) -> list[Comparison]:
    """The same as pairs of numbers, for a vehicle with camera and LiDAR."""
    found = list(_ap_comparisons(findings.benchmark)) if findings.benchmark else []
    if findings.line_of_sight:
        speeds = (_short_limit(findings.limit(combo)) for combo in (ALONE, TOGETHER))
        remark = "T-junction, everything in the sensors' line of sight is known"
        found.append(Comparison("Highest speed up to which no crash occurred", *speeds, remark))
    if findings.model:
        cells = [findings.driven(combo) for combo in (ALONE, TOGETHER)]
        crashes = " and ".join(f"{cell.crashes} of {cell.trials}" for cell in cells)
        remark = f"ahead of the bumper, median, {findings.speed_mps:g} m/s; crashes: {crashes}"
        found.append(
            Comparison(
                "First detection of the last-noticed road user",
                *(metres(first_detection(cell)) for cell in cells),
                remark,
            )
        )
    return found


def _ap_comparisons(result: Benchmark) -> Iterator[Comparison]:
    for name, overlap in STRICT_IOU.items():
        values = (one_decimal(result.ap(combo, name)) for combo in (ALONE, TOGETHER))
        gain = result.gains.get((TOGETHER, name))
        remark = f"3D AP in percent at IoU {overlap:g}" + (f"; gain {gain}" if gain else "")
        yield Comparison(f"Average precision, {PLURALS[name]}", *values, remark)


def _ap_sentence(result: Benchmark) -> str:
    """AP of either vehicle without a roadside, and with the roadside's camera and LiDAR."""
    changes = [
        f"for a vehicle {who} "
        + " and ".join(
            f"from **{one_decimal(result.ap(f'{vehicle}+none', name))}** to "
            f"**{one_decimal(result.ap(f'{vehicle}+CL', name))}** for {PLURALS[name]}"
            for name in STRICT_IOU
        )
        for vehicle, who in VEHICLES.items()
    ]
    overlaps = " and ".join(f"{overlap:g}" for overlap in STRICT_IOU.values())
    return (
        f"On {result.meta['frames']} frames of garages that `{result.meta['config']}` never saw, the roadside's camera "
        f"and LiDAR change the average precision (3D, in percent, at IoU {overlaps}) {', and '.join(changes)}."
    )


def _bytes_sentence(content: Mapping[str, Any]) -> str:
    sizes = {row["modality"]: row["median"] for row in content["maps"] if row["study"] == "reference"}
    texts = [f"**{size / 1000:.1f} kB** for a {name.replace('lidar', 'LiDAR')} map" for name, size in sizes.items()]
    return f"For that the roadside sends {' and '.join(texts)} (medians, everything counted)."


def _limit_sentence(findings: Findings) -> str:
    alone, together = (findings.limit(combo) for combo in (ALONE, TOGETHER))
    return (
        "At the T-junction, where everything in the sensors' line of sight is known, the car drove without a crash "
        f"{_limit(alone)} by itself and {_limit(together)} with the roadside."
    )


def _model_sentence(findings: Findings) -> str:
    alone, together = (findings.driven(combo) for combo in (ALONE, TOGETHER))
    few = ", too few episodes for a rate" if min(alone.trials, together.trials) < FEW_EPISODES else ""
    first = [metres(first_detection(cell)) for cell in (alone, together)]
    return (
        f"Driven by `{findings.model.meta.get('config')}` at {findings.speed_mps:g} m/s, it crashed in "
        f"**{alone.crashes} of {alone.trials}** episodes by itself and in **{together.crashes} of {together.trials}** "
        f"with the roadside{few}; it first detected the road user that it noticed last **{first[0]}** ahead by itself "
        f"and **{first[1]}** ahead with the roadside (medians)."
    )


def _limit(tally: Tally) -> str:
    """``up to **7 m/s**``."""
    speed = max_safe_speed(tally)
    if speed is None:
        return f"at **no speed**, not even at {min(tally):g} m/s,"
    return f"up to **{speed:g} m/s**" + (", the fastest that was run," if speed == max(tally) else "")


def _short_limit(tally: Tally) -> str:
    speed = max_safe_speed(tally)
    if speed is None:
        return f"< {min(tally):g} m/s"
    return f"{'≥ ' if speed == max(tally) else ''}{speed:g} m/s"
