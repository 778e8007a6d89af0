"""PointPillars' backbone with one of our stages before it, for detectors that have no place of their own for it.

OpenPCDet's base detector reaches BACKBONE_2D, so these bring the stages into its PointPillar and SECONDNet. The
backbone's weights keep OpenPCDet's names, so that a trained one is found again.
"""

from __future__ import annotations

from typing import Any

from torch import Tensor

from pcdet_avp.models.backbones_2d.base_bev_backbone import BaseBEVBackbone
from pcdet_avp.models.backbones_2d.deformable_bev_attention import DeformableBevAttention
from pcdet_avp.models.compression.map_codec import MapCodec
from pcdet_avp.registry import BACKBONES_2D

OPENPCDET_NORM = {"NORM": "batch"}  # unless the section says otherwise


@BACKBONES_2D.register("DeformableAttentionBackbone")
class DeformableAttentionBackbone(BaseBEVBackbone):
    """``BaseBEVBackbone`` with deformable self-attention before it.

    Keys: ATTENTION (see ``DeformableBevAttention``) and those of ``BaseBEVBackbone``; NORM is ``batch`` by default.
    The attention's residual branches start at zero: with a trained backbone's weights it starts as that backbone.
    """

    def __init__(self, model_cfg: Any, input_channels: int) -> None:
        super().__init__({**OPENPCDET_NORM, **model_cfg}, input_channels)
        self.attention = DeformableBevAttention(model_cfg.get("ATTENTION") or {}, input_channels)

    def encode(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, num_bev_features, H', W')."""
        everywhere = x.new_ones(len(x), 1, *x.shape[2:]).bool()
        return super().encode(self.attention(x, everywhere))


@BACKBONES_2D.register("CompressedBackbone")
class CompressedBackbone(BaseBEVBackbone):
    """``BaseBEVBackbone`` behind a map that went over the air: reduced, pooled, sparsified, rounded, and restored.

    Keys: COMPRESSION (see ``MapCodec``) and those of ``BaseBEVBackbone``; NORM is ``batch`` by default. The share of
    cells is fixed (THRESHOLD rate), since OpenPCDet asks no backbone for a loss.
    """

    def __init__(self, model_cfg: Any, input_channels: int) -> None:
        super().__init__({**OPENPCDET_NORM, **model_cfg}, input_channels)
        self.codec = MapCodec({**(model_cfg.get("COMPRESSION") or {}), "THRESHOLD": "rate"}, input_channels)

    def encode(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, num_bev_features, H', W')."""
        latent, _ = self.codec.compress(x)
        return super().encode(self.codec.decompress(latent))
