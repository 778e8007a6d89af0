"""Draws where the roadside unit of a drawn garage hangs, and the ceiling above it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.structures.scene_config import GarageConfig, MastConfig


def draw_mast(rng: np.random.Generator, cfg: MastConfig) -> MountedUnit:
    """A unit at x = 0 in the world frame (m, rad), which looks about to where the ego comes from."""
    height = float(rng.uniform(*cfg.height_m))
    pitch = float(rng.uniform(*cfg.pitch_range(height)))
    yaw = np.pi + np.radians(rng.uniform(*cfg.yaw_deg))
    return MountedUnit(0.0, float(rng.uniform(*cfg.offset_m)), height, float(yaw), pitch)


def under_ceiling(garage: GarageConfig, unit: MountedUnit, cfg: MastConfig) -> GarageConfig:
    """The ranges of a garage whose ceiling suits a unit."""
    return replace(garage, ceiling_m=cfg.ceiling_range(unit.z_m))
