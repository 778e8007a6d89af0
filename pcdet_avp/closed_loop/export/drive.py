"""Drives episodes of a sweep again and keeps all of them; the same case gives the same drive, however often."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.export.record import EpisodeRecord, episode_record
from pcdet_avp.closed_loop.perception.factory import find_perception
from pcdet_avp.closed_loop.perception.perceiver import Perceiver
from pcdet_avp.closed_loop.sweep.case import case_scenario, case_sensors, case_title, perceiver_settings
from pcdet_avp.closed_loop.sweep.episode_row import ANY_COMBO, Case
from pcdet_avp.closed_loop.sweep.sweep import Sweep
from pcdet_avp.closed_loop.video.recording import Recording, record_episode
from pcdet_avp.sim.rig import Rig
from pcdet_avp.structures.roadside_unit import mounted_units


@dataclass(frozen=True, eq=False)
class DrivenCase:
    """An episode's record, and what renders its sensors at any of its ticks."""

    record: EpisodeRecord
    recording: Recording
    rig: Rig

    def frames(self) -> np.ndarray:
        """(T, 3) x, y (m), yaw (rad) of the ego frame, in which clouds and detections are made; of a car that drives
        backwards it faces where the tail points."""
        return self.recording.ego_poses()


class CaseDriver:
    """Drives cases of one sweep. Its perceiver is built once, when the first is driven; the last ``KEPT`` drives are
    kept, so that whoever asks for one of them again has it at once."""

    KEPT = 2  # a trial with the roadside and without it

    def __init__(self, sweep: Sweep) -> None:
        self._sweep = sweep
        self.settings = EpisodeSettings.from_config(sweep.closed_loop)
        data_cfg = sweep.perceiver["data_cfg"]
        self._rig = Rig.from_config(data_cfg["SENSORS"], mounted_units(data_cfg.get("ROADSIDE_UNITS")))
        self._kept: dict[Case, DrivenCase] = {}

    @cached_property
    def _perceiver(self) -> Perceiver:
        return find_perception(self._sweep.perception).build(perceiver_settings(self._sweep.perceiver))

    def drive(self, case: Case) -> DrivenCase:
        """The case, driven."""
        if case not in self._kept:
            self._kept[case] = self._driven(case)
            while len(self._kept) > self.KEPT:
                del self._kept[next(iter(self._kept))]
        return self._kept[case]

    def _driven(self, case: Case) -> DrivenCase:
        scenario = case_scenario(self._sweep.job(case))
        rig = self._rig.reversed() if scenario.reversing else self._rig
        recording = record_episode(scenario, self._perceiver, case_sensors(case), self.settings)
        title = case_title(self._sweep.job(case))
        record = episode_record(recording, case, self._sweep.seed, title, self.settings, rig)
        return DrivenCase(record, recording, rig)


def vehicle_alone(case: Case) -> Case | None:
    """The same trial of the same vehicle without the roadside; None where the case has no roadside to leave out."""
    vehicle, _, roadside = case.combo.partition("+")
    return None if case.combo == ANY_COMBO or roadside == "none" else case._replace(combo=f"{vehicle}+none")
