"""An image to a bird's-eye-view map: features, depth distribution, frustum to BEV, deformable attention (CaDDN)."""

from __future__ import annotations

from typing import Any

from easydict import EasyDict
from torch import Tensor

from pcdet_avp.models.backbones_2d import map_to_bev  # noqa: F401  registers
from pcdet_avp.models.backbones_image.image_backbone import STRIDE
from pcdet_avp.models.encoders.depth_branch import IMAGE_KEYS, DepthBranch, below_crop
from pcdet_avp.models.encoders.encoder import BevEncoder, suffix_of
from pcdet_avp.registry import MAP_TO_BEV
from pcdet_avp.structures.sensor_set import agent_of


class CameraEncoder(DepthBranch, BevEncoder):
    """Sections IMAGE_BACKBONE, DEPTH and CROP_TOP_PX (see ``DepthBranch``), MAP_TO_BEV and ATTENTION (may be null)."""

    def __init__(self, model_cfg: Any, channels: int, dataset: Any) -> None:
        """``dataset`` tells point_cloud_range and voxel_size."""
        super().__init__(model_cfg.get("ATTENTION"), channels, dataset)
        self.add_depth_branch(model_cfg)
        to_bev = EasyDict({**model_cfg.MAP_TO_BEV, "NUM_BEV_FEATURES": channels})
        features = self.image_backbone.out_channels
        self.map_to_bev_module = MAP_TO_BEV[to_bev.NAME](to_bev, self.grid, features)

    def encode_present(self, batch_dict: dict, source: str, rows: Tensor) -> tuple[Tensor, Tensor, dict]:
        """Also writes depth_logits[source] (R, NUM_BINS + 1, h / 4, w / 4) of the samples ``rows``."""
        features, logits = self.features_and_logits(batch_dict, source, rows)
        images, to_cam, to_img = (batch_dict[key + suffix_of(source)] for key in IMAGE_KEYS)
        crop_px = self.crop_px[agent_of(source)]
        image_from_agent = below_crop(to_img[rows].double(), crop_px) @ to_cam[rows].double()
        bins, size = self.bins[agent_of(source)], (images.shape[2] - crop_px, images.shape[3])
        x, valid = self.map_to_bev_module(features, logits, image_from_agent, bins, size, STRIDE)
        return x, valid, {"depth_logits": {**batch_dict.get("depth_logits", {}), source: logits}}
