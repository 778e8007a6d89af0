"""Episodes that all formats are tested with: the turning car of the T-junction, and reversing out of a slot."""

from contextlib import contextmanager
from dataclasses import replace

import pytest

from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.export.drive import DrivenCase
from pcdet_avp.closed_loop.export.record import episode_record
from pcdet_avp.closed_loop.perception.oracle import Oracle
from pcdet_avp.closed_loop.perception.perceiver import Message, Perceived, PerceiverSettings
from pcdet_avp.closed_loop.sweep.episode_row import Case
from pcdet_avp.closed_loop.video.recording import record_episode
from pcdet_avp.config import load_config
from pcdet_avp.sim.rig import Rig
from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.structures.sensor_set import SensorSet


class WithRoadsideOnly:
    """Knows everything through a map of 1000 bytes if there is a roadside, and nothing without."""

    def __init__(self, cfg):
        self.oracle = Oracle(PerceiverSettings(cfg))

    def begin(self, scenario, seed_key):
        """Nothing to prepare."""

    def perceive(self, world, tick, sensor_set):
        if not sensor_set.uses_infra:
            return Perceived.nothing()
        return replace(self.oracle.perceive(world, tick, sensor_set), messages=(Message("infra_lidar", 1000, 0.05),))


def drive(scenario, speed, combo, trial=1, blueprint=None):
    """``blueprint``: a scenario of one's own in place of the one that is drawn by its name."""
    cfg, settings = load_config("cfgs/dataset_configs/avp_tiny.yaml"), EpisodeSettings()
    blueprint, rig = blueprint or draw_scenario(scenario, 0, trial, speed), Rig.from_config(cfg["SENSORS"])
    rig = rig.reversed() if blueprint.reversing else rig
    recording = record_episode(blueprint, WithRoadsideOnly(cfg), SensorSet.parse(combo), settings)
    case = Case(scenario, "own", combo, speed, trial)
    record = episode_record(recording, case, 0, f"{scenario}, {combo}", settings, rig)
    return DrivenCase(record, recording, rig)


@pytest.fixture(scope="session")
def junction():
    """With the roadside, and the same trial of the vehicle alone, which meets the other car."""
    return [drive("t_junction", 8.0, combo) for combo in ("C+CL", "C+none")]


@pytest.fixture(scope="session")
def reversing():
    return [drive("cpra", 1.5, "C+CL", trial=0)]


@pytest.fixture(scope="session")
def at_once(scenes):
    """A drive of one tick: the bumper meets somebody at its start, in a hall without pillars and walls."""
    who = scenes.pedestrian([(0.1, 0.0), (0.1, 0.1)])
    return [drive("own", 5.0, "C+CL", blueprint=scenes.scene(who))]


@pytest.fixture(scope="session")
def nobody(scenes):
    """A drive through the same hall, in which there is nobody else."""
    return [drive("own", 5.0, "C+CL", blueprint=scenes.scene())]


@pytest.fixture
def full_disk():
    """A block in which no file can grow beyond so many bytes, as on a disk that is full."""
    resource = pytest.importorskip("resource", reason="needs limits of POSIX")

    @contextmanager
    def limited(size):
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limited
