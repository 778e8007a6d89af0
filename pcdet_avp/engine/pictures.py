"""Detections as pictures: bird's-eye views of one sample, without and with the roadside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import nn

from pcdet_avp.datasets.avp.collate import load_batch
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.pose import Pose
from pcdet_avp.visualization.draw import BevCanvas, put_text

PX_PER_M = 8.0
POINT_STRENGTH = 0.4  # light that one point adds
EGO_LIGHT, INFRA_LIGHT = (235, 235, 235), (90, 150, 255)
TRUE_COLOR, FOUND_COLORS = (60, 200, 60), ((255, 160, 40), (255, 70, 160))  # of a car, of a pedestrian
MIN_SCORE = 0.3


def bev_picture(sample: Mapping, prediction: Mapping[str, np.ndarray], grid: BevGrid, title: str) -> np.ndarray:
    """(H, W, 3) uint8: points of both agents, true boxes (green) and detections above ``MIN_SCORE``.

    ``sample`` as from ``AvpDataset.__getitem__``; ``prediction`` holds pred_boxes (n, 7), pred_scores (n,) and
    pred_labels (n,) from 1.
    """
    canvas = BevCanvas(grid.x_min_m, grid.y_min_m, grid.x_max_m, grid.y_max_m, PX_PER_M)
    ego_from_infra = Pose(np.asarray(sample["ego_from_infra"], np.float64))
    canvas.points(ego_from_infra.apply(sample["points_infra"][:, :3]), INFRA_LIGHT, POINT_STRENGTH)
    canvas.points(sample["points"], EGO_LIGHT, POINT_STRENGTH)
    true = sample["gt_boxes"]
    canvas.boxes(true, np.tile(TRUE_COLOR, (len(true), 1)), thickness=1)
    shown = prediction["pred_scores"] >= MIN_SCORE
    colors = np.array(FOUND_COLORS)[(prediction["pred_labels"][shown].astype(int) - 1) % len(FOUND_COLORS)]
    canvas.boxes(prediction["pred_boxes"][shown], colors, thickness=2)
    put_text(canvas.image, title, (8, 22))
    return canvas.image


def detection_picture(model: nn.Module, dataset, index: int, combos: Sequence[str], device: torch.device) -> np.ndarray:
    """What the network finds in one sample with each of the combinations, side by side. Leaves no trace in the run."""
    was_training = model.training
    devices = [device] if device.type == "cuda" else []
    with torch.random.fork_rng(devices), torch.no_grad():
        model.eval()
        pictures = [_one(model, dataset, index, combo, device) for combo in combos]
        model.train(was_training)
    return np.concatenate(pictures, axis=1)


def _one(model: nn.Module, dataset, index: int, combo: str, device: torch.device) -> np.ndarray:
    sample = dataset[(index, combo)]
    predictions, _ = model(load_batch(dataset.collate_batch([sample]), device))
    arrays = {key: value.detach().cpu().numpy() for key, value in predictions[0].items()}
    return bev_picture(sample, arrays, dataset.prepare_config.grid, f"{sample['frame_id']} {combo}")
