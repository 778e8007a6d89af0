"""Export forms in torch: each gives the answers of the module that it stands for."""

from pathlib import Path

import numpy as np
import pytest
import torch

from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.deploy import frustum, pillars, warp
from pcdet_avp.errors import ConfigError, ExportError
from pcdet_avp.models import build_network
from pcdet_avp.models.compression.rounding import _exponents_by_comparison, _power_of_two, int8_exponents
from pcdet_avp.models.cpu_kernels.dispatch import plain_operations
from pcdet_avp.models.export import forms
from pcdet_avp.models.export.describe import describe
from pcdet_avp.models.fusion.warp import warp as warp_in_torch
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SOURCES

CFG = Path(__file__).parents[3] / "cfgs" / "avp" / "cp_tiny.yaml"


def network_of(change=lambda cfg: None):
    """A tiny network with random weights in every layer, and what its graphs leave open."""
    cfg = load_config(CFG)
    change(cfg)
    torch.manual_seed(0)
    network_input = NetworkInput.from_config(cfg.DATA_CONFIG, cfg.CLASS_NAMES)
    network = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), network_input).eval().requires_grad_(False)
    for parameter in network.parameters():
        if not parameter.any():
            parameter.normal_(std=0.2)
    return network, describe(network, cfg.CLASS_NAMES)


def set_key(path, value):
    def change(cfg):
        *sections, key = path.split(".")
        for section in sections:
            cfg = cfg[section]
        cfg[key] = value

    return change


@pytest.fixture(scope="module")
def built():
    return network_of()


def random_map(description, seed, channels=None):
    grid = description.grid
    shape = (1, channels or description.channels, grid.height, grid.width)
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("change", [None, ("SAMPLING", "nearest"), ("SAMPLING", "factorised")])
@pytest.mark.parametrize("agent", ["ego", "infra"])
def test_camera(change, agent):
    network, description = network_of(
        set_key(f"MODEL.CAMERA_ENCODER.MAP_TO_BEV.{change[0]}", change[1]) if change else lambda cfg: None
    )
    suffix, source = "_infra" if agent == "infra" else "", f"{agent}_camera"
    pose = Pose.from_xyz_yaw(0.0, 0.0, 2.0, yaw=0.1, pitch_down=0.2).matrix
    optical = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    to_cam = (optical @ np.linalg.inv(pose)).astype(np.float32)
    to_img = np.array([[96.0, 0, 96, 0], [0, 96, 54, 0], [0, 0, 1, 0]], np.float32)
    image = torch.rand(1, 3, 108, 192)
    batch = {"batch_size": 1, "bev_maps": {}, "bev_valid": {}, f"images{suffix}": image}
    batch |= {f"trans_lidar_to_cam{suffix}": torch.from_numpy(to_cam)[None]}
    batch |= {f"trans_cam_to_img{suffix}": torch.from_numpy(to_img)[None], "source_present": torch.ones(1, 4)}
    with plain_operations():
        expected = network.encoder_of(source)(batch, source)
    camera = description.cameras[agent]
    matrix = frustum.image_from_agent(to_cam, to_img, camera.crop_px)
    tables = frustum.tables(matrix, description.grid, camera, (108 - camera.crop_px, 192))
    inputs = {name: torch.from_numpy(table) for name, table in vars(tables).items()}
    with plain_operations():
        found = forms.CameraForm(network.encoder_of(source), agent)(image, **inputs)
    valid = torch.from_numpy(tables.row_of_cell > 0).view_as(expected["bev_valid"][source])
    assert torch.equal(valid, expected["bev_valid"][source])
    assert 100 < valid.sum() < valid.numel()
    assert expected["bev_maps"][source].any()
    torch.testing.assert_close(found, expected["bev_maps"][source], atol=1e-4, rtol=1e-3)


@pytest.mark.parametrize(
    "change",
    [
        ("VFE.NUM_FILTERS", [8, 16]),
        ("VFE.NORM", "batch"),
        ("ATTENTION", None),
        ("VFE.USE_ABSLOTE_XYZ", False),
    ],
)
def test_lidar(change):
    network, description = network_of(set_key(f"MODEL.LIDAR_ENCODER.{change[0]}", change[1]))
    grid, encoder = description.grid, network.encoder_of("infra_lidar")
    low, high = np.array(grid.range[:3]) - 1, np.array(grid.range[3:]) + 1
    points = np.random.default_rng(0).uniform([*low, 0], [*high, 1], (3000, 4)).astype(np.float32)
    batch = {"batch_size": 1, "bev_maps": {}, "bev_valid": {}, "source_present": torch.ones(1, 4)}
    batch["points_infra"] = torch.from_numpy(np.insert(points, 0, 0, 1))
    with plain_operations():
        expected = encoder(batch, "infra_lidar")["bev_maps"]["infra_lidar"]
    x, cells = pillars.decorate(points, grid, description.pillars)
    for i, layer in enumerate(encoder.vfe.pfn_layers):
        x = forms.PointsForm(layer)(torch.from_numpy(x)).numpy()
        highest = pillars.maxima(x, cells, grid.height * grid.width)
        x = np.concatenate([x, highest[cells]], 1) if i + 1 < description.pillars.layers else x
    pillar_map = torch.from_numpy(highest).view(1, grid.height, grid.width, -1)
    with plain_operations():
        found = forms.LidarForm(encoder)(pillar_map)
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-3)


