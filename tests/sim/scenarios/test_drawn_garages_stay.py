"""Drawn garages give the same scenes and episodes as before there were plans (commit bc8fdc8), to a nanometre.

``benchmarks/same_answers.py`` compares whole records of two checkouts, sensor arrays included.
"""

import hashlib

import numpy as np

from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene

SCENES = "ceb84cd48f683e18"
EPISODES = "5c41e52c4c888e0d"


def digest(arrays):
    whole = hashlib.sha256()
    for array in arrays:
        whole.update((np.round(np.asarray(array, float), 9) + 0.0).tobytes())
    return whole.hexdigest()[:16]


def poses(scene):
    for frame in (0, len(scene.frame_times_s) - 1):
        world = scene.seek(frame)
        yield world.world_from_ego.matrix
        yield world.world_from_infra.matrix
        yield world.road_users().boxes
    yield [(s.x, s.y, s.heading) for s in world.layout.slots]
    yield world.layout.solid_boxes()
    yield [(lamp.x, lamp.y, lamp.z, lamp.intensity, *lamp.tint) for lamp in world.layout.lamps]


def test_scenes():
    assert digest(a for seed in range(3) for a in poses(draw_training_scene(np.random.default_rng(seed)))) == SCENES


def test_episodes():
    names = ("pedestrian", "pedestrian_late", "t_junction", "t_junction_wide")
    drawn = [draw_scenario(name, 0, trial, 6.0) for name in names for trial in range(2)]
    facts = [s.world().road_users().boxes for s in drawn]
    facts += [(s.ego_start_x, s.first_x, s.end_x, *(t.clear_after_m for t in s.threats)) for s in drawn]
    assert digest(facts) == EPISODES
