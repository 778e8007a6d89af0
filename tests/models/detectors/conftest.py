"""A tiny network with encoders and a codec of a few lines, so that the detector is tested by itself."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from easydict import EasyDict
from torch import nn

from pcdet_avp.models import build_network
from pcdet_avp.models.detectors import build
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SOURCES

RANGE, VOXEL = [0.0, -6.4, -0.5, 9.6, 6.4, 3.5], [0.4, 0.4, 4.0]
GRID = BevGrid.from_range(RANGE, VOXEL)  # 32 rows x 24 columns
CHANNELS = 4
DATASET = SimpleNamespace(
    class_names=["Car", "Pedestrian"], point_cloud_range=RANGE, voxel_size=VOXEL, grid_size=np.array([24, 32, 1])
)


class PointEncoder(nn.Module):
    """Counts points per cell and lifts the count to CHANNELS."""

    def __init__(self):
        super().__init__()
        self.lift = nn.Conv2d(1, CHANNELS, 3, padding=1, bias=False)

    def forward(self, batch_dict, source):
        points = batch_dict["points_infra" if source.startswith("infra") else "points"]
        count = torch.zeros(batch_dict["batch_size"], 1, GRID.height, GRID.width)
        row, col = GRID.cell_of(points[:, 1:3].numpy())
        index = (points[:, 0].long(), torch.zeros(len(points)).long(), torch.tensor(row), torch.tensor(col))
        count.index_put_(index, torch.ones(len(points)), accumulate=True)
        return store(batch_dict, source, self.lift(count))


class PictureEncoder(nn.Module):
    """A picture of the size of the grid, convolved; its loss pulls the features to the depth map."""

    def __init__(self):
        super().__init__()
        self.lift = nn.Conv2d(3, CHANNELS, 3, padding=1)

    def forward(self, batch_dict, source):
        picture = batch_dict["images_infra" if source.startswith("infra") else "images"]
        return store(batch_dict, source, self.lift(picture))

    def get_loss(self, batch_dict, source):
        loss = 0.01 * batch_dict["bev_maps"][source].square().mean()
        return loss, {f"loss_depth_{source}": loss.detach()}


def store(batch_dict, source, X):
    present = batch_dict["source_present"][:, SOURCES.index(source)].bool().view(-1, 1, 1, 1)
    valid = present.expand(-1, 1, GRID.height, GRID.width)
    maps, masks = {**batch_dict["bev_maps"], source: X}, {**batch_dict["bev_valid"], source: valid}
    return {**batch_dict, "bev_maps": maps, "bev_valid": masks}


class HalfCodec(nn.Module):
    """Compression to half the channels and back, without any loss of cells."""

    def __init__(self):
        super().__init__()
        self.down, self.up = nn.Conv2d(CHANNELS, 2, 1), nn.Conv2d(2, CHANNELS, 1)

    def compress(self, batch_dict):
        roadside = [s for s in batch_dict["bev_maps"] if s.startswith("infra")]
        latents = {s: (self.down(batch_dict["bev_maps"][s]), batch_dict["bev_valid"][s]) for s in roadside}
        return {**batch_dict, "latents": latents}

    def decompress(self, batch_dict):
        maps = {s: X for s, X in batch_dict["bev_maps"].items() if s.startswith("ego")}
        masks = {s: batch_dict["bev_valid"][s] for s in maps}
        for source, (latent, valid) in batch_dict["latents"].items():
            maps[source], masks[source] = self.up(latent), valid
        return {**batch_dict, "bev_maps": maps, "bev_valid": masks}


def model_config(**changes):
    car = dict(class_name="Car", anchor_sizes=[[4.2, 1.9, 1.6]], anchor_rotations=[0, 1.57])
    person = dict(class_name="Pedestrian", anchor_sizes=[[0.55, 0.55, 1.7]], anchor_rotations=[0])
    for anchor, (high, low) in ((car, (0.6, 0.45)), (person, (0.25, 0.15))):
        anchor.update(anchor_bottom_heights=[0.0], matched_threshold=high, unmatched_threshold=low)
    weights = dict(cls_weight=1.0, loc_weight=2.0, dir_weight=0.2, code_weights=[1.0] * 7)
    backbone = dict(NAME="BaseBEVBackbone", LAYER_NUMS=[1, 1], LAYER_STRIDES=[1, 2], NUM_FILTERS=[8, 16])
    backbone |= dict(UPSAMPLE_STRIDES=[1, 2], NUM_UPSAMPLE_FILTERS=[8, 8])
    head = dict(NAME="AnchorHeadSingle", ANCHOR_GENERATOR_CONFIG=[car, person])
    nms = {"NMS_THRESH": 0.1, "NMS_PRE_MAXSIZE": 200, "NMS_POST_MAXSIZE": 50}
    return EasyDict(
        dict(
            NAME="AvpCp",
            NUM_BEV_FEATURES=CHANNELS,
            COMPRESSION={"NAME": "HalfCodec"},
            FUSER={"NAME": "AdaFusion"},
            BACKBONE_2D=backbone,
            DENSE_HEAD=head | {"LOSS_CONFIG": {"LOSS_WEIGHTS": weights}},
            POST_PROCESSING={"SCORE_THRESH": 0.009, "NMS_CONFIG": nms, "RECALL_THRESH_LIST": [0.3]},
        )
        | changes
    )


@pytest.fixture
def tiny(monkeypatch, select):
    """The helpers of this file; encoders and codec of this file stand in for the real ones."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # the tensors are so small that threads only wait for each other
    encoders = {"lidar": PointEncoder, "camera": PictureEncoder}
    monkeypatch.setattr(build, "build_encoder", lambda modality, *_: encoders[modality]())
    monkeypatch.setattr(build, "build_codec", lambda *_: HalfCodec())

    def network(seed=0, **changes):
        torch.manual_seed(seed)
        return build_network(model_config(**changes), 2, DATASET)

    yield SimpleNamespace(network=network, config=model_config, batch=make_batch, select=select, dataset=DATASET)
    torch.set_num_threads(threads)


