"""Encoders: only present sensors are read, samples do not mix, and everything sits on the agent's own grid."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from easydict import EasyDict

from pcdet_avp.errors import ConfigError, SensorError
from pcdet_avp.models.encoders.camera_encoder import CameraEncoder
from pcdet_avp.models.encoders.lidar_encoder import LidarEncoder
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SOURCES

CHANNELS, GRID = 8, (12, 10)
DATASET = SimpleNamespace(
    point_cloud_range=[0.0, -6.0, -0.5, 10.0, 6.0, 3.5],
    voxel_size=[1.0, 1.0, 4.0],
    point_feature_encoder=SimpleNamespace(num_point_features=4),
)
ATTENTION = {"HEADS": 2, "POINTS": 2}
LIDAR = EasyDict(VFE={"NAME": "DynamicPillars", "NUM_FILTERS": [8]}, MAP_TO_BEV={"NAME": "PillarScatter"})
CAMERA = EasyDict(
    IMAGE_BACKBONE={"BLOCKS": [1, 1], "WIDTHS": [8, 16], "STEM": 8, "OUT_CHANNELS": 8},
    DEPTH={"MODE": "LID", "NUM_BINS": 12, "RANGE_M": {"ego": [1.0, 10.0], "infra": [3.0, 12.0]}, "MID_CHANNELS": 8},
    MAP_TO_BEV={"NAME": "FrustumToBev", "HEIGHTS": 4},
)
CAMERAS = {
    "": PinholeCamera.looking_ahead(64, 36, math.pi / 2, 0.0, 1.8),
    "_infra": PinholeCamera.looking_ahead(64, 36, math.pi / 2, 0.0, 7.0, math.radians(30)),
}


def encoder(source, attention=ATTENTION):
    torch.manual_seed(1)
    kind, cfg = (CameraEncoder, CAMERA) if "camera" in source else (LidarEncoder, LIDAR)
    module = kind(EasyDict({**cfg, "ATTENTION": attention}), CHANNELS, DATASET)
    if attention:
        for layer in (module.attention.output, module.attention.ffn_out):
            torch.nn.init.normal_(layer.weight, std=0.3)
    return module


def sample(name, seed):
    """A batch of one with the sensors of a combination; the arrays of the others are zero or empty."""
    rng, sensors = np.random.default_rng(seed), SENSOR_SETS[name]
    batch = {"batch_size": 1, "source_present": torch.tensor([sensors.mask]).float(), "bev_maps": {}, "bev_valid": {}}
    for suffix, agent in (("", "ego"), ("_infra", "infra")):
        n = 200 if getattr(sensors, f"{agent}_lidar") else 0
        xyzi = rng.uniform([0, -6, -0.5, 0], [10, 6, 3.5, 1], (n, 4))
        batch["points" + suffix] = torch.tensor(np.c_[np.zeros(n), xyzi], dtype=torch.float32)
        seen = float(getattr(sensors, f"{agent}_camera"))
        batch["images" + suffix] = torch.tensor(rng.uniform(0, seen, (1, 3, 36, 64)), dtype=torch.float32)
        batch["depth_maps" + suffix] = torch.tensor(rng.uniform(0, 12 * seen, (1, 9, 16)), dtype=torch.float32)
        camera = CAMERAS[suffix]
        to_cam, to_img = camera.agent_from_camera.inverse().matrix, np.c_[camera.intrinsics, np.zeros(3)]
        batch["trans_lidar_to_cam" + suffix] = torch.tensor(to_cam[None], dtype=torch.float32)
        batch["trans_cam_to_img" + suffix] = torch.tensor(to_img[None], dtype=torch.float32)
    batch["gt_boxes"] = torch.tensor([[[6.0, 1, 1, 4, 2, 2, 0.3, 1], [0] * 8]])
    batch["ego_from_infra"] = torch.eye(4)[None]
    return batch


def collate(samples):
    batch = {"batch_size": len(samples), "bev_maps": {}, "bev_valid": {}}
    for key, value in samples[0].items():
        if key.startswith("points"):
            numbered = [s[key] + torch.tensor([i, 0, 0, 0, 0]) for i, s in enumerate(samples)]
            batch[key] = torch.cat(numbered)
        elif torch.is_tensor(value):
            batch[key] = torch.cat([s[key] for s in samples])
    return batch


@pytest.mark.parametrize("source", SOURCES)
def test_a_batch_of_all_combinations_equals_the_single_runs(source):
    module, singles = encoder(source), [sample(name, i) for i, name in enumerate(SENSOR_SETS)]
    together = module(collate(singles), source)
    maps, valid = together["bev_maps"][source], together["bev_valid"][source]
    assert maps.shape == (6, CHANNELS, *GRID)
    assert (valid.shape, valid.dtype) == ((6, 1, *GRID), torch.bool)
    for i, (single, sensors) in enumerate(zip(singles, SENSOR_SETS.values(), strict=True)):
        alone = module(single, source)
        torch.testing.assert_close(alone["bev_maps"][source][0], maps[i], atol=1e-5, rtol=1e-5)
        assert torch.equal(alone["bev_valid"][source][0], valid[i])
        present = sensors.mask[SOURCES.index(source)]
        assert bool(valid[i].any()) == bool(maps[i].any()) == present
        assert (maps[i] * ~valid[i]).eq(0).all()


@pytest.mark.parametrize("source", SOURCES)
def test_what_lies_in_an_absent_sensors_arrays_changes_nothing(source):
    module, batch = encoder(source), collate([sample("CL+CL", 0), sample("CL+CL", 1)])
    batch["source_present"][1, SOURCES.index(source)] = 0
    expected = module(batch, source)
    suffix = "_infra" if "infra" in source else ""
    points = batch["points" + suffix].clone()
    points[points[:, 0] == 1, 1:] = float("nan")
    garbage = {"points" + suffix: points, "images" + suffix: batch["images" + suffix].clone()}
    garbage["images" + suffix][1] = float("inf")
    found = module({**batch, **garbage}, source)
    assert torch.equal(found["bev_maps"][source], expected["bev_maps"][source])
    if "camera" in source:
        depth = batch["depth_maps" + suffix].clone()
        depth[1] = float("nan")
        loss = module.get_loss({**found, "depth_maps" + suffix: depth}, source)[0]
        assert torch.equal(loss, module.get_loss(expected, source)[0])


@pytest.mark.parametrize("source", SOURCES)
def test_no_sample_has_the_sensor(source):
    module, batch = encoder(source), collate([sample("CL+CL", 0), sample("CL+CL", 1)])
    batch["source_present"][:] = 0
    found = module(batch, source)
    assert found["bev_maps"][source].shape == (2, CHANNELS, *GRID)
    assert not found["bev_maps"][source].any()
    assert not found["bev_valid"][source].any()
    if "camera" in source:
        assert module.get_loss(found, source)[0] == 0


def test_encoders_add_to_what_other_encoders_wrote():
    batch = sample("CL+CL", 0)
    for source in SOURCES:
        batch = encoder(source)(batch, source)
    assert list(batch["bev_maps"]) == list(batch["bev_valid"]) == list(SOURCES)
    assert set(batch["depth_logits"]) == {"ego_camera", "infra_camera"}
    assert batch["bev_valid"]["infra_lidar"].all()
    assert not batch["bev_valid"]["ego_camera"].all()


def test_losses_of_a_batch_are_the_mean_of_single_ones():
    module, singles = encoder("infra_camera"), [sample(name, i) for i, name in enumerate(SENSOR_SETS)]
    loss, terms = module.get_loss(module(collate(singles), "infra_camera"), "infra_camera")
    alone = [module.get_loss(module(single, "infra_camera"), "infra_camera")[0] for single in singles]
    torch.testing.assert_close(loss, torch.stack(alone).mean())
    assert set(terms) == {"depth_loss_infra"}
    assert not terms["depth_loss_infra"].requires_grad


def test_mask_of_the_mast_starts_where_its_camera_starts_to_see():
    """7 m high, pitched 30 degrees down, vertical half angle 29.36 degrees: what is 2.5 m high is seen from 2.6 m."""
    valid = encoder("infra_camera")(sample("CL+CL", 0), "infra_camera")["bev_valid"]["infra_camera"][0, 0]
    nearest = 4.5 / math.tan(math.radians(30) + math.atan(18 / 32))  # 4.5 m below the camera: height 2.5 m
    first = int(valid[6].nonzero()[0])
    assert first - 1 <= nearest <= first + 1.5


def test_without_attention_the_map_is_the_scattered_pillars():
    batch = sample("CL+none", 3)
    plain = encoder("ego_lidar", attention=None)
    features, coords = plain.vfe.encode(batch["points"], 1)
    expected = plain.map_to_bev_module.scatter(features, coords, 1)
    assert torch.equal(plain(batch, "ego_lidar")["bev_maps"]["ego_lidar"], expected)


def test_every_parameter_learns_and_sits_in_a_leaf_module():
    for source in ("ego_camera", "infra_lidar"):
        module, batch = encoder(source), sample("CL+CL", 0)
        out = module(batch, source)
        loss = out["bev_maps"][source].square().sum()
        (loss + (module.get_loss(out, source)[0] if "camera" in source else 0)).backward()
        assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in module.parameters())
        leaves = {id(p) for m in module.modules() if not list(m.children()) for p in m.parameters()}
        assert leaves == {id(p) for p in module.parameters()}


def test_bad_input_is_named():
    module, batch = encoder("infra_camera"), sample("CL+CL", 0)
    with pytest.raises(SensorError, match=r"infra_camera: expected shape \(B, 3, h, w\), found \(1, 36, 64\)"):
        module({**batch, "images_infra": batch["images_infra"][:, 0]}, "infra_camera")
    out = module(batch, "infra_camera")
    with pytest.raises(SensorError, match=r"expected shape \(9, 16\), found \(5, 8\)"):
        module.get_loss({**out, "depth_maps_infra": torch.ones(1, 5, 8)}, "infra_camera")


def test_automatic_mixed_precision_runs_and_agrees():
    for source in ("ego_camera", "ego_lidar"):
        module, batch = encoder(source), sample("CL+none", 0)
        exact = module(batch, source)["bev_maps"][source]
        with torch.autocast("cpu", dtype=torch.bfloat16):
            out = module(batch, source)
            mixed = out["bev_maps"][source]
            mixed.float().square().sum().backward()
        assert mixed.isfinite().all()
        assert (mixed.float() - exact).abs().mean() < 0.05 * exact.abs().mean() + 1e-3


@pytest.mark.parametrize("source", ["ego_camera", "infra_camera"])
def test_a_crop_is_the_same_encoder_on_images_without_their_first_rows(source):
    """Map, mask, loss: those of an uncropped encoder whose images and depth maps begin 8 and 2 rows further down."""
    suffix, agent = ("", "ego") if source.startswith("ego") else ("_infra", "infra")
    whole, batch = encoder(source), sample("C+C", 3)
    torch.manual_seed(1)
    cropped = CameraEncoder(EasyDict({**CAMERA, "ATTENTION": ATTENTION, "CROP_TOP_PX": {agent: 8}}), CHANNELS, DATASET)
    cropped.load_state_dict(whole.state_dict())
    lower = {**batch, f"images{suffix}": batch[f"images{suffix}"][:, :, 8:]}
    lower[f"depth_maps{suffix}"] = batch[f"depth_maps{suffix}"][:, 2:]
    to_img = batch[f"trans_cam_to_img{suffix}"].clone()
    to_img[:, 1, 2] -= 8
    lower[f"trans_cam_to_img{suffix}"] = to_img
    ours, theirs = cropped(batch, source), whole(lower, source)
    assert ours["depth_logits"][source].shape[2:] == (7, 16)
    torch.testing.assert_close(ours["bev_maps"][source], theirs["bev_maps"][source])
    assert torch.equal(ours["bev_valid"][source], theirs["bev_valid"][source])
    torch.testing.assert_close(cropped.get_loss(ours, source)[0], whole.get_loss(theirs, source)[0])


@pytest.mark.parametrize(("crop", "what"), [({"ego": 6}, "multiple of 4"), ({"mast": 8}, "unknown key 'mast'")])
def test_a_crop_between_feature_rows_or_of_nobody_is_refused(crop, what):
    with pytest.raises(ConfigError, match=f"CROP_TOP_PX.*{what}"):
        CameraEncoder(EasyDict({**CAMERA, "ATTENTION": None, "CROP_TOP_PX": crop}), CHANNELS, DATASET)
