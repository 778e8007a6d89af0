"""The depth branch alone is the one inside the whole network: same names, same logits, same loss."""

import logging
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from pcdet_avp.config import load_config
from pcdet_avp.engine import checkpoint
from pcdet_avp.errors import CheckpointError, ConfigError
from pcdet_avp.models import build_network, detects_objects
from pcdet_avp.models.backbones_image.depth_loss import expected_depth

CFGS = Path(__file__).parents[3] / "cfgs" / "avp"
LOG = logging.Logger("silent", 99)


def network(seed=0, **model):
    """cp_tiny with some keys of MODEL replaced."""
    cfg = load_config(CFGS / "cp_tiny.yaml")
    data = cfg.DATA_CONFIG
    dataset = SimpleNamespace(
        class_names=cfg.CLASS_NAMES,
        point_cloud_range=data.POINT_CLOUD_RANGE,
        voxel_size=data.VOXEL_SIZE,
        point_feature_encoder=SimpleNamespace(num_point_features=4),
    )
    torch.manual_seed(seed)
    return build_network({**cfg.MODEL, **model}, 2, dataset)


def depth_network(seed=0, **model):
    return network(seed, NAME="CameraDepth", **model)


def make_batch(size=2):
    generator = torch.Generator().manual_seed(1)
    batch = {"batch_size": size, "frame_id": [f"s/{i}" for i in range(size)], "source_present": torch.ones(size, 4)}
    batch["source_present"][:, [1, 3]] = 0
    batch["gt_boxes"] = torch.tensor([[[12.0, 0, 0.8, 20, 20, 3, 0, 1]]]).repeat(size, 1, 1)
    batch["ego_from_infra"] = torch.eye(4).repeat(size, 1, 1)
    to_cam = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 1.8], [1, 0, 0, 0], [0, 0, 0, 1]])
    to_img = torch.tensor([[96.0, 0, 96, 0], [0, 96, 54, 0], [0, 0, 1, 0]])
    for suffix in ("", "_infra"):
        batch[f"images{suffix}"] = torch.rand(size, 3, 108, 192, generator=generator)
        batch[f"depth_maps{suffix}"] = 3 + 30 * torch.rand(size, 27, 48, generator=generator)
        batch[f"trans_lidar_to_cam{suffix}"] = to_cam.repeat(size, 1, 1)
        batch[f"trans_cam_to_img{suffix}"] = to_img.repeat(size, 1, 1)
    return batch


@pytest.mark.parametrize("shared", [False, True])
def test_its_names_and_shapes_are_the_whole_networks(shared):
    whole = {k: v.shape for k, v in network(SHARE_ENCODERS=shared).state_dict().items()}
    found = {k: v.shape for k, v in depth_network(SHARE_ENCODERS=shared).state_dict().items()}
    cameras = ("encoders.camera.",) if shared else ("encoders.ego_camera.", "encoders.infra_camera.")
    branches = tuple(f"{camera}{part}." for camera in cameras for part in ("image_backbone", "depth_head"))
    assert found == {k: v for k, v in whole.items() if k.startswith(branches) or k == "global_step"}


def test_its_loss_is_the_depth_loss_of_the_whole_network():
    whole, branch, batch = network(), depth_network(seed=1), make_batch()
    branch.load_state_dict({k: v for k, v in whole.state_dict().items() if k in branch.state_dict()})
    _, theirs, _ = whole.train()(batch)
    returned, ours, _ = branch.train()(batch)
    for agent in ("ego", "infra"):
        torch.testing.assert_close(ours[f"depth_loss_{agent}"], theirs[f"depth_loss_{agent}"])
    torch.testing.assert_close(returned["loss"].detach(), ours["depth_loss_ego"] + ours["depth_loss_infra"])
    returned["loss"].backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in branch.parameters())


def test_in_evaluation_it_returns_the_expected_depths():
    branch, batch = depth_network().eval(), make_batch()
    with torch.no_grad():
        depths, _ = branch(batch)
        logits = branch.depth_logits(batch)["infra_camera"]
    assert depths["ego_camera"].shape == (2, 27, 48)
    expected = expected_depth(logits, branch.encoders["infra_camera"].bins["infra"])
    assert torch.equal(depths["infra_camera"], expected)
    assert not torch.equal(expected, expected_depth(logits, branch.encoders["infra_camera"].bins["ego"]))


def test_only_the_cameras_of_its_agents_are_looked_at():
    branch, batch = depth_network(AGENTS=["infra"]), make_batch()
    assert branch.sources == ("infra_camera",)
    assert all(k.startswith("encoders.infra_camera.") or k == "global_step" for k in branch.state_dict())
    del batch["images"], batch["depth_maps"]
    assert branch.train()(batch)[0]["loss"] > 0
    for agents in ([], ["mast"], ["ego", "ego"], "ego"):
        with pytest.raises(ConfigError, match=r"MODEL\.AGENTS: expected one or both of ego, infra"):
            depth_network(AGENTS=agents)


def test_two_partial_files_fill_the_cameras_of_a_whole_network(tmp_path):
    """Each agent's branch from its own file; LiDAR, fuser and head stay what they were."""
    for seed, agent in enumerate(("ego", "infra"), start=10):
        state = {"model_state": depth_network(seed, AGENTS=[agent]).state_dict()}
        checkpoint.save(tmp_path / f"{agent}.pth", state)
    whole, fresh = network(), network().state_dict()
    for agent in ("ego", "infra"):
        whole.load_params_from_file(tmp_path / f"{agent}.pth", LOG)
    for seed, agent in enumerate(("ego", "infra"), start=10):
        for key, value in depth_network(seed, AGENTS=[agent]).encoders.state_dict().items():
            assert torch.equal(whole.encoders.state_dict()[key], value), key
    branches = (".image_backbone.", ".depth_head.")
    others = {k: v for k, v in whole.state_dict().items() if not any(part in k for part in branches)}
    assert len(others) > 50
    assert all(torch.equal(value, fresh[key]) for key, value in others.items())


def test_it_starts_from_a_whole_network_and_refuses_another_size(tmp_path):
    whole = network(seed=4)
    checkpoint.save(tmp_path / "whole.pth", {"model_state": whole.state_dict()})
    branch = depth_network()
    branch.load_params_from_file(tmp_path / "whole.pth", LOG)
    assert all(torch.equal(value, whole.state_dict()[key]) for key, value in branch.state_dict().items())
    wider = load_config(CFGS / "cp_tiny.yaml").MODEL.CAMERA_ENCODER
    wider.DEPTH.NUM_BINS = 30
    with pytest.raises(CheckpointError, match=r"depth_head\.classify\.weight has shape"):
        depth_network(CAMERA_ENCODER=wider).load_params_from_file(tmp_path / "whole.pth", LOG)


def test_what_ends_in_boxes_and_what_in_depths():
    assert detects_objects({"NAME": "AvpCp"})
    assert not detects_objects({"NAME": "CameraDepth"})
