"""A video of an episode, and a strip of stills: cameras, the garage from above, what was detected, how fast it went."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from pcdet_avp.closed_loop.driver import Driver
from pcdet_avp.closed_loop.episode_log import EpisodeLog
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.perceiver import Perceived, Perceiver
from pcdet_avp.closed_loop.video.episode_picture import (
    ALONE_COLOR,
    CAMERA_PX,
    EGO_COLOR,
    FUSED_COLOR,
    STRIP_PX,
    Background,
    EpisodePainter,
    Moment,
)
from pcdet_avp.closed_loop.video.recording import Recording, camera_views, record_episode, targets_alone
from pcdet_avp.errors import ConfigError
from pcdet_avp.files import check_writable
from pcdet_avp.sim.rig import Rig
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.roadside_unit import mounted_units
from pcdet_avp.structures.sensor_set import SensorSet
from pcdet_avp.visualization.time_strip import Curve, TimeStrip
from pcdet_avp.visualization.video import check_video_name, write_picture, write_video

LEAD_IN_S = 1.0  # the video starts so long before perception wakes
HOLD_S = 1.5  # the last picture stays so long
STILLS = 4


def write_episode_video(
    scenario: Scenario,
    perceiver: Perceiver,
    sensor_set: SensorSet,
    data_cfg: Mapping[str, Any],
    file: Path,
    title: str,
    settings: EpisodeSettings | None = None,
    every: int = 2,
) -> EpisodeLog:
    """Drive an episode and write it to ``file`` (*.mp4 or *.avi; ``<stem>_poster.jpg`` and
    ``<stem>_stills.jpg`` beside it). Returns the episode's log.

    The cameras that are shown come from ``data_cfg["SENSORS"]``. ``title`` says which perception drives. ``every``:
    2 shows every other tick. The video runs in real time. ConfigError and OutputError before anything is driven, where
    ``every`` or ``file`` cannot be.
    """
    if not isinstance(every, int) or every < 1:
        raise ConfigError(f"every: expected a whole number of ticks, 1 or more, found {every!r}")
    check_video_name(file)
    check_writable(file)
    settings = settings or EpisodeSettings()
    rig = Rig.from_config(data_cfg["SENSORS"], mounted_units(data_cfg.get("ROADSIDE_UNITS")))
    rig.check_in(scenario.world(), sensor_set.sources)
    recording = record_episode(scenario, perceiver, sensor_set, settings)
    write_recording_video(recording, rig.reversed() if scenario.reversing else rig, file, title, settings, every)
    return recording.log


def write_recording_video(
    recording: Recording, rig: Rig, file: Path, title: str, settings: EpisodeSettings, every: int = 2
) -> None:
    """The same of an episode that was recorded under ``settings``; ``rig`` faces where the ego frame does."""
    video = EpisodeVideo(recording, rig, title, settings)
    ticks = video.ticks()
    shown = tqdm(ticks[::-every][::-1], unit="picture", desc=f"drawing {file.name}")
    fps = 1 / (every * settings.tick_s)
    write_video(file, video.pictures(shown, hold=round(HOLD_S * fps)), fps)
    write_picture(file.with_name(f"{file.stem}_poster.jpg"), video.picture(video.poster_tick()))
    stills = [video.picture(tick) for tick in _still_ticks(ticks, recording.log)]
    write_picture(file.with_name(f"{file.stem}_stills.jpg"), np.vstack(stills))


class EpisodeVideo:
    """Pictures of a recorded episode."""

    def __init__(self, recording: Recording, rig: Rig, title: str, settings: EpisodeSettings) -> None:
        self._recording, self._rig, self._tick_s = recording, rig, settings.tick_s
        scenario = recording.scenario
        self._alone = self._targets_alone(settings) if recording.sensor_set.uses_infra else None
        self._driver = Driver.for_episode(scenario, settings)
        uses_infra = recording.sensor_set.uses_infra
        self._painter = EpisodePainter(Background.of(scenario), self._strip(settings), title, uses_infra)

    def ticks(self) -> range:
        """The ticks that the video shows: from shortly before perception wakes to the end."""
        awake = [tick for tick, seen in enumerate(self._recording.log.perceived) if seen is not None]
        first = awake[0] - round(LEAD_IN_S / self._tick_s) if awake else 0
        return range(max(first, 0), len(self._recording.log.times))

    def poster_tick(self) -> int:
        """The tick that shows best what the roadside changes: the first at which the target speeds with and without it
        differ most. Where there is no roadside, or no difference, the last tick, which says how it ended."""
        ticks = self.ticks()
        if not self._recording.sensor_set.uses_infra:
            return ticks[-1]
        difference = np.abs(self._alone - self._recording.log.targets)[ticks.start : ticks.stop]
        return ticks[int(difference.argmax())] if difference.any() else ticks[-1]

    def pictures(self, ticks: Iterable[int], hold: int) -> Iterator[np.ndarray]:
        """One picture for each of the ticks, the last one ``hold`` times more."""
        for tick in ticks:
            image = self.picture(tick)
            yield image
        yield from (image for _ in range(hold))

    def picture(self, tick: int) -> np.ndarray:
        """(810, 1440, 3) uint8 RGB."""
        recording = self._recording
        world = recording.seek(tick)
        ego, infra = camera_views(world, self._rig, (*recording.scenario.seed_key, tick), CAMERA_PX[0])
        fused, ignored = self._in_world(recording.log.perceived[tick], world.world_from_ego)
        alone, _ = self._in_world(recording.alone[tick], world.world_from_ego)
        last = tick == len(recording.log.times) - 1
        banner = self._banner() if last else None
        return self._painter.picture(
            Moment(float(recording.log.times[tick]), ego, infra, recording.movers(tick), fused, alone, ignored, banner)
        )

    def _in_world(self, seen: Perceived | None, world_from_ego: Pose) -> tuple[np.ndarray | None, np.ndarray]:
        """Boxes of detections that the policy heeds (None: perception sleeps), and of those that it ignores."""
        if seen is None:
            return None, np.zeros((0, 7))
        boxes = transform_boxes(world_from_ego, seen.boxes)
        heeded = self._driver.heeds(seen.boxes, seen.names, world_from_ego)
        return boxes[heeded], boxes[~heeded]

    def _banner(self) -> tuple[str, str]:
        figures = self._recording.log.figures
        if figures.outcome == "none":
            return ("passed without a contact" if figures.finished else "time is up"), "none"
        return f"contact with the {figures.outcome} at {figures.impact_speed_mps:.1f} m/s", figures.outcome

    def _strip(self, settings: EpisodeSettings) -> TimeStrip:
        recording, log = self._recording, self._recording.log
        ticks = self.ticks()
        part = slice(ticks.start, ticks.stop)
        curves = [
            Curve("speed", log.speeds[part], EGO_COLOR),
            Curve("target speed", log.targets[part], FUSED_COLOR, steps=True),
        ]
        if recording.sensor_set.uses_infra:
            curves.insert(1, Curve("target speed by the car alone", self._alone[part], ALONE_COLOR, 1, steps=True))
        top = 1.1 * recording.scenario.cruising_mps
        return TimeStrip(*STRIP_PX, log.times[part], curves, top, "speed (m/s)")

    def _targets_alone(self, settings: EpisodeSettings) -> np.ndarray:
        return targets_alone(self._recording, settings)


def _still_ticks(ticks: range, log: EpisodeLog) -> list[int]:
    """Evenly from where the car first slows down (or perception wakes) to where the last threat is gone, or hit."""
    slowed = np.flatnonzero(log.targets < log.targets[0])
    first = max(int(slowed[0]) - 1, ticks.start) if len(slowed) else ticks.start
    awake = [tick for tick, seen in enumerate(log.perceived) if seen is not None and tick >= first]
    last = awake[-1] if awake and log.figures.outcome == "none" else ticks.stop - 1
    return [int(tick) for tick in np.linspace(first, last, STILLS)]
