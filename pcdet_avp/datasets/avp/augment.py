"""Augmentation of a ``Frame`` before it is prepared, configured like OpenPCDet's DATA_AUGMENTOR.

Every draw comes from the generator handed in, and every entry draws the same numbers whatever sensors are
present, so that one sensor's absence does not change the others' augmentation. Steps are module-level functions, so
that worker processes can be started by any method.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from pcdet_avp.config import require
from pcdet_avp.datasets.avp import transforms
from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.frame import AgentView, Frame

Augmentation = Callable[[Frame, np.random.Generator], Frame]


class Augmentor:
    """The entries of AUG_CONFIG_LIST that DISABLE_AUG_LIST does not name, in their order."""

    def __init__(self, augmentor_cfg: Mapping | None) -> None:
        self.steps: list[tuple[str, Augmentation]] = []
        if augmentor_cfg is not None:
            entries = require(augmentor_cfg, "AUG_CONFIG_LIST", list)
            self.steps = [(require(entry, "NAME", str), _build(entry)) for entry in entries]
            self.disable_augmentation(augmentor_cfg)

    def disable_augmentation(self, augmentor_cfg: Mapping) -> None:
        """Drop what DISABLE_AUG_LIST names; OpenPCDet's hook calls this before the last epochs."""
        disabled = augmentor_cfg.get("DISABLE_AUG_LIST") or []
        unknown = [name for name in disabled if name not in AUGMENTATIONS]
        if unknown:
            raise ConfigError(f"DISABLE_AUG_LIST: unknown name {unknown[0]!r}; known: {', '.join(AUGMENTATIONS)}")
        self.steps = [(name, step) for name, step in self.steps if name not in disabled]

    def __call__(self, frame: Frame, rng: np.random.Generator) -> Frame:
        for _, step in self.steps:
            frame = step(frame, rng)
        return frame


def _build(entry: Mapping) -> Augmentation:
    name = require(entry, "NAME", str)
    if name not in AUGMENTATIONS:
        raise ConfigError(f"AUG_CONFIG_LIST: unknown name {name!r}; known: {', '.join(AUGMENTATIONS)}")
    unknown = [key for key in entry if key not in ("NAME", *KEYS[name])]
    if unknown:
        raise ConfigError(f"AUG_CONFIG_LIST: {name}: unknown key {unknown[0]!r}; known: {', '.join(KEYS[name])}")
    return AUGMENTATIONS[name](entry)


def _flip(entry: Mapping) -> Augmentation:
    """ALONG_AXIS_LIST ['x'] (the only one that leaves the scene in range), PROBABILITY."""
    axes = require(entry, "ALONG_AXIS_LIST", list)
    if list(axes) != ["x"]:
        raise ConfigError(f"random_world_flip.ALONG_AXIS_LIST: expected ['x'], found {list(axes)}")
    probability = float(entry.get("PROBABILITY", 0.5))
    if not 0 <= probability <= 1:
        raise ConfigError(f"random_world_flip.PROBABILITY: expected 0 to 1, found {probability}")
    return partial(flip_sometimes, probability=probability)


def flip_sometimes(frame: Frame, rng: np.random.Generator, probability: float) -> Frame:
    """The frame, or by chance its mirror image (y -> -y in both agents' frames)."""
    return transforms.flip(frame) if rng.random() < probability else frame


def _rotation(entry: Mapping) -> Augmentation:
    """WORLD_ROT_ANGLE [low, high] rad; AGENTS whose frames turn, each by an angle of its own."""
    low, high = _interval(entry, "WORLD_ROT_ANGLE")
    agents = list(entry.get("AGENTS", ["ego"]))
    if not set(agents) <= {"ego", "infra"}:
        raise ConfigError(f"random_world_rotation.AGENTS: expected some of ego, infra, found {agents}")
    return partial(rotate_agents, agents=agents, low=low, high=high)


def rotate_agents(frame: Frame, rng: np.random.Generator, agents: list[str], low: float, high: float) -> Frame:
    """Turn the frames of some agents, each by an angle of its own between low and high (rad)."""
    for agent in agents:
        frame = transforms.rotate_agent(frame, agent, rng.uniform(low, high))
    return frame


