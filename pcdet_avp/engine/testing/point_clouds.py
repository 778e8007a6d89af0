"""A user's own point clouds: what a network finds in the vehicle's LiDAR alone, as OpenPCDet's demo shows it."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from pcdet_avp.datasets.avp.avp_dataset import AvpDataset
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.datasets.point_clouds.cloud import FLOOR_TOLERANCE_M, Cloud, floor_depth_m
from pcdet_avp.datasets.point_clouds.read import EXTENSIONS, read_cloud
from pcdet_avp.engine.testing.pictures import above_scores
from pcdet_avp.errors import RecordError
from pcdet_avp.evaluation.detections_file import write_detections
from pcdet_avp.evaluation.inputs import Detections
from pcdet_avp.files import unlike_names
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.frame import AgentView, Frame, Labels
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet
from pcdet_avp.visualization.detections import bev_panel
from pcdet_avp.visualization.video import write_picture

VEHICLE_LIDAR = SensorSet(ego_camera=False, ego_lidar=True, infra_camera=False, infra_lidar=False)
WIDTH_PX = 1600


def cloud_files(path: Path) -> list[Path]:
    """The file, or every cloud of the folder in the order of their names; hidden files are no clouds."""
    if path.is_file():
        return [path]
    files = path.glob("[!.]*") if path.is_dir() else ()
    found = sorted(f for f in files if f.suffix.lower() in EXTENSIONS and f.is_file())
    if not found:
        raise RecordError(f"{path}: expected a point cloud, or a folder with {' or '.join(EXTENSIONS)} files")
    return found


def cloud_frame(name: str, cloud: Cloud, lidar_height_m: float) -> Frame:
    """A frame that holds a cloud measured from a LiDAR ``lidar_height_m`` above the floor, and nothing else."""
    points = cloud.points + np.array([0, 0, lidar_height_m, 0], np.float32)
    here = Pose.identity()
    return Frame(name, 0.0, AgentView(here, points=points), AgentView(here), Labels.empty())


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


@dataclass(frozen=True)
class CloudReading:
    """How the user's files are to be read; None where their format decides."""

    columns: int | None
    intensity_scale: float | None
    lidar_height_m: float | None
    vehicle_lidar_height_m: float  # where neither the user nor the format says

    def read(self, file: Path, name: str, logger: logging.Logger) -> Frame:
        """The frame of one file; the log says how it was read."""
        cloud = read_cloud(file, self.columns, self.intensity_scale)
        heights = (self.lidar_height_m, cloud.height_m, self.vehicle_lidar_height_m)
        height = next(h for h in heights if h is not None)
        self._doubt(file, cloud, height, logger)
        dropped = f", {cloud.dropped} rows with NaN or infinite values dropped" if cloud.dropped else ""
        logger.info(f"{file.name}: {len(cloud.points)} points as {cloud.layout}; {height:g} m above the floor{dropped}")
        return cloud_frame(name, cloud, height)

    def _doubt(self, file: Path, cloud: Cloud, height: float, logger: logging.Logger) -> None:
        """Warn where the cloud's own floor contradicts a height that the user has not given."""
        depth = floor_depth_m(cloud.points)
        if self.lidar_height_m is None and depth is not None and abs(depth - height) > FLOOR_TOLERANCE_M:
            logger.warning(
                f"{file.name}: the floor seems to lie {depth:.1f} m below the origin, not {height:g} m: what is found "
                f"then means nothing. --lidar_height_m {max(depth, 0):.1f} says so"
            )


def show_clouds(
    files: Sequence[Path],
    reading: CloudReading,
    model: nn.Module,
    network_input: NetworkInput,
    min_scores: Mapping[str, float],
    device: torch.device,
    out: Path,
    logger: logging.Logger,
) -> int:
    """A picture for each cloud, and one file with all detections, in ``out``; returns how many clouds there were.

    A file that cannot be read is skipped with a line in the log. RecordError where none can be read.
    """
    everything = []
    for file, name in tqdm(list(zip(files, unlike_names(files), strict=True)), unit="cloud", desc="drawing"):
        try:
            frame = reading.read(file, name, logger)
        except RecordError as error:
            logger.error(f"skipped: {error}")
            continue
        found = find_in_cloud(model, frame, network_input, device, min_scores)
        write_picture(out / f"{name}.png", cloud_picture(frame, found, network_input.prepare_config.grid))
        everything.append(found)
    if not everything:
        raise RecordError(f"none of {len(files)} clouds could be read, see the lines above")
    write_detections(out / "detections.npz", everything)
    return len(everything)
