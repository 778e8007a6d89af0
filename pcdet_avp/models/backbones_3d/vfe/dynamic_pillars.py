"""Pillar features of a point cloud (PointPillars, section 2.1) without fixed-size buffers: no point is dropped."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.backbones_3d.vfe import pillar_kernel
from pcdet_avp.models.backbones_3d.vfe.openpcdet_pillars import OpenPCDetPillars
from pcdet_avp.models.backbones_3d.vfe.segment_max import segment_max
from pcdet_avp.models.norm import BATCH_NORM
from pcdet_avp.registry import VFE
from pcdet_avp.structures.bev_grid import BevGrid


@VFE.register("DynamicPillars")
class DynamicPillars(nn.Module):
    """Points -> one feature vector per occupied pillar.

    A point is decorated with its offset to the mean of its pillar's points and to the pillar's centre, then goes
    through linear layers (no bias), a normalisation and ReLU; the maximum over a pillar's points is its feature.
    Points outside the grid's range are ignored. NORM ``batch`` has OpenPCDet's weight names, shapes and raw inputs.
    NORM ``group`` normalises each point over its channels (group norm of one group) and first brings positions and
    offsets to the order of one: without statistics over points, 40 m of range would drown 0.1 m of shape.
    AS_OPENPCDET, a section for weights from there, shows them what they were trained with (see ``OpenPCDetPillars``).

    Reads: points (P, 1 + C) [batch index, x, y, z, further channels], batch_size.
    Writes: pillar_features (N, NUM_FILTERS[-1]), voxel_coords (N, 4) int64 [batch index, 0, row, column].
    """

    def __init__(
        self,
        model_cfg: Any,
        num_point_features: int,
        voxel_size: Any,
        point_cloud_range: Any,
        grid_size: Any = None,
        depth_downsample_factor: int | None = None,
    ) -> None:
        """The arguments of OpenPCDet's VFE constructor; the last two are implied by the others and not used."""
        super().__init__()
        if model_cfg.get("NORM", "group") not in ("group", "batch"):
            raise ConfigError(f"VFE.NORM: expected group or batch, found {model_cfg.NORM!r}")
        self.grid = BevGrid.from_range(point_cloud_range, voxel_size)
        self.absolute = bool(model_cfg.get("USE_ABSLOTE_XYZ", True))  # OpenPCDet's spelling
        self.batch_norm = model_cfg.get("NORM", "group") == "batch"
        self.as_openpcdet = OpenPCDetPillars.from_config(model_cfg.get("AS_OPENPCDET"))
        if self.as_openpcdet and not self.batch_norm:
            raise ConfigError("VFE.AS_OPENPCDET: OpenPCDet's weights need NORM batch, found group")
        inputs = num_point_features + 6 if self.absolute else num_point_features + 3
        filters = [inputs, *(int(n) for n in model_cfg.NUM_FILTERS)]
        self.pfn_layers = nn.ModuleList(
            PillarLayer(filters[i], filters[i + 1], self.batch_norm, last=i == len(filters) - 2)
            for i in range(len(filters) - 1)
        )

    def get_output_feature_dim(self) -> int:
        """Channels of pillar_features; OpenPCDet asks its VFE for them."""
        return self.pfn_layers[-1].linear.out_features

    def forward(self, batch_dict: dict) -> dict:
        """points (P, 1 + C) in metres, batch_size -> adds pillar_features (N, F) and voxel_coords (N, 4) int64."""
        features, coords = self.encode(batch_dict["points"], int(batch_dict["batch_size"]))
        batch_dict["pillar_features"], batch_dict["voxel_coords"] = features, coords
        return batch_dict

    def encode(self, points: Tensor, batch_size: int) -> tuple[Tensor, Tensor]:
        """points (P, 1 + C) -> pillar features (N, F), coordinates (N, 4) as in ``voxel_coords``."""
        if pillar_kernel.fits(self, points):
            return pillar_kernel.encode(self, points, batch_size)
        points = self._in_range(points)
        pillar_ids, cells = self._pillars(points, batch_size)
        x = self._decorate(points, pillar_ids, cells)
        if self.as_openpcdet:
            x, pillar_ids = self.as_openpcdet.fill(x, pillar_ids, len(cells))
        for layer in self.pfn_layers:
            x = layer(x, pillar_ids, len(cells))
        batch, cell = cells // self._cells, cells % self._cells
        width = self.grid.width
        return x, torch.stack([batch, torch.zeros_like(cell), cell // width, cell % width], 1)

    @property
    def _cells(self) -> int:
        return self.grid.height * self.grid.width

    def _in_range(self, points: Tensor) -> Tensor:
        if not torch.isfinite(points).all():
            pillar_kernel.check_finite(int((~torch.isfinite(points)).any(1).sum()), len(points))
        low, high = points.new_tensor(self.grid.range).split(3)
        xyz = points[:, 1:4]
        return points[((xyz >= low) & (xyz < high)).all(1)]

    def _pillars(self, points: Tensor, batch_size: int) -> tuple[Tensor, Tensor]:
        """Index (P,) of each point's pillar among the occupied ones, and those pillars' cells (N,), ascending.

        A cell is (batch index * H + row) * W + column. Counting beats sorting (``torch.unique``) 3:7 at 150k points.
        """
        grid = self.grid
        col = ((points[:, 1] - grid.x_min_m) / grid.cell_m).long().clamp_(0, grid.width - 1)
        row = ((points[:, 2] - grid.y_min_m) / grid.cell_m).long().clamp_(0, grid.height - 1)
        cell = points[:, 0].long() * self._cells + row * grid.width + col
        occupied = torch.bincount(cell, minlength=batch_size * self._cells) > 0
        return (occupied.cumsum(0) - 1)[cell], occupied.nonzero().squeeze(1)

    def _decorate(self, points: Tensor, pillar_ids: Tensor, cells: Tensor) -> Tensor:
        """Channels of each point, then offset to the mean and to the centre of its pillar: (P, C + 6).

        Without absolute positions x, y, z are left out: (P, C + 3).
        """
        xyz = points[:, 1:4]
        to_mean = xyz - _means(xyz, pillar_ids, len(cells)).index_select(0, pillar_ids)
        to_centre = xyz - self._centres(cells, xyz.dtype).index_select(0, pillar_ids)
        rest = points[:, 4:]
        if self.as_openpcdet:
            xyz = self.as_openpcdet.from_lidar(xyz)
        if not self.batch_norm:
            grid, cell = self.grid, self.grid.cell_m
            low, high = xyz.new_tensor(grid.range).split(3)
            size = xyz.new_tensor([cell, cell, grid.z_max_m - grid.z_min_m]) / 2
            xyz = (xyz - (low + high) / 2) / ((high - low) / 2)
            to_mean, to_centre = to_mean / size, to_centre / size
        position = [xyz] if self.absolute else []
        return torch.cat([*position, rest, to_mean, to_centre], 1)

    def _centres(self, cells: Tensor, dtype: torch.dtype) -> Tensor:
        """(N, 3) metres."""
        grid, cell = self.grid, cells % self._cells
        x = grid.x_min_m + (cell % grid.width + 0.5) * grid.cell_m
        y = grid.y_min_m + (cell // grid.width + 0.5) * grid.cell_m
        z = torch.full_like(x, self.as_openpcdet.centre_z_m if self.as_openpcdet else (grid.z_min_m + grid.z_max_m) / 2)
        return torch.stack([x, y, z], 1).to(dtype)


class PillarLayer(nn.Module):
    """Linear (no bias), norm, ReLU, maximum over the pillar; before the last layer, each point keeps half of the
    channels for itself and gets its pillar's maximum as the other half. Weight names are OpenPCDet's."""

    def __init__(self, inputs: int, outputs: int, batch_norm: bool, last: bool) -> None:
        super().__init__()
        self.last = last
        outputs = outputs if last else outputs // 2
        self.linear = nn.Linear(inputs, outputs, bias=False)
        self.norm = nn.BatchNorm1d(outputs, **BATCH_NORM) if batch_norm else nn.LayerNorm(outputs)

    def forward(self, x: Tensor, pillar_ids: Tensor, pillars: int) -> Tensor:
        """x (P, inputs), pillar_ids (P,) -> (pillars, outputs), or (P, outputs) before the last layer."""
        # As a product with a matrix that lies in memory as it is read: for the one of ``nn.Linear`` torch computes the
        # gradient the other way round, which takes ten times as long where points are many and channels few.
        x = self._normalise(x @ self.linear.weight.T.contiguous())
        if self.last:
            return F.relu(segment_max(x, pillar_ids, pillars))  # ReLU is monotone: after the maximum it costs less
        x = F.relu(x)
        return torch.cat([x, segment_max(x, pillar_ids, pillars).index_select(0, pillar_ids)], 1)

    def _normalise(self, x: Tensor) -> Tensor:
        if isinstance(self.norm, nn.BatchNorm1d) and len(x) < 2:  # no statistics to take from fewer than two points
            norm = self.norm
            return F.batch_norm(x, norm.running_mean, norm.running_var, norm.weight, norm.bias, eps=norm.eps)
        return self.norm(x)


def _means(x: Tensor, pillar_ids: Tensor, segments: int) -> Tensor:
    """Mean of the rows (P, C) of each segment: (segments, C)."""
    total = x.new_zeros(segments, x.shape[1]).index_add_(0, pillar_ids, x)
    return total / torch.bincount(pillar_ids, minlength=segments)[:, None]
