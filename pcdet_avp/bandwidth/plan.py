"""What the bandwidth studies vary: how the roadside's maps reach the vehicle, and how well the pose is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pcdet_avp.errors import ConfigError
from pcdet_avp.link.map_size import UNLIMITED, MapSize
from pcdet_avp.link.precision import PRECISIONS

STUDIES = ("codec", "budget", "loss", "pose", "objects")
# The paper's largest map against its dense one (section "Feature Compression"): 72 KB of 421,120 B.
BUDGET_SHARE = 72_000 / 421_120
BUDGET_PARTS = (1, 2, 4, 8)
LOSSES = (0.01, 0.05, 0.2, 0.5, 1.0)
POSITION_STDS_M = (0.1, 0.2, 0.5, 1.0)
YAW_STDS_DEG = (0.5, 1.0, 2.0, 5.0)


@dataclass(frozen=True)
class Transmission:
    """The way a map is sent. ``precision`` None: as the float32 numbers that they are, without any bytes."""

    precision: str | None
    sparsified: bool = True  # False: with the cells that the trained threshold would drop
    size: MapSize = UNLIMITED
    loss: float = 0.0  # of every transport block


@dataclass(frozen=True)
class StudyPoint:
    """One row of a study. Without ``transmission`` nothing is sent; ``objects``: boxes are sent instead of maps, which
    arrive as they are or, where ``coded``, as ETSI's message leaves them.

    The errors are standard deviations of the vehicle's own pose, per axis.
    """

    study: str
    label: str
    transmission: Transmission | None = None
    position_std_m: float = 0.0
    yaw_std_deg: float = 0.0
    objects: bool = False
    coded: bool = True


ALONE = StudyPoint("reference", "vehicle alone")
UNCODED_BOXES = StudyPoint("objects", "boxes, not quantised", objects=True, coded=False)
BOXES = StudyPoint("objects", "boxes (late fusion)", objects=True)


def reference(precision: str, size: MapSize) -> StudyPoint:
    """What the network sends as it was trained and configured: everything else is held against it."""
    return StudyPoint("reference", f"{precision}, as trained", Transmission(precision, size=size))


def make_plan(studies: Sequence[str], precision: str, budget_bytes: int, size: MapSize = UNLIMITED) -> list[StudyPoint]:
    """The points of the studies, the two references first. ``size``: what MODEL.COMPRESSION allows a map."""
    as_trained = reference(precision, size)
    unknown = [name for name in studies if name not in STUDIES]
    if unknown or not studies:
        raise ConfigError(f"--studies: expected some of {', '.join(STUDIES)}, found {', '.join(studies) or 'none'}")
    of_study = {
        "codec": _codec(precision, size),
        "budget": _budgets(budget_bytes),
        "loss": [StudyPoint("loss", f"{100 * p:g} % lost", Transmission(precision, size=size, loss=p)) for p in LOSSES],
        "pose": _poses(as_trained.transmission),
        "objects": [UNCODED_BOXES, BOXES],
    }
    return [ALONE, as_trained, *(point for name in STUDIES if name in studies for point in of_study[name])]


def _codec(precision: str, size: MapSize) -> list[StudyPoint]:
    others = [name for name in PRECISIONS if name != precision]
    limited = size.max_bytes is not None
    return [
        StudyPoint("codec", "not thinned, not rounded", Transmission(None, sparsified=False)),
        StudyPoint("codec", "thinned, not rounded", Transmission(None)),
        *([StudyPoint("codec", f"{precision}, no limit on bytes", Transmission(precision))] if limited else []),
        *(StudyPoint("codec", f"{name}, not trained for", Transmission(name)) for name in others),
    ]


def _budgets(budget_bytes: int) -> list[StudyPoint]:
    return [
        StudyPoint(
            "budget", f"{name}, {budget_bytes // part} B", Transmission(name, size=MapSize(budget_bytes // part))
        )
        for name in PRECISIONS
        for part in BUDGET_PARTS
    ]


def _poses(sent: Transmission | None) -> list[StudyPoint]:
    return [
        *(StudyPoint("pose", f"{std:g} m", sent, position_std_m=std) for std in POSITION_STDS_M),
        *(StudyPoint("pose", f"{std:g} deg", sent, yaw_std_deg=std) for std in YAW_STDS_DEG),
    ]


def paper_budget_bytes(shape: tuple[int, int, int]) -> int:
    """The paper's 72 KB, scaled to a latent (c, h, w) of another size."""
    channels, height, width = shape
    return round(BUDGET_SHARE * 2 * channels * height * width)