def make_batch(combos, seed=0):
    """One sample per combination name, as tensors."""
    generator = torch.Generator().manual_seed(seed)
    masks = [SENSOR_SETS[name].mask for name in combos]
    B = len(combos)
    batch = {
        "batch_size": B,
        "frame_id": np.array([f"0000/{i:03d}" for i in range(B)]),
        "source_present": torch.tensor(masks, dtype=torch.float32),
        "ego_from_infra": torch.tensor(np.stack([pose_of(i) for i in range(B)]), dtype=torch.float32),
        "gt_boxes": torch.tensor([[[5.0, 1.0, 0.8, 4.3, 1.9, 1.6, 0.2, 1], [7.0, -3, 0.9, 0.4, 0.4, 1.8, 0, 2]]] * B),
    }
    for suffix, camera, lidar in (("", 0, 1), ("_infra", 2, 3)):
        pictures = torch.rand(B, 3, GRID.height, GRID.width, generator=generator)
        batch[f"images{suffix}"] = pictures * batch["source_present"][:, camera].view(-1, 1, 1, 1)
        xyz = torch.rand(B, 60, 4, generator=generator) * torch.tensor([9.6, 12.8, 2, 1]) - torch.tensor([0, 6.4, 0, 0])
        number = torch.arange(B).view(-1, 1, 1).expand(-1, 60, 1)
        points = torch.cat([number, xyz], 2)[batch["source_present"][:, lidar].bool()]
        batch[f"points{suffix}"] = points.reshape(-1, 5)
    return batch


def pose_of(i):
    return Pose.from_xyz_yaw(9.0 + 0.3 * i, 0.4 * i, yaw=3.0).matrix
