"""Conversion of a ``Frame`` to the network's input, shared by data set and closed loop; no torch, no simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numba
import numpy as np

from pcdet_avp.config import require
from pcdet_avp.errors import ConfigError, RecordError, SensorError
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.frame import CLASS_NAMES, AgentView, Frame, Labels
from pcdet_avp.structures.sensor_set import SensorSet

POINT_FEATURES = ("x", "y", "z", "intensity")
SUFFIXES = {"ego": "", "infra": "_infra"}  # of an agent's keys in a sample


@dataclass(frozen=True)
class PrepareConfig:
    """What a sample looks like: ``image_shape`` is (rows, columns), ``point_features`` the columns of a point."""

    grid: BevGrid
    image_shape: tuple[int, int]
    depth_downsample: int = 4
    class_names: tuple[str, ...] = CLASS_NAMES
    point_features: int = len(POINT_FEATURES)

    @classmethod
    def from_config(cls, dataset_cfg: Mapping, class_names: Sequence[str]) -> PrepareConfig:
        """The settings that DATA_CONFIG describes."""
        grid = BevGrid.from_range(require(dataset_cfg, "POINT_CLOUD_RANGE"), require(dataset_cfg, "VOXEL_SIZE"))
        shape = tuple(require(dataset_cfg, "IMAGE_SHAPE", list))
        if len(shape) != 2 or not all(isinstance(n, int) and n > 0 for n in shape):
            raise ConfigError(f"DATA_CONFIG.IMAGE_SHAPE: expected [rows, columns], found {list(shape)}")
        factor = require(dataset_cfg, "DEPTH_DOWNSAMPLE", int)
        if factor < 1:
            raise ConfigError(f"DATA_CONFIG.DEPTH_DOWNSAMPLE: expected 1 or more, found {factor}")
        features = _point_features(require(dataset_cfg, "POINT_FEATURE_ENCODING.used_feature_list", list))
        return cls(grid, shape, factor, _class_names(class_names), features)

    @property
    def depth_shape(self) -> tuple[int, int]:
        """Rows and columns of a depth map; the last ones may cover fewer image pixels than the others."""
        rows, columns = self.image_shape
        return -(-rows // self.depth_downsample), -(-columns // self.depth_downsample)


def _point_features(used: list[str]) -> int:
    if tuple(used) not in (POINT_FEATURES, POINT_FEATURES[:3]):
        raise ConfigError(
            f"POINT_FEATURE_ENCODING.used_feature_list: expected {list(POINT_FEATURES)}, "
            f"with or without the last, found {used}"
        )
    return len(used)


def _class_names(names: Sequence[str]) -> tuple[str, ...]:
    unknown = [name for name in names if name not in CLASS_NAMES]
    if unknown or len(set(names)) != len(names) or not names:
        raise ConfigError(f"CLASS_NAMES: expected different ones of {', '.join(CLASS_NAMES)}, found {list(names)}")
    return tuple(names)


def prepare(frame: Frame, sensor_set: SensorSet, config: PrepareConfig) -> dict:
    """One sample, all arrays float32 unless said otherwise. h, w: image rows and columns; f: depth_downsample.

    frame_id str; source_present (4,) bool; image_shape (2,) int32; ego_from_infra (4, 4); gt_boxes (M, 8).
    For the ego, and with the suffix ``_infra`` for the roadside:
    points (P, 4 or 3) in the agent's frame and inside its BEV range, no rows where absent;
    images (h, w, 3) RGB in [0, 1] and depth_maps (ceil(h/f), ceil(w/f)) metres, 0 = unknown: zeros where absent;
    trans_lidar_to_cam (4, 4) agent frame to camera frame, trans_cam_to_img (3, 4) camera frame to pixels.
    A sensor that the set names and the frame lacks is absent. Without any sensor there is no sample: SensorError.
    """
    ego, infra = _restrict(frame.ego, *sensor_set.mask[:2]), _restrict(frame.infra, *sensor_set.mask[2:])
    present = np.array([view is not None for a in (ego, infra) for view in (a.image, a.points)])
    if not present.any():
        raise SensorError(f"frame {frame.frame_id}: none of the sensors asked for {sensor_set.mask} is in it")
    return {
        "frame_id": frame.frame_id,
        "source_present": present,
        "image_shape": np.array(config.image_shape, np.int32),
        "ego_from_infra": frame.ego_from_infra.matrix.astype(np.float32),
        "gt_boxes": ground_truth(frame.labels, config),
        **_agent_input(ego, "ego", frame.frame_id, config),
        **_agent_input(infra, "infra", frame.frame_id, config),
    }


def _restrict(view: AgentView, camera: bool, lidar: bool) -> AgentView:
    """The view without the sensors that are not to be used."""
    image, depth = (view.image, view.depth) if camera else (None, None)
    return replace(view, image=image, depth=depth, points=view.points if lidar else None, scan=None)


def _agent_input(view: AgentView, agent: str, frame_id: str, config: PrepareConfig) -> dict:
    agent_input = {
        "points": _points(view.points, f"frame {frame_id}: {agent} points", config),
        "images": _image(view.image, config.image_shape),
        "depth_maps": _depth_map(view.depth, config),
        **_calibration(view.camera, config.image_shape),
    }
    return {f"{key}{SUFFIXES[agent]}": value for key, value in agent_input.items()}


def _points(points: np.ndarray | None, name: str, config: PrepareConfig) -> np.ndarray:
    """The points inside the agent's BEV range, in their order."""
    if points is None:
        return np.zeros((0, config.point_features), np.float32)
    if points.ndim != 2 or points.shape[1] != len(POINT_FEATURES):
        raise RecordError(f"{name}: expected shape (P, {len(POINT_FEATURES)}), found {points.shape}")
    inside, finite = _crop(np.ascontiguousarray(points, np.float32), np.array(config.grid.range))
    if not finite:
        raise RecordError(f"{name}: hold NaN or infinite values")
    return np.ascontiguousarray(inside[:, : config.point_features])


