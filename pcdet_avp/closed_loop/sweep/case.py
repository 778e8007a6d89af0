"""One episode of a sweep, run wherever a worker is."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.episode_log import EpisodeLog
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.factory import PerceptionKind
from pcdet_avp.closed_loop.perception.perceiver import Perceiver, PerceiverSettings
from pcdet_avp.closed_loop.sweep.episode_row import ANY_COMBO, Case, EpisodeRow
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.scenarios.table import ScenarioKind
from pcdet_avp.structures.sensor_set import SensorSet


@dataclass(frozen=True)
class CaseJob:
    """A case and what it takes to run it in another process: plain values, and entries whose functions it imports."""

    case: Case
    scenario: ScenarioKind
    perception: PerceptionKind
    seed: int
    perceiver: dict[str, Any]  # fields of PerceiverSettings
    closed_loop: dict[str, Any]  # CLOSED_LOOP


def run_case(job: CaseJob) -> tuple[EpisodeRow, float]:
    """The episode's record and the wall seconds it took."""
    started = time.perf_counter()
    log = replay(job)
    return EpisodeRow.of(job.case, case_scenario(job), log), time.perf_counter() - started


def case_scenario(job: CaseJob) -> Scenario:
    return job.scenario.scenario(job.seed, job.case.trial, job.case.speed)


def case_sensors(case: Case) -> SensorSet:
    """The sensor set of a case; all sensors for a perception that uses none."""
    return SensorSet.parse("CL+CL" if case.combo == ANY_COMBO else case.combo)


def case_title(job: CaseJob) -> str:
    """Says which perception drives, and for ``model`` which network."""
    case, cfg_file = job.case, job.perceiver.get("cfg_file")
    who = f"{case.perception} ({Path(cfg_file).stem})" if cfg_file else case.perception
    sensors = "" if case.combo == ANY_COMBO else f", {case.combo}"
    return f"{job.scenario.title}, episode {case.trial}, {case.speed:g} m/s, {who}{sensors}"


def replay(job: CaseJob, keep_perceived: bool = False) -> EpisodeLog:
    """The whole log of a case, the same however often it is run."""
    settings = EpisodeSettings.from_config({**job.closed_loop, "KEEP_PERCEIVED": keep_perceived})
    perceiver = _perceiver(job.perception, json.dumps(job.perceiver))
    return run_episode(case_scenario(job), perceiver, case_sensors(job.case), settings)


@lru_cache(maxsize=2)
def _perceiver(kind: PerceptionKind, settings: str) -> Perceiver:
    """Built once per worker: a network's weights are read once."""
    return kind.build(perceiver_settings(json.loads(settings)))


def perceiver_settings(values: Mapping[str, Any]) -> PerceiverSettings:
    lists = {key: tuple(values.get(key, ())) for key in ("overrides", "ignore_config")}
    return PerceiverSettings(**{**values, **lists})