def _scaling(entry: Mapping) -> Augmentation:
    """WORLD_SCALE_RANGE [low, high]."""
    low, high = _interval(entry, "WORLD_SCALE_RANGE")
    if low <= 0:
        raise ConfigError(f"random_world_scaling.WORLD_SCALE_RANGE: must be positive, found {[low, high]}")
    return partial(scale_evenly, low=low, high=high)


def scale_evenly(frame: Frame, rng: np.random.Generator, low: float, high: float) -> Frame:
    """Multiply every length by one factor between low and high."""
    return transforms.scale(frame, rng.uniform(low, high))


def _photometric(entry: Mapping) -> Augmentation:
    """BRIGHTNESS b: an offset in [-b, b] of full scale; CONTRAST [low, high]; NOISE_STD of full scale."""
    brightness, noise_std = float(entry.get("BRIGHTNESS", 0.0)), float(entry.get("NOISE_STD", 0.0))
    contrast = _interval(entry, "CONTRAST") if "CONTRAST" in entry else (1.0, 1.0)
    return partial(jitter_both, brightness=brightness, contrast=contrast, noise_std=noise_std)


def jitter_both(frame: Frame, rng: np.random.Generator, **ranges: Any) -> Frame:
    """``jitter`` of both agents' images, each with draws of its own."""
    return replace(frame, ego=jitter(frame.ego, rng, **ranges), infra=jitter(frame.infra, rng, **ranges))


def jitter(
    view: AgentView, rng: np.random.Generator, brightness: float, contrast: tuple[float, float], noise_std: float
) -> AgentView:
    """The view with its image brighter or darker by up to ``brightness``, with another contrast and with grey noise.

    Brightness and noise are shares of full scale. A view without an image draws as many numbers as one with it.
    """
    offset, gain = rng.uniform(-brightness, brightness), rng.uniform(*contrast)
    noise_rng = rng.spawn(1)[0]
    if view.image is None:
        return view
    return replace(view, image=_expose(view.image, gain, offset, noise_std, noise_rng))


def _expose(image: np.ndarray, gain: float, offset: float, noise_std: float, rng: np.random.Generator) -> np.ndarray:
    """uint8 image scaled about its mean, shifted, and with grey noise added; offset and noise_std in full scales."""
    mean = float(image.mean())
    table = (np.arange(256) - mean) * gain + mean + 255 * offset
    exposed = cv2.LUT(image, table.astype(np.float32))
    if noise_std > 0:
        exposed += rng.standard_normal((*image.shape[:2], 1), dtype=np.float32) * np.float32(255 * noise_std)
    return np.clip(np.rint(exposed, out=exposed), 0, 255, out=exposed).astype(np.uint8)


def _localisation(entry: Mapping) -> Augmentation:
    """POSITION_STD_M along x and y, YAW_STD_DEG, both normal."""
    position, yaw = float(entry.get("POSITION_STD_M", 0.0)), np.radians(float(entry.get("YAW_STD_DEG", 0.0)))
    return partial(misplace_normally, stds=(position, position, yaw))


def misplace_normally(frame: Frame, rng: np.random.Generator, stds: tuple[float, float, float]) -> Frame:
    """Move the roadside's map by a normal error; ``stds`` along x and y (m) and in yaw (rad)."""
    return transforms.misplace_infra(frame, *(rng.standard_normal(3) * stds))


def _interval(entry: Mapping, key: str) -> tuple[float, float]:
    values = require(entry, key, list)
    if len(values) != 2 or not values[0] <= values[1]:
        raise ConfigError(f"{entry['NAME']}.{key}: expected [low, high], found {list(values)}")
    return float(values[0]), float(values[1])


AUGMENTATIONS: dict[str, Callable[[Mapping], Augmentation]] = {
    "random_world_flip": _flip,
    "random_world_rotation": _rotation,
    "random_world_scaling": _scaling,
    "random_photometric": _photometric,
    "random_localisation_noise": _localisation,
}
KEYS = {
    "random_world_flip": ("ALONG_AXIS_LIST", "PROBABILITY"),
    "random_world_rotation": ("WORLD_ROT_ANGLE", "AGENTS"),
    "random_world_scaling": ("WORLD_SCALE_RANGE",),
    "random_photometric": ("BRIGHTNESS", "CONTRAST", "NOISE_STD"),
    "random_localisation_noise": ("POSITION_STD_M", "YAW_STD_DEG"),
}
