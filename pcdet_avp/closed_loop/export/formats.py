"""The formats of an episode, one entry each: what the command line knows of them. Imports none of their packages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from pcdet_avp.closed_loop.export.drive import DrivenCase
from pcdet_avp.errors import ConfigError


@dataclass(frozen=True)
class ExportSettings:
    """What a writer of sensor data needs. ``every``: images and clouds of every so many ticks; 0: of none.

    ``widest_px``: wider images are made smaller, their intrinsics with them.
    """

    every: int = 4
    widest_px: int = 960


Writer = Callable[[Sequence[DrivenCase], Path, ExportSettings], list[Path]]


@dataclass(frozen=True)
class EpisodeFormat:
    """A format by its name on the command line.

    ``module`` has ``write(drives, stem, settings) -> files``: the drive asked for, and behind it the same trial of the
    vehicle alone where that was driven; ``stem`` is a path without suffix. ``needs``: distribution by the module that
    is imported. ``extra``: of our package, which brings them.
    """

    name: str
    module: str
    needs: dict[str, str]
    extra: str = "episodes"

    def check(self) -> None:
        """ConfigError where a package is missing."""
        missing = [package for module, package in self.needs.items() if find_spec(module) is None]
        if missing:
            install = f'pip install "pcdet_avp[{self.extra}]"'
            raise ConfigError(f"--formats {self.name}: needs {missing[0]}, which is not installed: {install}")

    def write(self, drives: Sequence[DrivenCase], stem: Path, settings: ExportSettings) -> list[Path]:
        """Write the files; their paths."""
        return import_module(f"pcdet_avp.closed_loop.export.{self.module}").write(drives, stem, settings)


_FORMATS = (
    EpisodeFormat("html", "page", {}),
    EpisodeFormat("mcap", "mcap_file", {"foxglove": "foxglove-sdk"}),
    EpisodeFormat("rrd", "rerun_file", {"rerun": "rerun-sdk"}),
    EpisodeFormat("xosc", "open_scenario", {"scenariogeneration": "scenariogeneration"}),
    EpisodeFormat("commonroad", "common_road", {"commonroad": "commonroad-io"}, extra="commonroad"),
)
FORMATS = {each.name: each for each in _FORMATS}
