"""A PointPillar with OpenPCDet's names, built here by hand, against our network with its weights."""

import logging
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from torch import nn

from pcdet_avp.config import load_config
from pcdet_avp.errors import CheckpointError, ConfigError
from pcdet_avp.models import build_network
from pcdet_avp.models.weights.openpcdet import is_openpcdet, match_tensors

TINY = Path(__file__).parents[3] / "cfgs" / "avp" / "cp_tiny.yaml"
LOGGER = logging.getLogger("test")
LIDAR_HEIGHT_M, Z_RANGE_M, MAX_POINTS = 1.73, [-3.0, 1.0], 6
CELL_M, X_MIN_M, Y_MIN_M = 0.64, 0.0, -30.08


class Layer(nn.Module):
    """A linear layer and its norm, under OpenPCDet's names."""

    def __init__(self, inputs, outputs):
        super().__init__()
        self.linear, self.norm = nn.Linear(inputs, outputs, bias=False), nn.BatchNorm1d(outputs, eps=1e-3)


class PointPillar(nn.Module):
    """OpenPCDet's: padded pillars, zero padding before unpadded convolutions, one convolution per prediction."""

    def __init__(self, anchors=3, classes=2):
        super().__init__()
        self.vfe = nn.ModuleDict({"pfn_layers": nn.ModuleList([Layer(10, 8), Layer(16, 16)])})
        blocks = [self.stage(16, 16, 1), self.stage(16, 32, 2)]
        ups = [self.up(16, 16, 1), self.up(32, 16, 2)]
        self.backbone_2d = nn.ModuleDict({"blocks": nn.ModuleList(blocks), "deblocks": nn.ModuleList(ups)})
        heads = {"conv_cls": classes, "conv_box": 7, "conv_dir_cls": 2}
        self.dense_head = nn.ModuleDict({k: nn.Conv2d(32, n * anchors, 1) for k, n in heads.items()})
        self.register_buffer("global_step", torch.full((1,), 99))

    @staticmethod
    def stage(inputs, outputs, stride):
        first = [nn.ZeroPad2d(1), nn.Conv2d(inputs, outputs, 3, stride, bias=False)]
        second = [nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)]
        norms = [nn.BatchNorm2d(outputs, eps=1e-3) for _ in range(2)]
        return nn.Sequential(*first, norms[0], nn.ReLU(), *second, norms[1], nn.ReLU())

    @staticmethod
    def up(inputs, outputs, stride):
        conv = nn.ConvTranspose2d(inputs, outputs, stride, stride=stride, bias=False)
        return nn.Sequential(conv, nn.BatchNorm2d(outputs, eps=1e-3), nn.ReLU())

    def pillar(self, points, column, row):
        """One pillar's (n, 4) points, heights from the LiDAR -> its feature; rows of zeros up to MAX_POINTS."""
        centre = [X_MIN_M + (column + 0.5) * CELL_M, Y_MIN_M + (row + 0.5) * CELL_M, sum(Z_RANGE_M) / 2]
        to_centre = points[:, :3] - torch.tensor(centre)
        x = torch.cat([points, points[:, :3] - points[:, :3].mean(0), to_centre], 1)
        x = torch.cat([x, torch.zeros(MAX_POINTS - len(points), 10)])
        for layer in self.vfe["pfn_layers"]:
            each = layer.norm(layer.linear(x)).relu()
            x = torch.cat([each, each.amax(0).expand_as(each)], 1)
        return each.amax(0)

    def see(self, x):
        """A map (B, 16, H, W) -> what the head's three convolutions say."""
        maps = []
        for block, up in zip(self.backbone_2d["blocks"], self.backbone_2d["deblocks"], strict=True):
            x = block(x)
            maps.append(up(x))
        together = torch.cat(maps, 1)
        return together, [conv(together) for conv in self.dense_head.values()]


