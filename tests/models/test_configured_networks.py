"""The networks of cfgs/avp with their real stages: every configuration builds; tiny and full ones run."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pcdet_avp.config import load_config
from pcdet_avp.link import NrV2xConfig
from pcdet_avp.link.map_size import UNLIMITED, MapSize
from pcdet_avp.models import build_network
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SOURCES

CFGS = Path(__file__).parents[2] / "cfgs" / "avp"
CONFIGS = sorted(str(path.relative_to(CFGS)) for path in CFGS.rglob("*.yaml"))
DEPTH_ONLY = [name for name in CONFIGS if name.endswith("_depth.yaml")]
CAMERA_HEIGHT_M = {"": 1.8, "_infra": 7.0}


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def network_of(name, seed=0):
    cfg = load_config(CFGS / name)
    data = cfg.DATA_CONFIG
    dataset = SimpleNamespace(
        class_names=cfg.CLASS_NAMES,
        point_cloud_range=data.POINT_CLOUD_RANGE,
        voxel_size=data.VOXEL_SIZE,
        point_feature_encoder=SimpleNamespace(num_point_features=4),
    )
    torch.manual_seed(seed)
    return build_network(cfg.MODEL, len(cfg.CLASS_NAMES), dataset), cfg


def make_batch(combos, image_shape, points=4000, seed=0):
    """Random clouds and noisy images with sound calibration, as ``load_batch`` returns them."""
    generator = torch.Generator().manual_seed(seed)
    B = len(combos)
    batch = {"batch_size": B, "frame_id": np.array([f"0000/{i:03d}" for i in range(B)])}
    present = torch.tensor([SENSOR_SETS[name].mask for name in combos]).float()
    poses = [Pose.from_xyz_yaw(25.0 + 3 * i, 1.0 - i, yaw=3.0 + 0.1 * i).matrix for i in range(B)]
    boxes = [[12.0, -1.5, 0.8, 4.5, 1.9, 1.6, 0.1, 1], [9.0, 3.0, 0.9, 0.4, 0.4, 1.75, 0.0, 2]]
    batch |= {"source_present": present, "ego_from_infra": torch.tensor(np.stack(poses)).float()}
    batch["gt_boxes"] = torch.tensor([boxes] * B)
    for suffix, camera, lidar in (("", 0, 1), ("_infra", 2, 3)):
        seen = present[:, camera].view(-1, 1, 1, 1)
        h, w = image_shape
        batch[f"images{suffix}"] = torch.rand(B, 3, h, w, generator=generator) * seen
        depths = 4 + 30 * torch.rand(B, -(-h // 4), -(-w // 4), generator=generator)
        batch[f"depth_maps{suffix}"] = depths * seen[:, 0]
        pinhole = PinholeCamera.looking_ahead(w, h, np.pi / 2, 0.0, CAMERA_HEIGHT_M[suffix], 0.5 if suffix else 0.0)
        to_camera = torch.tensor(pinhole.agent_from_camera.inverse().matrix).float()
        to_image = torch.tensor(np.c_[pinhole.intrinsics, np.zeros(3)]).float()
        batch[f"trans_lidar_to_cam{suffix}"] = to_camera.expand(B, 4, 4)
        batch[f"trans_cam_to_img{suffix}"] = to_image.expand(B, 3, 4)
        cloud = torch.rand(B, points, 4, generator=generator) * torch.tensor([44.7, 60.0, 3.9, 1.0])
        number = torch.arange(B).view(B, 1, 1).expand(B, points, 1)
        cloud = torch.cat([number, cloud - torch.tensor([0.0, 30.0, 0.4, 0.0])], 2)
        batch[f"points{suffix}"] = cloud[present[:, lidar].bool()].reshape(-1, 5)
    return batch


def raw_outputs(network, batch):
    """Logits and boxes of every anchor, before the threshold and NMS."""
    with torch.no_grad():
        out = network.eval().run_stages(batch)
    return out["batch_cls_preds"], out["batch_box_preds"]


TINY = (108, 192)


@pytest.mark.parametrize("name", DEPTH_ONLY)
def test_every_depth_branch_builds_and_trains(name):
    network, cfg = network_of(name)
    returned, terms, _ = network.train()(make_batch(["C+C"], tuple(cfg.DATA_CONFIG.IMAGE_SHAPE)))
    returned["loss"].backward()
    assert set(terms) == {"depth_loss_ego", "depth_loss_infra", "loss"}
    assert all(parameter.grad.isfinite().all() for parameter in network.parameters())


@pytest.mark.parametrize("name", [name for name in CONFIGS if name not in DEPTH_ONLY])
def test_every_configuration_builds(name):
    network, cfg = network_of(name)
    assert cfg.MODEL.NAME == "AvpCp"
    assert network.dense_head.anchors.shape[1] == 7
    full = (30e6, 60e6)
    expected = {
        "cp_full.yaml": full,
        "ablations/from_openpcdet.yaml": full,
        "cp_small.yaml": (1.4e6, 1.6e6),
        "cp_small_first.yaml": (1.8e6, 2e6),
        "cp_tiny.yaml": (3e4, 2e5),
    }
    low, high = expected.get(name, (0.9e6, 1.7e6))
    assert low < sum(p.numel() for p in network.parameters()) < high


def test_cp_small_takes_its_pretrained_cameras_and_sends_what_the_first_edition_sends():
    """The names and shapes of the depth branches' checkpoints, and of the codec; the same keys about the wire."""
    first, cfg = network_of("cp_small_first.yaml")
    second, slim = network_of("cp_small.yaml")
    shapes = {name: p.shape for name, p in second.state_dict().items()}
    cameras = {name: p.shape for name, p in network_of("cp_small_depth.yaml")[0].state_dict().items()}
    assert cameras.items() <= shapes.items()
    assert slim.MODEL.CAMERA_ENCODER == load_config(CFGS / "cp_small_depth.yaml").MODEL.CAMERA_ENCODER
    assert {n: p.shape for n, p in first.codec.state_dict().items()} == {
        n: p.shape for n, p in second.codec.state_dict().items()
    }
    for key in ("COMPRESSION", "NUM_BEV_FEATURES"):
        assert slim.MODEL[key] == cfg.MODEL[key]


