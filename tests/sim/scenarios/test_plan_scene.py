"""Training scenes on a plan: nobody overlaps, the ego is on a lane, the unit sees from where the plan hangs it."""

from dataclasses import replace

import numpy as np
import pytest
from plan_files import PLANS, SHIPPED, floor_of, written

from pcdet_avp.config import load_config
from pcdet_avp.errors import ConfigError
from pcdet_avp.generate import generate
from pcdet_avp.sim.plans.paths import nearest
from pcdet_avp.sim.rig import Rig, capture
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.rotated_iou import bev_intersection
from pcdet_avp.structures.scene_config import SceneConfig

CFG = replace(SceneConfig(), frames=2)


def scene_on(file, seed):
    return draw_training_scene(np.random.default_rng(seed), replace(CFG, plan=str(file)))


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_nobody_overlaps_and_the_ego_keeps_to_a_lane(file):
    lanes = floor_of(file.stem).lanes
    for seed in range(4):
        scene = scene_on(file, seed)
        for frame in range(2):
            world = scene.seek(frame)
            boxes = world.road_users().boxes
            shared = bev_intersection(boxes, boxes)
            np.fill_diagonal(shared, 0.0)
            assert shared.max() < 0.02
            assert bev_intersection(boxes, world.layout.solid_boxes()).max() < 0.02
            x, y = world.world_from_ego.translation[:2]
            assert min(nearest(lane.path, x, y)[1] for lane in lanes) < 0.4


def test_the_unit_hangs_where_the_plan_says():
    scene = scene_on(PLANS / "low_deck.yaml", 1)
    rig = Rig.from_config(load_config(PLANS.parent / "dataset_configs" / "avp_tiny.yaml").SENSORS)
    frame = capture(scene.seek(0), rig, (0, 0, 0), "a/0", sources=("infra_camera",))
    unit = floor_of("low_deck").units[0]
    camera = frame.infra.world_from_agent @ frame.infra.camera.agent_from_camera
    assert camera.translation == pytest.approx([unit.x_m, unit.y_m, unit.z_m])
    forward = camera.rotation[:, 2]
    assert np.arctan2(forward[1], forward[0]) % (2 * np.pi) == pytest.approx(unit.yaw_rad % (2 * np.pi))
    assert -np.arcsin(forward[2]) == pytest.approx(unit.pitch_down_rad)
    boxes = transform_boxes(frame.ego.world_from_agent, frame.labels.boxes)
    assert np.allclose(boxes[:, :6], scene.seek(0).road_users().boxes[:, :6])


def facts(scene):
    return [(actor.spec, actor.trajectory) for actor in scene.world.actors]


def test_the_same_seed_gives_the_same_scene():
    a, b = (scene_on(PLANS / "two_lane_loop.yaml", 9) for _ in range(2))
    other = scene_on(PLANS / "two_lane_loop.yaml", 10)
    assert facts(a) == facts(b) != facts(other)
    assert a.ego == b.ego


def test_a_plan_without_a_unit_makes_no_data(tmp_path):
    with pytest.raises(ConfigError, match="expected a roadside unit"):
        scene_on(written(tmp_path), 0)


def test_a_plan_without_a_unit_is_refused_before_a_folder_is_begun(tmp_path):
    cfg = load_config(PLANS.parent / "dataset_configs" / "avp_tiny.yaml")
    cfg.GENERATE.PLAN = str(written(tmp_path))
    with pytest.raises(ConfigError, match=r"plan.yaml: expected a roadside unit \(units: ...\) to make data with"):
        generate(cfg, tmp_path / "set")
    assert not (tmp_path / "set").exists()
