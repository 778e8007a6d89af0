"""What the sensors saw at the ticks of a drive: images and clouds, rendered again with the noise of the drive.

The noise follows from the episode's key and the tick, as in ``perception.network_perceiver``: at the configuration's
own image size, an image or a cloud is the one that the network got.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pcdet_avp.closed_loop.export.drive import DrivenCase
from pcdet_avp.closed_loop.export.formats import ExportSettings
from pcdet_avp.closed_loop.video.recording import at_most
from pcdet_avp.sim.rig import AgentRig, Rig, observe_units
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.frame import AgentView
from pcdet_avp.structures.pose import Pose


@dataclass(frozen=True, eq=False)
class Look:
    """One agent's sensors at one tick. ``name``: ``ego``, or ``infra_0`` of unit 0.

    image (H, W, 3) uint8 RGB, points (P, 4) x, y, z, intensity in the agent's frame; None where it has no such sensor,
    or the combination leaves it out.
    """

    name: str
    world_from_agent: Pose
    camera: PinholeCamera | None
    image: np.ndarray | None
    points: np.ndarray | None


def sensor_ticks(driven: DrivenCase, settings: ExportSettings) -> range:
    """Every so many ticks, from shortly before perception wakes to the end."""
    start, end = driven.record.first_shown(), len(driven.record.log.times)
    return range(start, end, settings.every) if settings.every else range(0)


def looks(driven: DrivenCase, tick: int, settings: ExportSettings) -> Iterator[Look]:
    """What the sensors of the combination saw at a tick: the ego's, then those of every roadside unit."""
    record, sources = driven.record, driven.recording.sensor_set.sources
    key, rig = (*record.scenario.seed_key, tick), _smaller(driven.rig, settings.widest_px)
    frames = observe_units(driven.recording.seek(tick), rig, key, str(tick), sources)
    yield _look("ego", frames[0].ego)
    if driven.recording.sensor_set.uses_infra:
        yield from (_look(f"infra_{number}", frame.infra) for number, frame in enumerate(frames))


def _look(name: str, view: AgentView) -> Look:
    return Look(name, view.world_from_agent, view.camera, view.image, view.points)


def _smaller(rig: Rig, widest_px: int) -> Rig:
    def smaller(agent: AgentRig) -> AgentRig:
        return replace(agent, camera=at_most(agent.camera, widest_px))

    units = tuple((unit, smaller(agent)) for unit, agent in rig.units)
    return Rig(smaller(rig.ego), smaller(rig.infra), units)
