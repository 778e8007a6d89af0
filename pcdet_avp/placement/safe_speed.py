"""How fast a car may drive past a placement: the closed loop with ideal perception from the sensors' places.

A job drives one trial (one site with its people or vehicle) with one placement, ever faster until the first crash.
The safe speed of a placement is the highest speed up to which no trial of any scenario crashed. A drive that the time
limit cut off is no crash, and it proves nothing: such drives are counted beside the speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.episode_log import EpisodeFigures
from pcdet_avp.config import load_config
from pcdet_avp.errors import ConfigError
from pcdet_avp.placement.line_of_sight import PlacedLineOfSight
from pcdet_avp.placement.sensors import SensorModels
from pcdet_avp.sim.rig import Rig
from pcdet_avp.sim.scenarios.plan_episodes import PLAN_SCENARIOS
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.structures.sensor_set import SensorSet

SPEEDS_MPS = (3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)
VEHICLE_CONFIG = "cfgs/dataset_configs/avp_full.yaml"  # the paper's vehicle


@dataclass(frozen=True)
class SpeedJob:
    """One trial of one scenario on a plan's floor with one placement; plain values, so that it travels."""

    plan: str
    scenario: str
    seed: int
    trial: int
    name: str  # of the placement
    units: tuple[MountedUnit, ...]
    models: SensorModels
    vehicle: str
    speeds: tuple[float, ...] = SPEEDS_MPS
    floor: str | None = None  # None: the plan's first


@dataclass(frozen=True)
class SpeedResult:
    """The speed (m/s) of the first crash of a job, None where no speed had one; the speeds (m/s) at which the time
    limit cut the drive off."""

    name: str
    scenario: str
    trial: int
    crashed_at: float | None
    unfinished_at: tuple[float, ...] = ()


@dataclass(frozen=True)
class SafeSpeed:
    """A placement's safe speed (m/s), and how many of the drives up to it the time limit cut off."""

    mps: float
    unfinished: int = 0


def drive_faster(job: SpeedJob) -> SpeedResult:
    """Drive a job's trial at ever higher speeds until it crashes."""
    cfg = load_config(VEHICLE_CONFIG)
    rig, grid = Rig.from_config(cfg.SENSORS), BevGrid.from_range(cfg.POINT_CLOUD_RANGE, cfg.VOXEL_SIZE)
    eye = PlacedLineOfSight(rig.ego, job.vehicle, job.units, job.models, grid)
    unfinished = []
    for speed in job.speeds:
        figures = _drive(job, speed, eye)
        if figures.crashed:
            return SpeedResult(job.name, job.scenario, job.trial, speed, tuple(unfinished))
        if not figures.finished:
            unfinished.append(speed)
    return SpeedResult(job.name, job.scenario, job.trial, None, tuple(unfinished))


def _drive(job: SpeedJob, speed: float, eye: PlacedLineOfSight) -> EpisodeFigures:
    draw = PLAN_SCENARIOS[job.scenario]
    scenario = draw(job.plan, job.scenario, job.seed, job.trial, speed, floor=job.floor)
    return run_episode(scenario, eye, SensorSet.parse("C+none")).figures


def scenarios_of(plan: str, floor: str | None = None) -> tuple[str, ...]:
    """The scenarios that a plan's floor (None: the first) has a place for; ConfigError if it has none."""
    possible, problems = [], []
    for name, draw in PLAN_SCENARIOS.items():
        try:
            draw(plan, name, 0, 0, SPEEDS_MPS[0], floor=floor)
        except ConfigError as problem:
            problems.append(str(problem))
        else:
            possible.append(name)
    if not possible:
        raise ConfigError("; ".join(dict.fromkeys(problems)))
    return tuple(possible)


def safe_speed(results: Sequence[SpeedResult], speeds: Sequence[float] = SPEEDS_MPS) -> SafeSpeed:
    """The highest speed below that of every first crash; 0 where the slowest crashed."""
    first = min((r.crashed_at for r in results if r.crashed_at is not None), default=float("inf"))
    safe = max((speed for speed in speeds if speed < first), default=0.0)
    return SafeSpeed(safe, sum(speed <= safe for r in results for speed in r.unfinished_at))
