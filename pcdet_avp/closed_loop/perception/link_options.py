"""Options of the link from roadside to vehicle in the closed loop, and of the vehicle's localisation noise."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pcdet_avp.errors import ConfigError
from pcdet_avp.link.loss import LossModel
from pcdet_avp.link.nr_v2x import NrV2xConfig

LINKS = ("ideal", "nr_v2x")
ANY_LINK = (
    "hold_ms",
    "cut_within_s",
    "cut_unit",
    "position_noise_m",
    "yaw_noise_deg",
)  # options that an ideal link has too


def _option(default: Any, kind: type, sentence: str) -> Any:
    return dataclasses.field(default=default, metadata={"kind": kind, "help": sentence})


@dataclass(frozen=True)
class LinkOptions:
    """``link`` is ``ideal`` (everything arrives in the tick it was captured in) or ``nr_v2x``; ``None`` is "none".

    Each option's sentence is its help text on the command line. Options that only ``nr_v2x`` has may not be given
    with ``ideal``.
    """

    link: str = "ideal"
    hold_ms: float = _option(300.0, float, "how long after its capture a roadside map is used, in milliseconds")
    sensing_ms: float = _option(10.0, float, "what the roadside's sensors take until their data are there")
    computing_ms: float = _option(20.0, float, "what the roadside's encoders take before a map can be sent")
    fuse_after_ms: float = _option(20.0, float, "what the vehicle's own encoders take; what came by then is fused")
    mcs: int = _option(21, int, "modulation and coding scheme of NR-V2X: 7, 14, 21 or 28")
    block_loss: float = _option(0.0, float, "share of the transport blocks that are lost")
    burst_slots: float | None = _option(
        None, float, "mean length of bursts of loss in slots of 0.5 ms; none: no bursts"
    )
    repetitions: int = _option(1, int, "how often every map is sent")
    delay_ms: float = _option(0.0, float, "delay of every block beside its air time")
    jitter_ms: float = _option(0.0, float, "further delay of every block, drawn evenly from zero to this")
    deadline_ms: float | None = _option(
        None, float, "blocks that arrive later than this after they were handed to the sender are dropped"
    )
    cut_within_s: float | None = _option(
        None, float, "the roadside falls silent for good, at a time drawn evenly from zero to this after the first map"
    )
    cut_unit: int | None = _option(
        None, int, "number of the only roadside unit that --cut_within_s silences; none: all of them"
    )
    position_noise_m: float = _option(
        0.0, float, "standard deviation of the vehicle's idea of its x and y, per episode"
    )
    yaw_noise_deg: float = _option(0.0, float, "standard deviation of the vehicle's idea of its heading, per episode")

    def __post_init__(self) -> None:
        if self.link not in LINKS:
            raise ConfigError(f"--link: expected {' or '.join(LINKS)}, found {self.link!r}")
        for name in (*ANY_LINK, "sensing_ms", "computing_ms", "fuse_after_ms"):
            if (value := getattr(self, name)) is not None and not 0 <= value < float("inf"):
                raise ConfigError(f"--{name}: expected 0 or more, found {value}")
        if self.cut_unit is not None and self.cut_within_s is None:
            raise ConfigError("--cut_unit: says which unit falls silent; when, says --cut_within_s, which is missing")
        self.nr_v2x()

    @classmethod
    def of(cls, link: str, given: Mapping[str, Any]) -> LinkOptions:
        """The options of a link, from its name and those that were given; ConfigError if they conflict."""
        unknown = [name for name in given if name not in _fields()]
        if unknown:
            raise ConfigError(f"link: unknown option {unknown[0]!r}; known: {', '.join(_fields())}")
        foreign = [name for name in given if name not in ANY_LINK]
        if link == "ideal" and foreign:
            raise ConfigError(f"--{foreign[0]}: an ideal link has no such thing; give --link nr_v2x")
        return cls(link, **given)

    def nr_v2x(self) -> NrV2xConfig:
        """The channel's own part."""
        if self.burst_slots is None:
            loss = LossModel.independent(self.block_loss)
        else:
            loss = LossModel.bursty(self.block_loss, self.burst_slots)
        return NrV2xConfig(self.mcs, loss, self.repetitions, self.delay_ms, self.jitter_ms, self.deadline_ms)


def _fields() -> dict[str, dataclasses.Field]:
    return {field.name: field for field in dataclasses.fields(LinkOptions) if field.name != "link"}


def add_link_arguments(parser: argparse.ArgumentParser) -> None:
    """``--link`` and one flag per option of ``LinkOptions``."""
    group = parser.add_argument_group("link (perception model)")
    group.add_argument("--link", choices=LINKS, default="ideal", help="how roadside maps reach the vehicle")
    for name, field in _fields().items():
        text = f"{field.metadata['help']} (default: {field.default})"
        group.add_argument(f"--{name}", type=field.metadata["kind"], help=text.replace("None", "none"))


def given_link_options(args: argparse.Namespace) -> dict[str, Any]:
    """The options that the user set."""
    return {name: value for name in _fields() if (value := getattr(args, name)) is not None}
