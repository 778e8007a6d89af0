"""GENERATE.LATE_SIGHT: bays begin with vans, and people step out close behind them while the scene lasts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import Polygon
from shapely.strtree import STRtree

from pcdet_avp.config import load_config
from pcdet_avp.config_scenes import completed, scene_config
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import Pedestrian
from pcdet_avp.sim.garage import LANE_WIDTH_M
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.boxes import bev_corners
from pcdet_avp.structures.scene_config import LateSightConfig, SceneConfig

CFG = load_config(Path(__file__).parents[3] / "cfgs" / "dataset_configs" / "avp_small_late.yaml").GENERATE
LATE = LateSightConfig(share=1.0, child_share=1.0, vans_out_m=(0.1, 0.2))
NOBODY = (0, 0)
SCENES, FRAMES = 12, 4
ALONE = SceneConfig(  # those who step out are the only pedestrians
    frames=FRAMES,
    frame_interval_s=1.0,
    in_gap=NOBODY,
    crossing=NOBODY,
    along=NOBODY,
    on_side_road=NOBODY,
    late_sight=LATE,
)


def draw(number, cfg=ALONE):
    return draw_training_scene(np.random.default_rng(np.random.SeedSequence([12, number])), cfg)


@pytest.fixture(scope="module")
def scenes():
    return [draw(number) for number in range(SCENES)]


def vans_of(scene):
    """Boxes (V, 7) of parked vehicles whose ends stand 0.1 to 0.2 m out into the road: no other parked one does."""
    boxes = scene.seek(0).road_users().boxes
    ends = np.abs(boxes[:, 1]) - boxes[:, 3] / 2
    return boxes[(boxes[:, 3] > 2) & (ends >= LANE_WIDTH_M - 0.2 - 1e-6) & (ends <= LANE_WIDTH_M - 0.1 + 1e-6)]


def walkers_of(scene):
    """(P, F, 2) places of the pedestrians at all frames."""
    people = [actor for actor in scene.world.actors if isinstance(actor, Pedestrian)]
    return np.array([[(m.x, m.y) for m in map(p.trajectory.at, scene.frame_times_s)] for p in people])


def test_they_come_out_close_behind_a_van_while_the_scene_lasts(scenes):
    """0.4 m behind its flank: of the bay's far side as the ego comes, so that the van hides them."""
    people = [(scene, way) for scene in scenes for way in walkers_of(scene)]
    assert len(people) >= 2 * SCENES
    for scene, way in people:
        vans = vans_of(scene)
        behind = way[0, 0] - (vans[:, 0] + vans[:, 4] / 2)
        assert np.abs(behind[np.sign(vans[:, 1]) == np.sign(way[0, 1])] - 0.4).min() < 0.15
    depth = np.array([np.abs(way[:, 1]) for _, way in people])
    mouth = LANE_WIDTH_M - 0.15
    assert np.mean((depth.max(1) > mouth - 0.6) & (depth.min(1) < mouth + 0.6)) > 0.9


def test_children_are_as_frequent_as_asked_for(scenes):
    people = [a.spec for scene in scenes for a in scene.world.actors if isinstance(a, Pedestrian)]
    assert {person.kind for person in people} == {"child"}
    grown = [draw(number, replace(ALONE, late_sight=replace(LATE, child_share=0.0))) for number in range(4)]
    assert {a.spec.kind for s in grown for a in s.world.actors if isinstance(a, Pedestrian)} == {"adult"}


def test_nobody_is_in_anybody(scenes):
    for scene in scenes:
        for frame in range(FRAMES):
            world = scene.seek(frame)
            users = world.road_users().boxes
            shapes = [Polygon(c) for c in bev_corners(np.concatenate([users, world.layout.solid_boxes()]))]
            first, second = STRtree(shapes).query(shapes[: len(users)], predicate="intersects")
            shared = [shapes[a].intersection(shapes[b]).area for a, b in zip(first, second, strict=True) if a != b]
            assert max(shared, default=0.0) < 1e-9


def test_the_share_of_the_scenes():
    with_vans = [bool(len(vans_of(draw(n, replace(ALONE, late_sight=replace(LATE, share=0.3)))))) for n in range(60)]
    assert 0.1 < np.mean(with_vans) < 0.5  # 0.3 and three standard deviations
    assert not any(len(walkers_of(draw(n, replace(ALONE, late_sight=None)))) for n in range(4))


def test_the_section_is_read_and_absent_keys_mean_defaults():
    assert scene_config(CFG).late_sight == LateSightConfig()
    assert scene_config({**CFG, "LATE_SIGHT": {}}).late_sight == LateSightConfig()
    assert scene_config({**CFG, "LATE_SIGHT": None}).late_sight is None
    assert completed({**CFG, "LATE_SIGHT": {}}) == completed(CFG)


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"SHAER": 0.5}, r"GENERATE\.LATE_SIGHT.*SHAER"),
        ({"STEPPING_OUT": [3, 1]}, r"LateSightConfig\.stepping_out: expected \(low, high\)"),
    ],
)
def test_mistakes_are_one_error(section, said):
    with pytest.raises(ConfigError, match=said):
        scene_config({**CFG, "LATE_SIGHT": section})


def test_a_plan_has_its_own_bays():
    with pytest.raises(ConfigError, match="PLAN or LATE_SIGHT, found both"):
        replace(SceneConfig(), plan="floor.yaml", late_sight=LATE)