@pytest.mark.parametrize("pose", [Pose.from_xyz_yaw(3.3, -2.0, yaw=2.5), Pose.from_xyz_yaw(0.0, 0.0)])
def test_warp(built, pose):
    _, description = built
    bev_map, valid = random_map(description, 0), random_map(description, 1, channels=1) > 0.3
    with plain_operations():
        expected = warp_in_torch(bev_map, valid, torch.from_numpy(pose.matrix.copy())[None], description.grid)
    cells, weights = map(torch.from_numpy, warp.neighbours(pose.matrix, description.grid))
    found = forms.WarpForm(description.grid)(bev_map, valid, cells, weights)
    assert torch.equal(found[1], expected[1])
    torch.testing.assert_close(found[0], expected[0], atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("present", [(0,), (0, 3), (0, 1, 2, 3)])
@pytest.mark.parametrize("fuser", ["AdaFusion", "MaxFusion"])
def test_a_source_that_is_absent_everywhere_is_as_one_that_is_left_out(fuser, present):
    network, description = network_of(set_key("MODEL.FUSER.NAME", fuser))
    maps = {SOURCES[i]: random_map(description, i) for i in present}
    masks = {SOURCES[i]: random_map(description, 9 + i, channels=1) > 0.4 for i in present}
    expected = network.fuser({"bev_maps": maps, "bev_valid": masks})["spatial_features"]
    nothing = torch.zeros_like(next(iter(maps.values()))), torch.zeros_like(next(iter(masks.values())))
    inputs = {source: maps.get(source, nothing[0]) for source in SOURCES}
    inputs |= {f"{source}_valid": masks.get(source, nothing[1]) for source in SOURCES}
    torch.testing.assert_close(forms.FuseForm(network.fuser)(**inputs), expected, atol=1e-6, rtol=1e-6)


def test_compress_and_back(built):
    network, description = built
    codec, bev_map = network.codec.codecs["lidar"], random_map(description, 0)
    latent = forms.CompressForm(codec)(bev_map)
    assert torch.equal(latent, codec.compress(bev_map)[0])
    assert latent.any()
    assert torch.equal(forms.DecompressForm(codec)(latent), codec.decompress(latent))


@pytest.mark.parametrize("threads", [1, 2])
def test_the_layout_in_memory_and_the_threads_change_no_bit_of_a_latent(built, threads):
    network, description = built
    codec, bev_map = network.codec.codecs["camera"], random_map(description, 3)
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        other = codec.compress(bev_map.contiguous(memory_format=torch.channels_last))[0]
        assert torch.equal(other, codec.compress(bev_map)[0])
    finally:
        torch.set_num_threads(before)


def test_exponents_by_comparison_are_those_of_frexp():
    # Around every limit, 127 * 2**e, its neighbours in float32, powers of two, and the ends of the range.
    limits = np.float32(127) * np.exp2(np.arange(-119, 119)).astype(np.float32)
    values = np.concatenate([limits, np.nextafter(limits, np.float32(0)), np.nextafter(limits, np.float32(np.inf))])
    powers = np.exp2(np.arange(-126, 127)).astype(np.float32)
    x = torch.from_numpy(np.concatenate([values, powers, [0.0, 1e-45, 3e38]]).astype(np.float32)).view(1, -1, 1, 1)
    exponents = int8_exponents(x)
    assert torch.equal(_exponents_by_comparison(x), exponents.long())
    assert torch.equal(_power_of_two(exponents), torch.ldexp(torch.ones_like(x), exponents))


def test_what_has_no_half_on_the_air_is_refused():
    with pytest.raises(ConfigError, match=r"--out: MODEL.COMPRESSION sends maps as they are"):
        network_of(set_key("MODEL.COMPRESSION.NAME", "NoCompression"))
    with pytest.raises(ExportError, match=r"MODEL.NAME: expected AvpCp, found Linear"):
        describe(torch.nn.Linear(1, 1), ["Car"])
