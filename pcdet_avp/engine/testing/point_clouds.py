"""A user's own point clouds: what a network finds in the vehicle's LiDAR alone, as OpenPCDet's demo shows it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import nn

from pcdet_avp.datasets.avp.avp_dataset import AvpDataset
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.engine.testing.pictures import above_scores
from pcdet_avp.errors import RecordError
from pcdet_avp.evaluation.inputs import Detections
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.frame import AgentView, Frame, Labels
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet
from pcdet_avp.visualization.detections import bev_panel

EXTENSIONS = (".bin", ".npy")
COLUMNS = 4  # x, y, z, intensity
VEHICLE_LIDAR = SensorSet(ego_camera=False, ego_lidar=True, infra_camera=False, infra_lidar=False)
WIDTH_PX = 1600


def cloud_files(path: Path) -> list[Path]:
    """The file, or every cloud of the folder in the order of their names."""
    if path.is_file():
        return [path]
    found = sorted(file for file in path.glob("*") if file.suffix in EXTENSIONS) if path.is_dir() else []
    if not found:
        raise RecordError(f"{path}: expected a point cloud, or a folder with {' or '.join(EXTENSIONS)} files")
    return found


def read_cloud(file: Path) -> np.ndarray:
    """(P, 4) float32: float32 rows x, y, z, intensity as KITTI's .bin, or a .npy array with at least these columns."""
    try:
        raw = (
            np.frombuffer(file.read_bytes(), np.float32) if file.suffix == ".bin" else np.load(file, allow_pickle=False)
        )
        points = raw.reshape(-1, COLUMNS) if file.suffix == ".bin" else raw
    except (OSError, ValueError, EOFError) as error:
        raise RecordError(f"{file}: not a point cloud ({error})") from error
    if points.ndim != 2 or points.shape[1] < COLUMNS or points.dtype.kind not in "fiu":
        raise RecordError(f"{file}: expected rows of x, y, z, intensity, found {points.dtype} {points.shape}")
    return np.ascontiguousarray(points[:, :COLUMNS], np.float32)


def cloud_frame(file: Path, lidar_height_m: float) -> Frame:
    """A frame that holds a cloud measured from a LiDAR ``lidar_height_m`` above the floor, and nothing else."""
    points = read_cloud(file) + np.array([0, 0, lidar_height_m, 0], np.float32)
    here = Pose.identity()
    return Frame(file.stem, 0.0, AgentView(here, points=points), AgentView(here), Labels.empty())


def find_in_cloud(
    model: nn.Module, frame: Frame, network_input: NetworkInput, device: torch.device, min_scores: Mapping[str, float]
) -> Detections:
    """What the network finds in the vehicle's LiDAR of a frame; ``min_scores``: class -> lowest score."""
    batch_dict = load_batch(collate([prepare(frame, VEHICLE_LIDAR, network_input.prepare_config)]), device)
    with torch.no_grad():
        predictions, _ = model.eval()(batch_dict)
    (found,) = AvpDataset.generate_prediction_dicts(batch_dict, predictions, network_input.class_names)
    return above_scores(Detections.from_annotation(found), min_scores)


def cloud_picture(frame: Frame, found: Detections, grid: BevGrid) -> np.ndarray:
    """(H, W, 3) uint8: the cloud from above with what was found in it."""
    return bev_panel(frame, found, grid, "vehicle LiDAR", WIDTH_PX)
