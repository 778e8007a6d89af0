"""The categorical depth distribution of every feature pixel (CaDDN, section 3.2)."""

from __future__ import annotations

from torch import Tensor, nn

from pcdet_avp.models.norm import make_norm, norm_relu
from pcdet_avp.models.pointwise import PointwiseConv2d


class DepthHead(nn.Module):
    """Features (B, C, h, w) -> logits (B, NUM_BINS + 1, h, w); the last class is every depth outside the bins."""

    def __init__(self, in_channels: int, num_bins: int, mid_channels: int, norm: str) -> None:
        super().__init__()
        self.conv = nn.Conv2d(in_channels, mid_channels, 3, padding=1, bias=False)
        self.norm = make_norm(norm, mid_channels)
        self.classify = PointwiseConv2d(mid_channels, num_bins + 1, cells_last=True)

    def forward(self, features: Tensor) -> Tensor:
        """features (B, C, h, w) -> logits (B, NUM_BINS + 1, h, w)."""
        return self.classify(norm_relu(self.norm, self.conv(features)))
