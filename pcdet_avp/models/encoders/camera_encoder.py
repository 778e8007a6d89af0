"""An image to a bird's-eye-view map: features, depth distribution, frustum to BEV, deformable attention (CaDDN)."""

from __future__ import annotations

from typing import Any

from easydict import EasyDict
from torch import Tensor

from pcdet_avp.errors import SensorError
from pcdet_avp.models.backbones_2d import map_to_bev  # noqa: F401  registers
from pcdet_avp.models.backbones_image.depth_bins import DepthBins
from pcdet_avp.models.backbones_image.depth_head import DepthHead, DepthLoss
from pcdet_avp.models.backbones_image.foreground import foreground_mask
from pcdet_avp.models.backbones_image.image_backbone import STRIDE, ImageBackbone
from pcdet_avp.models.encoders.encoder import BevEncoder, present_rows, suffix_of
from pcdet_avp.registry import MAP_TO_BEV
from pcdet_avp.structures.sensor_set import agent_of

IMAGE_KEYS = ("images", "trans_lidar_to_cam", "trans_cam_to_img")


class CameraEncoder(BevEncoder):
    """Sections IMAGE_BACKBONE, DEPTH, MAP_TO_BEV and ATTENTION (may be null).

    DEPTH: MODE, NUM_BINS, RANGE_M (see ``DepthBins.from_config``),
    MID_CHANNELS of the depth head, LOSS (see ``DepthLoss``). Reads, each with the suffix ``_infra`` for the mast:
        images (B, 3, h, w) RGB in [0, 1]; trans_lidar_to_cam (B, 4, 4); trans_cam_to_img (B, 3, 4) in image pixels.
    """

    def __init__(self, model_cfg: Any, channels: int, dataset: Any) -> None:
        """``dataset`` tells point_cloud_range and voxel_size."""
        super().__init__(model_cfg.get("ATTENTION"), channels, dataset)
        depth = model_cfg.DEPTH
        self.bins = {agent: DepthBins.from_config(depth, agent) for agent in ("ego", "infra")}
        self.image_backbone = ImageBackbone(model_cfg.IMAGE_BACKBONE)
        features = self.image_backbone.out_channels
        self.depth_head = DepthHead(features, int(depth.NUM_BINS), int(depth.MID_CHANNELS), depth.get("NORM", "group"))
        self.depth_loss = DepthLoss(depth.get("LOSS", {}))
        to_bev = EasyDict({**model_cfg.MAP_TO_BEV, "NUM_BEV_FEATURES": channels})
        self.map_to_bev_module = MAP_TO_BEV[to_bev.NAME](to_bev, self.grid, features)

    def encode_present(self, batch_dict: dict, source: str, rows: Tensor) -> tuple[Tensor, Tensor, dict]:
        """Also writes depth_logits[source] (R, NUM_BINS + 1, h / 4, w / 4) of the samples ``rows``."""
        images, to_cam, to_img = (batch_dict[key + suffix_of(source)] for key in IMAGE_KEYS)
        if images.dim() != 4 or images.shape[1] != 3:
            raise SensorError(f"images of {source}: expected shape (B, 3, h, w), found {tuple(images.shape)}")
        features = self.image_backbone(images[rows])
        logits = self.depth_head(features)
        image_from_agent = to_img[rows].double() @ to_cam[rows].double()
        bins, size = self.bins[agent_of(source)], tuple(images.shape[2:])
        x, valid = self.map_to_bev_module(features, logits, image_from_agent, bins, size, STRIDE)
        return x, valid, {"depth_logits": {**batch_dict.get("depth_logits", {}), source: logits}}

    def get_loss(self, batch_dict: dict, source: str) -> tuple[Tensor, dict[str, Tensor]]:
        """The depth distribution's loss, summed over the samples that have the camera, over the batch size.

        Args: batch_dict:
            depth_logits[source]; depth_maps (+ _infra) (B, h / 4, w / 4) metres, 0 where unknown; calibration;
            gt_boxes (B, M, 8) and ego_from_infra (B, 4, 4), which tell the pixels on road users
        """
        rows, suffix = present_rows(batch_dict, source), suffix_of(source)
        if not len(rows):
            zero = batch_dict["source_present"].new_zeros(())
            return zero, {f"depth_loss_{agent_of(source)}": zero}
        logits, depth = batch_dict["depth_logits"][source], batch_dict["depth_maps" + suffix][rows]
        if depth.shape[1:] != logits.shape[2:]:
            raise SensorError(
                f"depth map of {source}: expected shape {tuple(logits.shape[2:])}, found {tuple(depth.shape[1:])}; "
                f"DATA_CONFIG.DEPTH_DOWNSAMPLE must be {STRIDE}"
            )
        calibration = (batch_dict[key + suffix][rows] for key in IMAGE_KEYS[1:])
        pose = batch_dict["ego_from_infra"][rows] if suffix else None
        foreground = foreground_mask(depth, *calibration, STRIDE, batch_dict["gt_boxes"][rows], pose)
        loss = self.depth_loss(logits, depth, foreground, self.bins[agent_of(source)])
        loss = loss / int(batch_dict["batch_size"])
        return loss, {f"depth_loss_{agent_of(source)}": loss.detach()}
