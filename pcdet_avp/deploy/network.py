"""What the graphs of an exported network leave open: grid, cameras, pillars, anchors, the map on the air.

All values are plain, so that they travel as JSON in ``manifest.json``. Metres, radians, pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from pcdet_avp.link.map_size import UNLIMITED, MapSize
from pcdet_avp.structures.bev_grid import BevGrid


@dataclass(frozen=True)
class DepthBinning:
    """``count`` bins between near and far along the optical axis; ``mode`` as in ``DepthBins``."""

    mode: str
    count: int
    near_m: float
    far_m: float


@dataclass(frozen=True)
class CameraInput:
    """How an agent's image is read: rows cut off at the top, image pixels per feature pixel, voxels over a cell."""

    crop_px: int
    stride: int
    heights: int
    sampling: str
    bins: DepthBinning


@dataclass(frozen=True)
class PillarInput:
    """How points are decorated (see ``pillars``), and how many ``points_<i>`` graphs follow one another.

    ``absolute``: positions come first. ``scaled``: positions and offsets are of the order of one. ``lidar_height_m``:
    height that positions count from. ``centre_z_m``: of every pillar. ``max_points``: a pillar of fewer points also
    holds a row of zeros; 0: none does.
    """

    layers: int
    absolute: bool
    scaled: bool
    lidar_height_m: float
    centre_z_m: float
    max_points: int


@dataclass(frozen=True)
class AnchorSet:
    """The anchors of one class at a cell, (z, dx, dy, dz, heading) each, and where the cells' centres lie."""

    boxes: tuple[tuple[float, ...], ...]
    align_center: bool


@dataclass(frozen=True)
class Head:
    """Anchors by class in the order of the labels, cells of the grid per cell of the head, direction bins (0: none)."""

    anchors: tuple[AnchorSet, ...]
    stride: int
    direction_bins: int
    direction_offset: float


@dataclass(frozen=True)
class Suppression:
    """Score from which on a box counts and largest overlap with a better one, both by class; boxes in and out; by class
    the overlap from which on the others vote on where a box stands (0 or empty: none does)."""

    min_scores: tuple[float, ...]
    max_overlaps: tuple[float, ...]
    pre_max: int
    post_max: int
    vote_overlaps: tuple[float, ...] = ()


@dataclass(frozen=True)
class Network:
    """``latent_shape`` (c, h, w) and ``latent_precision`` are those of a map on the air, ``pooling`` its coarsening,
    ``map_size`` the limit on its bytes."""

    class_names: tuple[str, ...]
    point_cloud_range: tuple[float, ...]
    cell_m: float
    channels: int
    latent_shape: tuple[int, int, int]
    latent_precision: dict[str, str]
    pooling: int
    cameras: dict[str, CameraInput]
    pillars: PillarInput
    head: Head
    suppression: Suppression
    map_size: MapSize = UNLIMITED

    @property
    def grid(self) -> BevGrid:
        x_min, y_min, z_min, x_max, y_max, z_max = self.point_cloud_range
        return BevGrid(x_min, y_min, z_min, x_max, y_max, z_max, self.cell_m)

    def as_json(self) -> dict[str, Any]:
        """Plain values by name."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Network:
        """The inverse of ``as_json``; KeyError or TypeError where something is missing or unknown."""
        cameras = {
            agent: CameraInput(**{**camera, "bins": DepthBinning(**camera["bins"])})
            for agent, camera in content["cameras"].items()
        }
        head, suppression = dict(content["head"]), content["suppression"]
        head["anchors"] = tuple(
            AnchorSet(tuple(map(tuple, one["boxes"])), bool(one["align_center"])) for one in head["anchors"]
        )
        made = {
            "class_names": tuple(content["class_names"]),
            "point_cloud_range": tuple(content["point_cloud_range"]),
            "latent_shape": tuple(content["latent_shape"]),
            "cameras": cameras,
            "pillars": PillarInput(**content["pillars"]),
            "head": Head(**head),
            "suppression": Suppression(
                tuple(suppression["min_scores"]),
                tuple(suppression["max_overlaps"]),
                suppression["pre_max"],
                suppression["post_max"],
                tuple(suppression.get("vote_overlaps", ())),  # not in exports of before there was a vote
            ),
            "map_size": MapSize(**content.get("map_size", {})),  # not in exports of before there was a limit
        }
        return cls(**{**content, **made})
