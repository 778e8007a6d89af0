"""Full-size roadside maps for ``link.py``: real sweeps of the garage through a network with random weights.

A sweep of the mast's LiDAR becomes pillar features, is blurred (in place of attention), mixed to C / 8 channels and
max pooled; then all but a share of it is set to zero. Weights are untrained: sizes are of the right structure only.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter
from tqdm import tqdm

from pcdet_avp.generate import scene_config
from pcdet_avp.sim.rig import Rig, capture
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.bev_grid import BevGrid

PILLAR_CHANNELS, SENT_CHANNELS = 64, 8
BLUR_CELLS = {"lidar": 1.0, "smooth": 4.0}
SPARSITIES = (0.82, 0.85, 0.88)


def roadside_sweep(cfg, seed: int) -> np.ndarray:
    """Points (P, 4) of the mast's LiDAR in a drawn scene, in its own frame."""
    scene = draw_training_scene(np.random.default_rng(seed), scene_config(cfg.GENERATE))
    frame = capture(scene.seek(0), Rig.from_config(cfg.SENSORS), (seed, 0, 0), "0000/000", sources=("infra_lidar",))
    return frame.infra.points


def pillar_features(points: np.ndarray, grid: BevGrid) -> np.ndarray:
    """(H, W, 64): the largest response of random features of the points of every cell, zero where there is none."""
    points = points[grid.contains(points)]
    row, col = grid.cell_of(points)
    x, y = grid.cell_centres()
    offsets = np.stack([points[:, 0] - x[col], points[:, 1] - y[row], points[:, 2], points[:, 3]], 1)
    weights = np.random.default_rng(0).normal(size=(4, PILLAR_CHANNELS))
    features = np.zeros((grid.height * grid.width, PILLAR_CHANNELS), np.float32)
    np.maximum.at(features, row * grid.width + col, np.maximum(offsets @ weights, 0).astype(np.float32))
    return features.reshape(grid.height, grid.width, PILLAR_CHANNELS)


def latent_map(features: np.ndarray, blur_cells: float) -> np.ndarray:
    """(8, H / 2, W / 2) float32: blurred, mixed to 8 channels by random weights, 2 x 2 max pooling."""
    weights = np.random.default_rng(1).normal(size=(PILLAR_CHANNELS, SENT_CHANNELS)) / 8
    mixed = gaussian_filter(features, (blur_cells, blur_cells, 0)) @ weights
    height, width, channels = mixed.shape
    pooled = mixed.reshape(height // 2, 2, width // 2, 2, channels).max((1, 3))
    return np.ascontiguousarray(pooled.transpose(2, 0, 1), dtype=np.float32)


def sparsified(latent: np.ndarray, sparsity: float, structure: str) -> np.ndarray:
    """Keep a share 1 - sparsity: of the cells, those with the longest vectors; of the elements, the largest."""
    size = np.linalg.norm(latent, axis=0)[None] if structure == "cells" else np.abs(latent)
    return np.where(size > np.quantile(size, sparsity), latent, 0)


def drawn_maps(cfg, scenes: int) -> dict[str, list[np.ndarray]]:
    """Dense latent maps of ``scenes`` sweeps, by kind."""
    grid = BevGrid.from_range(cfg.POINT_CLOUD_RANGE, cfg.VOXEL_SIZE)
    features = [pillar_features(roadside_sweep(cfg, seed), grid) for seed in tqdm(range(scenes), desc="sweeps")]
    return {kind: [latent_map(f, blur) for f in features] for kind, blur in BLUR_CELLS.items()}
