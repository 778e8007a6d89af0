"""Samples -> batch (numpy) -> tensors. The batch size travels explicitly, because an absent sensor has no rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import torch

RAGGED = ("points", "points_infra")
# OpenPCDet turns ``images`` into (B, 3, h, w) on the way to the device, and only that key.
CHANNELS_FIRST = ("images_infra",)


def collate(samples: Sequence[dict]) -> dict:
    """Every key of ``prepare``, stacked: (B, ...).

    Ragged ones: points (P, 1 + C) with the sample's number in column 0; gt_boxes (B, M, 8) zero padded. Also
    batch_size int and frame_id (B,) str; images (B, h, w, 3), but images_infra (B, 3, h, w).
    """
    batch: dict[str, Any] = {
        "batch_size": len(samples),
        "frame_id": np.array([sample["frame_id"] for sample in samples]),
    }
    for key in [key for key in samples[0] if key not in batch]:
        values = [sample[key] for sample in samples]
        if key in RAGGED:
            batch[key] = _with_sample_number(values)
        elif key == "gt_boxes":
            batch[key] = _padded(values)
        else:
            batch[key] = np.stack(values) if len(values) > 1 else np.asarray(values[0])[None]
    for key in CHANNELS_FIRST:
        batch[key] = _channels_first(batch[key])
    return batch


def _channels_first(images: np.ndarray) -> np.ndarray:
    """(B, h, w, 3) -> (B, 3, h, w); OpenCV does it in a quarter of numpy's time."""
    B, height, width, channels = images.shape
    moved = np.empty((B, channels, height, width), images.dtype)
    for image, planes in zip(images, moved, strict=True):
        cv2.split(image, list(planes))
    return moved


def _with_sample_number(clouds: list[np.ndarray]) -> np.ndarray:
    """(P_1 + ... + P_B, 1 + C) float32."""
    edges = np.cumsum([0, *map(len, clouds)])
    rows = np.empty((edges[-1], 1 + clouds[0].shape[1]), np.float32)
    for number, cloud in enumerate(clouds):
        part = rows[edges[number] : edges[number + 1]]
        part[:, 0], part[:, 1:] = number, cloud
    return rows


def _padded(boxes: list[np.ndarray]) -> np.ndarray:
    """(B, max M, 8) float32."""
    padded = np.zeros((len(boxes), max(map(len, boxes)), 8), np.float32)
    for i, rows in enumerate(boxes):
        padded[i, : len(rows)] = rows
    return padded


def load_batch(batch: dict, device: torch.device | str) -> dict:
    """Numeric arrays as float32 tensors on ``device``, ``images`` as (B, 3, h, w); text and plain values unchanged."""
    return {key: _load(key, value, device) for key, value in batch.items()}


def _load(key: str, value, device: torch.device | str):
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub":
        return value
    tensor = torch.from_numpy(value).to(device).float()
    return tensor.permute(0, 3, 1, 2).contiguous() if key == "images" else tensor
