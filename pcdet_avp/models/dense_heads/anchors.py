"""Anchors: the same few boxes at every cell of the head's map (PointPillars, section 2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from pcdet_avp.errors import ConfigError, GeometryError
from pcdet_avp.structures.bev_grid import BevGrid


@dataclass(frozen=True)
class AnchorClass:
    """The anchors of one class: every size at every heading, and when one of them counts as a match.

    sizes: dx, dy, dz in metres. headings: radians. bottom_m: height of the underside. matched, unmatched: IoU.
    heading_weight: how much the heading of this class counts in the loss.
    """

    name: str
    sizes: tuple[tuple[float, float, float], ...]
    headings: tuple[float, ...]
    bottom_m: float
    matched: float
    unmatched: float
    align_center: bool = True
    heading_weight: float = 1.0

    def __post_init__(self) -> None:
        if any(len(size) != 3 or min(size) <= 0 for size in self.sizes):
            raise GeometryError(f"anchors of {self.name}: sizes need three positive values, found {self.sizes}")
        if not 0 < self.unmatched <= self.matched <= 1:
            raise ConfigError(
                f"anchors of {self.name}: expected 0 < unmatched_threshold <= matched_threshold <= 1, "
                f"found {self.unmatched} and {self.matched}"
            )

    @classmethod
    def from_config(cls, cfg: Any) -> AnchorClass:
        """From one entry of OpenPCDet's ANCHOR_GENERATOR_CONFIG; ``align_center`` is True here unless it is given."""
        bottoms = list(cfg["anchor_bottom_heights"])
        if len(bottoms) != 1:
            raise ConfigError(f"anchors of {cfg['class_name']}: expected one bottom height, found {bottoms}")
        return cls(
            name=cfg["class_name"],
            sizes=tuple(tuple(float(v) for v in size) for size in cfg["anchor_sizes"]),
            headings=tuple(float(v) for v in cfg["anchor_rotations"]),
            bottom_m=float(bottoms[0]),
            matched=float(cfg["matched_threshold"]),
            unmatched=float(cfg["unmatched_threshold"]),
            align_center=bool(cfg.get("align_center", True)),
            heading_weight=float(cfg.get("heading_weight", 1.0)),
        )

    def boxes(self) -> Tensor:
        """(sizes * headings, 5): z, dx, dy, dz, heading at any cell; sizes vary slower than headings."""
        rows = [(self.bottom_m + s[2] / 2, *s, heading) for s in self.sizes for heading in self.headings]
        return torch.tensor(rows)

    def centres(self, grid: BevGrid, stride: int) -> tuple[Tensor, Tensor]:
        """x (W / stride,) and y (H / stride,) of the anchors' centres, metres.

        They are the centres of the head's cells. With ``align_center`` False they are OpenPCDet's default instead:
        spread from one end of the range to the other, range / (n - 1) apart, which drifts against the cells.
        """
        if grid.width % stride or grid.height % stride:
            raise GeometryError(f"anchors: a grid of {grid.height} x {grid.width} cells does not divide by {stride}")
        rows, cols = grid.height // stride, grid.width // stride
        if not self.align_center:
            return torch.linspace(grid.x_min_m, grid.x_max_m, cols), torch.linspace(grid.y_min_m, grid.y_max_m, rows)
        pitch = grid.cell_m * stride
        x = grid.x_min_m + (torch.arange(cols, dtype=torch.float64) + 0.5) * pitch
        y = grid.y_min_m + (torch.arange(rows, dtype=torch.float64) + 0.5) * pitch
        return x.float(), y.float()


def lay_out(x: Tensor, y: Tensor, boxes: Tensor) -> Tensor:
    """Anchors (H, W, K, 7) from centres x (W,), y (H,) and boxes (K, 5) [z, dx, dy, dz, heading]."""
    H, W, K = len(y), len(x), len(boxes)
    anchors = boxes.new_empty(H, W, K, 7)
    anchors[..., 0], anchors[..., 1] = x.view(1, W, 1), y.view(H, 1, 1)
    anchors[..., 2:] = boxes
    return anchors