def test_the_block_configuration_begins_with_cp_smalls_weights_and_differs_in_what_it_sends_alone():
    small, cfg = network_of("cp_small.yaml")
    block, limited = network_of("cp_small_block.yaml")
    assert {n: p.shape for n, p in small.state_dict().items()} == {n: p.shape for n, p in block.state_dict().items()}
    assert {**limited.MODEL, "COMPRESSION": cfg.MODEL.COMPRESSION} == cfg.MODEL
    assert (limited.DATA_CONFIG, limited.OPTIMIZATION) == (cfg.DATA_CONFIG, cfg.OPTIMIZATION)
    assert block.codec.map_size == MapSize(NrV2xConfig(mcs=14).max_segment_bytes, constant=True)
    assert small.codec.map_size == UNLIMITED
    assert {codec.precision for codec in block.codec.codecs.values()} == {"int8"}


@pytest.mark.parametrize("combo", SENSOR_SETS)
def test_every_combination_trains_and_detects(combo):
    """Gradients are finite and reach every parameter of a stage that the combination uses."""
    network, _ = network_of("cp_tiny.yaml")
    open_branches(network)
    batch = make_batch([combo, combo], TINY)
    network.train()(batch)[0]["loss"].backward()
    used = [source for source, present in zip(SOURCES, SENSOR_SETS[combo].mask, strict=True) if present]
    for name, parameter in network.named_parameters():
        if not is_used(name, used):
            assert parameter.grad is None or parameter.grad.abs().max() < 1e-4, name
        else:
            assert parameter.grad is not None, name
            assert parameter.grad.isfinite().all(), name
            assert parameter.grad.any(), name
    found, _ = network.eval()(batch)
    assert all(f["pred_boxes"].isfinite().all() for f in found)


def open_branches(network):
    """Residual branches start at zero, so what feeds them gets its first gradient in the second step."""
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in network.parameters():
            if not parameter.any():
                parameter.copy_(0.05 * torch.randn(parameter.shape, generator=generator))


def is_used(name, used):
    parts = name.split(".")
    if parts[0] == "encoders":
        return parts[1] in used
    if parts[0] == "codec":
        return f"infra_{parts[2]}" in used
    return not (name.startswith("fuser.channel.") and len(used) == 1)  # one weight, normalised, is one


def test_a_batch_of_all_combinations_equals_the_single_runs(select):
    network, _ = network_of("cp_tiny.yaml")
    open_branches(network)
    batch = make_batch(list(SENSOR_SETS), TINY)
    together = raw_outputs(network, batch)
    for i in range(len(SENSOR_SETS)):
        for whole, single in zip(together, raw_outputs(network, select(batch, i)), strict=True):
            torch.testing.assert_close(whole[i : i + 1], single, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("vehicle", ["C", "CL"])
def test_a_roadside_that_is_absent_lost_or_out_of_range_gives_the_same_bits(vehicle):
    network, _ = network_of("cp_tiny.yaml")
    open_branches(network)
    full = make_batch([f"{vehicle}+CL"], TINY)
    expected = raw_outputs(network, {**full, "source_present": torch.tensor([SENSOR_SETS[f"{vehicle}+none"].mask])})
    far = full["ego_from_infra"].clone()
    far[:, :2, 3] += 200.0
    with torch.no_grad():
        lost = network.eval().run_stages(full, link=lambda latents: {})
    assert not torch.equal(expected[0], raw_outputs(network, full)[0])
    for outputs in (
        raw_outputs(network, {**full, "ego_from_infra": far}),
        (lost["batch_cls_preds"], lost["batch_box_preds"]),
    ):
        assert torch.equal(expected[0], outputs[0])
        assert torch.equal(expected[1], outputs[1])


def test_every_parameter_sits_in_a_leaf_module():
    """OpenPCDet's optimiser sees no other ones."""
    for module in network_of("cp_tiny.yaml")[0].modules():
        assert not list(module.children()) or not list(module.parameters(recurse=False)), type(module).__name__


def test_a_sample_of_the_papers_size_goes_from_sensors_to_boxes():
    network, cfg = network_of("cp_full.yaml")
    batch = make_batch(["CL+CL"], tuple(cfg.DATA_CONFIG.IMAGE_SHAPE), points=100_000)
    with torch.no_grad():
        out = network.eval().run_stages(batch)
        found, _ = network.post_processing(out)
    assert out["latents"]["infra_lidar"].values.shape == (1, 8, 188, 140)
    assert out["spatial_features"].shape == (1, 64, 376, 280)
    assert out["spatial_features_2d"].shape == (1, 384, 188, 140)
    assert out["batch_box_preds"].shape == (1, 188 * 140 * 3, 7)
    assert set(found[0]) == {"pred_boxes", "pred_scores", "pred_labels"}