@numba.njit(cache=True)
def _crop(points, limits):
    """The rows (Q, 4) inside the half-open ``limits`` (x, y, z minimum, then maximum), and whether all are finite."""
    kept = np.empty_like(points)
    n, finite = 0, True
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        finite &= np.isfinite(x) and np.isfinite(y) and np.isfinite(z) and np.isfinite(points[i, 3])
        if limits[0] <= x < limits[3] and limits[1] <= y < limits[4] and limits[2] <= z < limits[5]:
            kept[n] = points[i]
            n += 1
    return kept[:n].copy(), finite


def _image(image: np.ndarray | None, shape: tuple[int, int]) -> np.ndarray:
    if image is None:
        return np.zeros((*shape, 3), np.float32)
    if image.shape[:2] != shape:
        shrinks = image.shape[0] > shape[0]
        image = cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    return image.astype(np.float32) / np.float32(255.0)


def _depth_map(depth: np.ndarray | None, config: PrepareConfig) -> np.ndarray:
    """Nearest known depth of each f x f block of the (resized) image: what stands in front hides what is behind."""
    if depth is None:
        return np.zeros(config.depth_shape, np.float32)
    f, (rows, columns) = config.depth_downsample, config.depth_shape
    known = np.full((rows * f, columns * f), np.inf, np.float32)
    resized = _resize_nearest(depth, config.image_shape)
    known[: resized.shape[0], : resized.shape[1]] = np.where(resized > 0, resized, np.float32(np.inf))
    nearest = known.reshape(rows, f, columns * f).min(1).reshape(rows, columns, f).min(2)
    return np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)


def _resize_nearest(depth: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Depths are picked, never mixed: a mean across an edge is a depth where nothing is."""
    if depth.shape == shape:
        return depth
    rows, columns = (((np.arange(n) + 0.5) * m / n).astype(int) for n, m in zip(shape, depth.shape, strict=True))
    return depth[rows[:, None], columns]


def _calibration(camera: PinholeCamera | None, shape: tuple[int, int]) -> dict[str, np.ndarray]:
    """Identity where there is no camera: such a source is masked."""
    if camera is None:
        return {"trans_lidar_to_cam": np.eye(4, dtype=np.float32), "trans_cam_to_img": np.eye(3, 4, dtype=np.float32)}
    scaled = camera.scaled(shape[1], shape[0])
    projection = np.concatenate([scaled.intrinsics, np.zeros((3, 1))], 1)
    return {
        "trans_lidar_to_cam": camera.agent_from_camera.inverse().matrix.astype(np.float32),
        "trans_cam_to_img": projection.astype(np.float32),
    }


def ground_truth(labels: Labels, config: PrepareConfig) -> np.ndarray:
    """(M, 8) float32 boxes in the ego frame whose centre is in range, and their class, counted from 1."""
    number = np.array([config.class_names.index(n) + 1 if n in config.class_names else 0 for n in labels.names], int)
    keep = (number > 0) & config.grid.contains_bev(labels.boxes)
    return np.concatenate([labels.boxes[keep, :7], number[keep, None]], 1).astype(np.float32)
