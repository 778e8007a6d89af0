"""What every camera encoder begins with: image features, the depth distribution of each feature pixel, and its loss."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from pcdet_avp.errors import ConfigError, SensorError
from pcdet_avp.models.backbones_image.depth_bins import DepthBins
from pcdet_avp.models.backbones_image.depth_head import DepthHead
from pcdet_avp.models.backbones_image.depth_loss import DepthLoss
from pcdet_avp.models.backbones_image.foreground import foreground_mask
from pcdet_avp.models.backbones_image.image_backbone import STRIDE, ImageBackbone
from pcdet_avp.models.encoders.encoder import present_rows, suffix_of
from pcdet_avp.models.precision import convolutions, full_precision
from pcdet_avp.structures.sensor_set import agent_of

IMAGE_KEYS = ("images", "trans_lidar_to_cam", "trans_cam_to_img")


class DepthBranch(nn.Module):
    """The modules ``image_backbone`` and ``depth_head``, which a subclass adds by ``add_depth_branch``.

    DEPTH: MODE, NUM_BINS, RANGE_M (see ``DepthBins.from_config``), MID_CHANNELS of the depth head, LOSS (see
    ``DepthLoss``). CROP_TOP_PX: {ego, infra} (default 0): so many rows of image pixels are cut off at the top, where
    no road user can be; feature maps have their rows fewer. Reads, each with the suffix ``_infra`` for the mast:
        images (B, 3, h, w) RGB in [0, 1]; trans_lidar_to_cam (B, 4, 4); trans_cam_to_img (B, 3, 4) in image pixels.
    """

    def add_depth_branch(self, model_cfg: Any) -> None:
        """The branch that the sections IMAGE_BACKBONE and DEPTH, and CROP_TOP_PX, describe."""
        depth = model_cfg.DEPTH
        self.crop_px = _crops(model_cfg.get("CROP_TOP_PX") or {})
        self.bins = {agent: DepthBins.from_config(depth, agent) for agent in ("ego", "infra")}
        self.image_backbone = ImageBackbone(model_cfg.IMAGE_BACKBONE)
        features = self.image_backbone.out_channels
        self.depth_head = DepthHead(features, int(depth.NUM_BINS), int(depth.MID_CHANNELS), depth.get("NORM", "group"))
        self.depth_loss = DepthLoss(depth.get("LOSS") or {})

    def features_and_logits(self, batch_dict: dict, source: str, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Features (R, C, h / 4, w / 4) and depth logits (R, NUM_BINS + 1, h / 4, w / 4) of the samples ``rows``;
        h is what the crop leaves of an image's height."""
        images = batch_dict["images" + suffix_of(source)]
        if images.dim() != 4 or images.shape[1] != 3:
            raise SensorError(f"images of {source}: expected shape (B, 3, h, w), found {tuple(images.shape)}")
        images = images if len(rows) == len(images) else images[rows]
        with convolutions():
            features = self.image_backbone(images[:, :, self.crop_px[agent_of(source)] :])
            logits = self.depth_head(features)
        return (features, logits) if torch.is_grad_enabled() else (full_precision(features), full_precision(logits))

    def get_loss(self, batch_dict: dict, source: str) -> tuple[Tensor, dict[str, Tensor]]:
        """The depth distribution's loss, summed over the samples that have the camera, over the batch size.

        Args: batch_dict:
            depth_logits[source]; depth_maps (+ _infra) (B, h / 4, w / 4) metres, 0 where unknown; calibration;
            gt_boxes (B, M, 8) and ego_from_infra (B, 4, 4), which tell the pixels on road users
        """
        rows, name = present_rows(batch_dict, source), f"depth_loss_{agent_of(source)}"
        if not len(rows):
            zero = batch_dict["source_present"].new_zeros(())
            return zero, {name: zero}
        logits = batch_dict["depth_logits"][source]
        crop_px = self.crop_px[agent_of(source)]
        depth, foreground = depth_truth(batch_dict, source, rows, tuple(logits.shape[2:]), crop_px)
        loss = self.depth_loss(logits, depth, foreground, self.bins[agent_of(source)])
        loss = loss / int(batch_dict["batch_size"])
        return loss, {name: loss.detach()}


def depth_truth(
    batch_dict: dict, source: str, rows: Tensor, size: tuple[int, int], crop_px: int = 0
) -> tuple[Tensor, Tensor]:
    """True depths (R, *size) metres of the samples ``rows``, and which pixels show a road user, bool.

    ``crop_px`` rows of image pixels are cut off at the top.
    """
    suffix = suffix_of(source)
    depth = batch_dict["depth_maps" + suffix][rows, crop_px // STRIDE :]
    if tuple(depth.shape[1:]) != size:
        raise SensorError(
            f"depth map of {source}: expected shape {size}, found {tuple(depth.shape[1:])}; "
            f"DATA_CONFIG.DEPTH_DOWNSAMPLE must be {STRIDE}"
        )
    to_cam, to_img = (batch_dict[key + suffix][rows] for key in IMAGE_KEYS[1:])
    pose = batch_dict["ego_from_infra"][rows] if suffix else None
    return depth, foreground_mask(
        depth, to_cam, below_crop(to_img, crop_px), STRIDE, batch_dict["gt_boxes"][rows], pose
    )


def below_crop(to_img: Tensor, crop_px: int) -> Tensor:
    """The projection (B, 3, 4) onto an image without its first ``crop_px`` rows: row v becomes row v - crop_px."""
    lower = to_img.clone()
    lower[:, 1] -= crop_px * to_img[:, 2]
    return lower


def _crops(cfg: Any) -> dict[str, int]:
    crops = {"ego": 0, "infra": 0} | dict(cfg)
    for agent, rows in crops.items():
        if agent not in ("ego", "infra"):
            raise ConfigError(f"CAMERA_ENCODER.CROP_TOP_PX: unknown key {agent!r}; known: ego, infra")
        if not isinstance(rows, int) or rows < 0 or rows % STRIDE:
            raise ConfigError(
                f"CAMERA_ENCODER.CROP_TOP_PX.{agent}: expected a multiple of {STRIDE} image rows, found {rows!r}"
            )
    return crops
