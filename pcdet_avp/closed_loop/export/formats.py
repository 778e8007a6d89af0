"""The formats of an episode, one entry each: what the command line knows of them. Imports none of their packages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from pcdet_avp.closed_loop.export.drive import DrivenCase
from pcdet_avp.errors import ConfigError, OutputError
from pcdet_avp.sim.scenarios.table import ON_PLAN


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
    on_plans: bool = True  # False: the map of a garage from a file is not written in this format yet
    fewest_ticks: int = 1  # that a drive must have; a trajectory begins with two

    def check(self, scenario: str) -> None:
        """ConfigError where a package is missing, or the scenario plays on a plan that the format cannot hold."""
        install = f'pip install "pcdet_avp[{self.extra}]"'
        missing = [package for module, package in self.needs.items() if find_spec(module) is None]
        if missing:
            raise ConfigError(f"--formats {self.name}: needs {missing[0]}, which is not installed: {install}")
        try:
            self._writer()
        except (ImportError, TypeError) as error:  # TypeError: generated code that the installed protobuf refuses
            why = str(error).partition("\n")[0]
            raise ConfigError(f"--formats {self.name}: its package cannot be imported ({why}): {install}") from error
        if ON_PLAN in scenario and not self.on_plans:
            raise ConfigError(
                f"--formats {self.name}: holds the drawn garages' map alone, not a plan's; found {scenario}"
            )

    def write(self, drives: Sequence[DrivenCase], stem: Path, settings: ExportSettings) -> list[Path]:
        """Write the files; their paths. OutputError where they would hold nothing that the format takes."""
        ticks = len(drives[0].record.log.times)
        if ticks < self.fewest_ticks:
            raise OutputError(f"{stem}: {self.name} needs a drive of {self.fewest_ticks} ticks, found one of {ticks}")
        return self._writer().write(drives, stem, settings)

    def _writer(self) -> ModuleType:
        return import_module(f"pcdet_avp.closed_loop.export.{self.module}")


_FORMATS = (
    EpisodeFormat("html", "page", {}),
    EpisodeFormat("mcap", "mcap_file", {"foxglove": "foxglove-sdk"}),
    EpisodeFormat("rrd", "rerun_file", {"rerun": "rerun-sdk"}),
    EpisodeFormat(
        "xosc", "open_scenario", {"scenariogeneration": "scenariogeneration"}, on_plans=False, fewest_ticks=2
    ),
    EpisodeFormat(
        "commonroad", "common_road", {"commonroad": "commonroad-io"}, extra="commonroad", on_plans=False, fewest_ticks=2
    ),
)
FORMATS = {each.name: each for each in _FORMATS}