@pytest.fixture(scope="module")
def openpcdet():
    """Random weights and, as after a training, random statistics."""
    torch.manual_seed(0)
    openpcdet = PointPillar()
    for module in openpcdet.modules():
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
            for tensor in (module.weight, module.running_var):
                nn.init.uniform_(tensor, 0.5, 2.0)
            for tensor in (module.bias, module.running_mean):
                nn.init.normal_(tensor, 0.0, 0.5)
    return openpcdet.eval()


def network(norm="batch", as_openpcdet=True, **model_keys):
    cfg = load_config(TINY)
    cfg.MODEL.update({"NORM": norm, **model_keys})
    cfg.MODEL.LIDAR_ENCODER.VFE.NUM_FILTERS = [16, 16]
    if as_openpcdet:
        section = {"LIDAR_HEIGHT_M": LIDAR_HEIGHT_M, "Z_RANGE_M": Z_RANGE_M, "MAX_POINTS": MAX_POINTS}
        cfg.MODEL.LIDAR_ENCODER.VFE.AS_OPENPCDET = section
    data = cfg.DATA_CONFIG
    encoding = SimpleNamespace(num_point_features=4)
    geometry = {"point_cloud_range": data.POINT_CLOUD_RANGE, "voxel_size": data.VOXEL_SIZE}
    dataset = SimpleNamespace(class_names=cfg.CLASS_NAMES, point_feature_encoder=encoding, **geometry)
    torch.manual_seed(1)
    return build_network(cfg.MODEL, 2, dataset).eval()


@pytest.fixture
def checkpoint(openpcdet, tmp_path):
    torch.save(
        {"model_state": openpcdet.state_dict(), "optimizer_state": None, "epoch": 80}, tmp_path / "openpcdet.pth"
    )
    return tmp_path / "openpcdet.pth"


def test_with_its_weights_our_pillars_are_openpcdets(openpcdet, checkpoint):
    """Full, half-full and single-point pillars; ours stand on the floor, OpenPCDet's hang from the LiDAR."""
    model = network()
    model.load_params_from_file(checkpoint, LOGGER, to_cpu=True)
    generator = torch.Generator().manual_seed(2)
    cells, clouds = [(3, 5), (3, 6), (40, 70)], []
    for (column, row), count in zip(cells, (MAX_POINTS, 3, 1), strict=True):
        points = torch.rand(count, 4, generator=generator)
        low = torch.tensor([X_MIN_M + column * CELL_M, Y_MIN_M + row * CELL_M, -1.7, 0.0])
        clouds.append(low + points * torch.tensor([CELL_M, CELL_M, 2.5, 1.0]) * 0.98)
    expected = torch.stack([openpcdet.pillar(cloud, *cell) for cloud, cell in zip(clouds, cells, strict=True)])
    ours = torch.cat(clouds) + torch.tensor([0.0, 0.0, LIDAR_HEIGHT_M, 0.0])
    for encoder in ("ego_lidar", "infra_lidar"):
        found, coords = model.encoders[encoder].vfe.encode(torch.cat([torch.zeros(len(ours), 1), ours], 1), 1)
        order = [coords[:, 2:].tolist().index([row, column]) for column, row in cells]
        torch.testing.assert_close(found[order], expected, atol=1e-4, rtol=1e-4)
        shifted = torch.cat([torch.zeros(len(ours), 1), ours + torch.tensor([0.0, 0.0, 0.3, 0.0])], 1)
        assert (model.encoders[encoder].vfe.encode(shifted, 1)[0][order] - expected).abs().max() > 1e-2


def test_with_its_weights_our_backbone_and_head_say_what_openpcdets_say(openpcdet, checkpoint):
    model = network()
    model.load_params_from_file(checkpoint, LOGGER, to_cpu=True)
    x = torch.rand(1, 16, 94, 70, generator=torch.Generator().manual_seed(3))
    together, said = openpcdet.see(x)
    ours = model.backbone_2d.encode(x)
    torch.testing.assert_close(ours, together, atol=1e-4, rtol=1e-4)
    head = model.dense_head
    for conv, expected in zip((head.conv_cls, head.conv_box, head.conv_dir_cls), said, strict=True):
        torch.testing.assert_close(conv(ours), expected, atol=1e-4, rtol=1e-4)


