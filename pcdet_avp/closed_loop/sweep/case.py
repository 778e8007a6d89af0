"""One episode of a sweep by its name, run wherever a worker is."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.episode_log import ROW_FIELDS, EpisodeLog, EpisodeRow
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.factory import build_perceiver
from pcdet_avp.closed_loop.perception.perceiver import Perceiver, PerceiverSettings
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.structures.sensor_set import SensorSet

ANY_COMBO = "any"  # of perceptions that use no sensors


class Case(NamedTuple):
    """An episode's name; ``speed`` is the cruising speed in m/s. Cases of one trial share garage, people and timing."""

    scenario: str
    perception: str
    combo: str
    speed: float
    trial: int


@dataclass(frozen=True)
class CaseJob:
    """A case and what it takes to run it: plain values only, so that it travels."""

    case: Case
    seed: int
    perceiver: dict[str, Any]  # fields of PerceiverSettings
    closed_loop: dict[str, Any]  # CLOSED_LOOP


def run_case(job: CaseJob) -> tuple[EpisodeRow, float]:
    """The episode's record and the wall seconds it took."""
    started = time.perf_counter()
    log = replay(job)
    return episode_row(job.case, case_scenario(job), log), time.perf_counter() - started


def case_scenario(job: CaseJob) -> Scenario:
    return draw_scenario(job.case.scenario, job.seed, job.case.trial, job.case.speed)


def replay(job: CaseJob, keep_perceived: bool = False) -> EpisodeLog:
    """The whole log of a case, the same however often it is run."""
    settings = EpisodeSettings.from_config({**job.closed_loop, "KEEP_PERCEIVED": keep_perceived})
    sensor_set = SensorSet.parse("CL+CL" if job.case.combo == ANY_COMBO else job.case.combo)
    perceiver = _perceiver(job.case.perception, json.dumps(job.perceiver))
    return run_episode(case_scenario(job), perceiver, sensor_set, settings)


@lru_cache(maxsize=2)
def _perceiver(name: str, settings: str) -> Perceiver:
    """Built once per worker: a network's weights are read once."""
    return build_perceiver(name, perceiver_settings(json.loads(settings)))


def perceiver_settings(values: Mapping[str, Any]) -> PerceiverSettings:
    lists = {key: tuple(values.get(key, ())) for key in ("overrides", "ignore_config")}
    return PerceiverSettings(**{**values, **lists})


def episode_row(case: Case, scenario: Scenario, log: EpisodeLog) -> EpisodeRow:
    """The flat record of an episode."""
    messages = [message for tick in log.messages for message in tick]
    same = {field.name for field in fields(EpisodeLog)} & set(ROW_FIELDS)
    return EpisodeRow(
        **{
            **case._asdict(),
            **{name: getattr(log, name) for name in same},
            "messages": len(messages),
            "message_bytes": _mean([message.bytes for message in messages]),
            "message_age_s": _mean([message.age_s for message in messages]),
            "max_lateral_acceleration_mps2": scenario.max_lateral_acceleration_mps2,
        }
    )


def _mean(values: list[float]) -> float | None:
    """None where there is nothing to measure."""
    return float(np.mean(values)) if values else None
