"""The stage that corrects poses in a batch: which ones, by what, and nothing at all where it is off."""

from pathlib import Path

import numpy as np
import pytest
import torch
from garage_of_lines import GRID, POOLING, TRUTH, drawn, seen, walls

from pcdet_avp.config import apply_overrides, config_hash, load_config
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.models import build_network
from pcdet_avp.models.compression.bev_codec import Latent
from pcdet_avp.models.fusion.register import RegisterMaps
from pcdet_avp.models.weights.meaning import meaning_of
from pcdet_avp.registration import RegistrationSettings, SteadyCorrection
from pcdet_avp.structures.pose import Pose

CFG = Path(__file__).parents[3] / "cfgs" / "avp" / "cp_tiny.yaml"
ERROR = Pose.from_xyz_yaw(0.5, -0.3, yaw=np.radians(2.0))


@pytest.fixture(scope="module")
def maps():
    own = torch.from_numpy(drawn(walls(), GRID.cell_m, 3, 0.3))
    sent = torch.from_numpy(drawn(seen(walls(), TRUTH.inverse()), POOLING * GRID.cell_m, 3, 0.05))
    return own, sent


def tensor(pose):
    return torch.tensor(pose.matrix, dtype=torch.float32)


def batch_of(maps, *poses):
    """A sample per pose, with the same maps."""
    (own, sent), n = maps, len(poses)
    return {
        "batch_size": n,
        "bev_maps": {"ego_lidar": own.repeat(n, 1, 1, 1)},
        "bev_valid": {"ego_lidar": torch.ones(n, 1, *own.shape[1:], dtype=torch.bool)},
        "latents": {
            "infra_lidar": Latent(sent.repeat(n, 1, 1, 1), torch.ones(n, 1, *sent.shape[1:], dtype=torch.bool))
        },
        "ego_from_infra": torch.stack([tensor(pose) for pose in poses]),
    }


def registered(batch_dict, **settings):
    return RegisterMaps(GRID, RegistrationSettings(**{"enabled": True, **settings}))(batch_dict)


def off_by(matrix):
    """Metres at 20 m ahead of the vehicle, from the true pose."""
    rest = matrix.double().numpy() @ TRUTH.inverse().matrix
    return np.linalg.norm((rest @ [20, 0, 0, 1])[:2] - [20, 0])


def test_off_the_very_batch_goes_on(maps):
    batch = batch_of(maps, ERROR @ TRUTH)
    assert registered(batch, enabled=False) is batch


def test_each_sample_has_its_own_correction(maps):
    batch = batch_of(maps, TRUTH, ERROR @ TRUTH)
    before = batch["ego_from_infra"].clone()
    found = registered(batch)
    assert [c.accepted for c in found["corrections"]] == [False, True]
    assert torch.equal(found["ego_from_infra"][0], before[0])
    assert off_by(before[1]) > 0.6
    assert off_by(found["ego_from_infra"][1]) < 0.2
    assert torch.equal(batch["ego_from_infra"], before)  # the batch that came in is as it was


def test_where_nothing_is_accepted_poses_are_the_same_tensors(maps):
    batch = batch_of(maps, TRUTH)
    found = registered(batch)
    assert found["ego_from_infra"] is batch["ego_from_infra"]


def test_the_camera_s_map_is_moved_by_what_the_lidars_tell(maps):
    batch = batch_of(maps, TRUTH)  # whose own pose is read by nobody
    pose = tensor(ERROR @ TRUTH)[None]
    batch["ego_from_sender"] = {"infra_lidar": pose, "infra_camera": pose}
    found = registered(batch)["ego_from_sender"]
    assert off_by(found["infra_camera"][0]) < 0.2
    assert found["infra_camera"] is found["infra_lidar"]  # so that the warp computes their geometry once


def test_maps_of_several_units_belong_to_their_samples(maps):
    batch = batch_of(maps, TRUTH, TRUTH)
    values = batch["latents"]["infra_lidar"]
    batch["latents"] = {
        "infra_lidar": Latent(values.values.repeat(2, 1, 1, 1)[:3], values.received.repeat(2, 1, 1, 1)[:3])
    }
    poses = [TRUTH, ERROR @ TRUTH, ERROR @ TRUTH]  # the second sample has two units
    batch["ego_from_sender"] = {"infra_lidar": torch.stack([tensor(pose) for pose in poses])}
    batch["map_samples"] = {"infra_lidar": torch.tensor([0, 1, 1])}
    found = registered(batch)["ego_from_sender"]["infra_lidar"]
    assert torch.equal(found[0], tensor(TRUTH))
    assert off_by(found[1]) < 0.2
    assert torch.equal(found[1], found[2])


@pytest.mark.parametrize("lost", ["own", "sent", "not received"])
def test_without_a_lidar_map_on_both_sides_nothing_moves(maps, lost):
    batch = batch_of(maps, ERROR @ TRUTH)
    if lost == "own":
        batch["bev_maps"] = {"ego_camera": batch["bev_maps"]["ego_lidar"]}
    elif lost == "sent":
        batch["latents"] = {"infra_camera": batch["latents"]["infra_lidar"]}
    else:
        batch["latents"]["infra_lidar"].received[:] = False
    assert registered(batch)["ego_from_infra"] is batch["ego_from_infra"]


def test_with_a_memory_the_last_corrections_still_count(maps):
    memory = SteadyCorrection(frames=5)
    for _ in range(2):
        registered({**batch_of(maps, ERROR @ TRUTH), "correction_memory": memory})
    silent = batch_of(maps, ERROR @ TRUTH) | {"correction_memory": memory}
    silent["bev_maps"] = {}
    assert off_by(registered(silent)["ego_from_infra"][0]) < 0.2


def test_a_network_is_built_with_what_its_configuration_says():
    cfg = load_config(CFG)
    dataset = NetworkInput.from_config(cfg.DATA_CONFIG, cfg.CLASS_NAMES)
    off = build_network(cfg.MODEL, 2, dataset)
    apply_overrides(cfg, ["MODEL.REGISTRATION.ENABLED", "True", "MODEL.REGISTRATION.FRAMES", "3"])
    on = build_network(cfg.MODEL, 2, dataset)
    assert not off.registration.settings.enabled
    assert on.registration.settings.frames == 3
    assert set(on.state_dict()) == set(off.state_dict())


def test_a_configuration_with_registration_off_has_the_hash_of_one_that_knows_none():
    cfg = load_config(CFG)
    bare = load_config(CFG)
    del bare.MODEL["REGISTRATION"]
    assert config_hash(cfg) == config_hash(bare)
    on = apply_overrides(load_config(CFG), ["MODEL.REGISTRATION.ENABLED", "True"])
    assert config_hash(on) != config_hash(bare)
    assert meaning_of(on) == meaning_of(bare)  # weights do not depend on it
