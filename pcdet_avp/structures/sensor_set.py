"""The paper's 2 x 3 sensor combinations: vehicle {C, CL} x infrastructure {none, C, CL}.

The short names (``C+none`` ... ``CL+CL``) are used everywhere: command line, tables, JSON.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from pcdet_avp.errors import SensorError

# Order of the four feature maps, of every presence mask and of the fusion slots.
SOURCES = ("ego_camera", "ego_lidar", "infra_camera", "infra_lidar")
EGO_SOURCES, INFRA_SOURCES = SOURCES[:2], SOURCES[2:]


def agent_of(source: str) -> str:
    """``"infra_camera"`` -> ``"infra"``."""
    return source.partition("_")[0]


def modality_of(source: str) -> str:
    """``"infra_camera"`` -> ``"camera"``."""
    return source.partition("_")[2]


@dataclass(frozen=True)
class SensorSet:
    """Which of the four sources a vehicle may use."""

    ego_camera: bool
    ego_lidar: bool
    infra_camera: bool
    infra_lidar: bool

    @classmethod
    def parse(cls, name: str) -> SensorSet:
        """``"C+CL"`` -> vehicle camera, roadside camera and LiDAR."""
        if not isinstance(name, str) or name not in SENSOR_SETS:
            raise SensorError(f"unknown sensor combination {name!r}; known: {', '.join(SENSOR_SETS)}")
        return SENSOR_SETS[name]

    @property
    def mask(self) -> tuple[bool, bool, bool, bool]:
        """Presence in the order of ``SOURCES``."""
        return (self.ego_camera, self.ego_lidar, self.infra_camera, self.infra_lidar)

    @property
    def sources(self) -> tuple[str, ...]:
        """The sources in use, in the order of ``SOURCES``."""
        return tuple(source for source, used in zip(SOURCES, self.mask, strict=True) if used)

    @property
    def name(self) -> str:
        """The short name; only the paper's six combinations have one."""
        for name, sensor_set in SENSOR_SETS.items():
            if sensor_set == self:
                return name
        raise SensorError(f"sensors {self.mask} are none of the combinations {', '.join(SENSOR_SETS)}")

    @property
    def uses_infra(self) -> bool:
        return self.infra_camera or self.infra_lidar


# In the order of the paper's tables.
SENSOR_SETS = {
    "C+none": SensorSet(True, False, False, False),
    "C+C": SensorSet(True, False, True, False),
    "C+CL": SensorSet(True, False, True, True),
    "CL+none": SensorSet(True, True, False, False),
    "CL+C": SensorSet(True, True, True, False),
    "CL+CL": SensorSet(True, True, True, True),
}


def combos_with(sources: Collection[str]) -> list[str]:
    """The paper's combinations that recordings with these sources can show, in its order.

    The vehicle has a sensor, and no two of them come to the same sensors: of recordings without any camera CL+none
    and CL+CL remain.
    """
    names: dict[tuple[str, ...], str] = {}
    for name, sensor_set in SENSOR_SETS.items():
        used = tuple(source for source in sensor_set.sources if source in sources)
        if any(source in EGO_SOURCES for source in used):
            names.setdefault(used, name)
    return list(names.values())