def test_every_tensor_of_openpcdet_is_accounted_for(openpcdet):
    state = openpcdet.state_dict()
    _, report = match_tensors(state, network())
    assert set(report.loaded) == set(state) - {"global_step"}
    first = "vfe.pfn_layers.0.linear.weight"
    assert report.loaded[first] == [f"encoders.ego_lidar.{first}", f"encoders.infra_lidar.{first}"]
    assert not any(name.startswith(("backbone_2d.", "dense_head.")) for name in report.fresh)
    _, shared = match_tensors(state, network(SHARE_ENCODERS=True))
    assert shared.loaded[first] == [f"encoders.lidar.{first}"]


def test_batch_statistics_are_not_poured_into_group_norm(openpcdet):
    """The affine parts have equal shapes, so only their kind tells them apart."""
    model = network("group", as_openpcdet=False)
    matched, report = match_tensors(openpcdet.state_dict(), model)
    assert "backbone_2d.blocks.0.1.weight" in matched
    assert "backbone_2d.blocks.0.2.weight" not in matched
    assert {"backbone_2d.blocks.0.2.weight", "vfe.pfn_layers.0.norm.running_mean"} <= set(report.other_norm)
    assert any("MODEL.NORM: batch would take them" in line for line in report.lines())


def test_a_head_for_other_classes_is_named_with_both_shapes_and_left_alone():
    model = network()
    before = model.dense_head.conv_cls.weight.clone()
    matched, report = match_tensors(PointPillar(anchors=6, classes=3).state_dict(), model)
    model.load_state_dict(matched, strict=False)
    assert report.other_shape["dense_head.conv_cls.weight"] == "(18, 32, 1, 1) here (6, 32, 1, 1)"
    assert torch.equal(model.dense_head.conv_cls.weight, before)
    assert "backbone_2d.blocks.0.1.weight" in report.loaded


def test_heights_that_nobody_corrected_are_warned_of(openpcdet, checkpoint, caplog):
    with caplog.at_level(logging.INFO):
        network(as_openpcdet=False).load_params_from_file(checkpoint, LOGGER, to_cpu=True)
    assert "AS_OPENPCDET" in caplog.text
    assert f"loaded {len(openpcdet.state_dict()) - 1} tensors of OpenPCDet's" in caplog.text
    caplog.clear()
    network().load_params_from_file(checkpoint, LOGGER, to_cpu=True)
    assert "AS_OPENPCDET" not in caplog.text


def test_our_own_checkpoints_are_not_taken_for_openpcdets(openpcdet):
    assert is_openpcdet(openpcdet.state_dict())
    assert not is_openpcdet(network().state_dict())


def test_a_detector_that_shares_nothing_is_refused(tmp_path):
    torch.save({"model_state": {"vfe.other.weight": torch.zeros(3)}}, tmp_path / "other.pth")
    with pytest.raises(CheckpointError, match=r"other\.pth: OpenPCDet's, but none of its 1 tensors fits"):
        network().load_params_from_file(tmp_path / "other.pth", LOGGER, to_cpu=True)


def test_openpcdets_view_needs_openpcdets_norm():
    with pytest.raises(ConfigError, match="AS_OPENPCDET: OpenPCDet's weights need NORM batch"):
        network("group")


def test_one_pillar_with_a_zero_row_trains():
    model = network().train()
    vfe = model.encoders["ego_lidar"].vfe
    vfe.encode(torch.tensor([[0.0, 2.0, 0.0, 1.0, 0.5]]), 1)[0].sum().backward()
    assert vfe.pfn_layers[0].linear.weight.grad.isfinite().all()
