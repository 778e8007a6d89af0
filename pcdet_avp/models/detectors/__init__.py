"""Whole networks; importing this package registers them and every stage they may name."""

from pcdet_avp.models import compression, fusion
from pcdet_avp.models.backbones_2d import base_bev_backbone
from pcdet_avp.models.dense_heads import anchor_head
from pcdet_avp.models.detectors.avp_cp import AvpCp
from pcdet_avp.models.detectors.camera_depth import CameraDepth

__all__ = ["AvpCp", "CameraDepth", "anchor_head", "base_bev_backbone", "compression", "fusion"]
