"""The modules of ``AvpCp`` from its configuration, each told the sizes that follow from the one before it."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

from easydict import EasyDict
from torch import nn

from pcdet_avp.config import require
from pcdet_avp.models.encoders.camera_encoder import CameraEncoder
from pcdet_avp.models.encoders.lidar_encoder import LidarEncoder
from pcdet_avp.models.fusion.warp import WarpToEgo
from pcdet_avp.registry import BACKBONES_2D, COMPRESSION, DENSE_HEADS, FUSERS
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.sensor_set import SOURCES

NORMALISED = (
    ("CAMERA_ENCODER", "IMAGE_BACKBONE"),
    ("CAMERA_ENCODER", "DEPTH"),
    ("LIDAR_ENCODER", "VFE"),
    ("BACKBONE_2D",),
)


def build_modules(model_cfg: Any, num_class: int, dataset: Any) -> dict[str, nn.Module]:
    """Names and modules in the order of the data's way through the network."""
    cfg = with_norm(model_cfg)
    grid = BevGrid.from_range(dataset.point_cloud_range, dataset.voxel_size)
    channels = int(require(cfg, "NUM_BEV_FEATURES", int))
    backbone = named(BACKBONES_2D, cfg, "BACKBONE_2D")(cfg.BACKBONE_2D, channels)
    head = named(DENSE_HEADS, cfg, "DENSE_HEAD")(
        head_config(cfg.DENSE_HEAD, backbone.output_stride),
        input_channels=backbone.num_bev_features,
        num_class=num_class,
        class_names=dataset.class_names,
        grid_size=[grid.width, grid.height, 1],
        point_cloud_range=dataset.point_cloud_range,
    )
    return {
        "encoders": build_encoders(cfg, channels, dataset),
        "codec": build_codec(cfg, channels, grid),
        "warp": WarpToEgo(grid),
        "fuser": named(FUSERS, cfg, "FUSER")(cfg.FUSER),
        "backbone_2d": backbone,
        "dense_head": head,
    }


def named(registry: Mapping[str, type], cfg: Any, section: str) -> type:
    """The class that a section of the configuration names."""
    return registry[require(cfg, f"{section}.NAME", str)]


def with_norm(model_cfg: Any) -> EasyDict:
    """A copy in which the sections that normalise have MODEL.NORM (default ``group``) unless they have their own."""
    cfg = EasyDict(copy.deepcopy(dict(model_cfg)))
    for path in NORMALISED:
        section = cfg
        for key in path:
            section = section.get(key, {})
        section["NORM"] = section.get("NORM", cfg.get("NORM", "group"))
    return cfg


def head_config(cfg: Any, stride: int) -> EasyDict:
    """A copy in which anchors without a ``feature_map_stride`` have the backbone's."""
    anchors = [{"feature_map_stride": stride, **anchor} for anchor in cfg["ANCHOR_GENERATOR_CONFIG"]]
    return EasyDict({**cfg, "ANCHOR_GENERATOR_CONFIG": anchors})


def build_encoders(cfg: Any, channels: int, dataset: Any) -> nn.ModuleDict:
    """One encoder per source, or one per modality where SHARE_ENCODERS is True."""
    names = ("camera", "lidar") if cfg.get("SHARE_ENCODERS", False) else SOURCES
    return nn.ModuleDict({name: build_encoder(name.split("_")[-1], cfg, channels, dataset) for name in names})


def build_encoder(modality: str, cfg: Any, channels: int, dataset: Any) -> nn.Module:
    """An encoder ``(batch_dict, source) -> batch_dict`` of a modality, camera or lidar."""
    if modality == "camera":
        return CameraEncoder(require(cfg, "CAMERA_ENCODER", dict), channels, dataset)
    return LidarEncoder(require(cfg, "LIDAR_ENCODER", dict), channels, dataset)


def build_codec(cfg: Any, channels: int, grid: BevGrid) -> nn.Module:
    """The trained half of the compression; ConfigError where no map of this grid fits its limit on bytes."""
    codec = named(COMPRESSION, cfg, "COMPRESSION")(cfg.COMPRESSION, channels)
    codec.check_size(grid.height, grid.width)
    return codec
