"""What a network must know of its data before it can be built: from DATA_CONFIG alone, without any data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from pcdet_avp.config import require
from pcdet_avp.datasets.avp.prepare import PrepareConfig


@dataclass(frozen=True, eq=False)
class NetworkInput:
    """The attributes that OpenPCDet's detectors read from a data set; ``build_network`` takes this in its place."""

    dataset_cfg: Mapping  # DATA_CONFIG
    class_names: list[str]
    prepare_config: PrepareConfig
    point_cloud_range: np.ndarray  # (6,) float32 m: x, y, z minimum, then maximum
    voxel_size: list[float]  # m
    grid_size: np.ndarray  # (3,) int64 cells along x, y, z
    depth_downsample_factor: int
    point_feature_encoder: SimpleNamespace  # num_point_features, used_feature_list

    @classmethod
    def from_config(cls, dataset_cfg: Mapping, class_names: Sequence[str]) -> NetworkInput:
        """The settings that DATA_CONFIG describes."""
        config = PrepareConfig.from_config(dataset_cfg, class_names)
        grid, voxel_size = config.grid, [float(v) for v in require(dataset_cfg, "VOXEL_SIZE")]
        layers = round((grid.z_max_m - grid.z_min_m) / voxel_size[2])
        features = list(require(dataset_cfg, "POINT_FEATURE_ENCODING.used_feature_list", list))
        return cls(
            dataset_cfg,
            list(class_names),
            config,
            np.array(grid.range, np.float32),
            voxel_size,
            np.array([grid.width, grid.height, layers], np.int64),
            config.depth_downsample,
            SimpleNamespace(num_point_features=config.point_features, used_feature_list=features),
        )
