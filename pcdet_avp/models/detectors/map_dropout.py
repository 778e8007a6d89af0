"""Losing roadside maps, and parts of them, on purpose while training, since the air does so, too.

What is lost follows from the training step and the frame, whatever ranks and workers share the frames.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor

from pcdet_avp.models.compression.bev_codec import Latent
from pcdet_avp.structures.sensor_set import INFRA_SOURCES, SOURCES

SEGMENTS = 8  # runs of cells in raster order that a map is cut into, about as many as fill transport blocks
MAX_LOSS_RATE = 0.5  # of the segments of a map that loses any
INFRA_SLOTS = [SOURCES.index(source) for source in INFRA_SOURCES]


def drop_roadside_maps(batch_dict: dict, probability: float, step: int) -> dict:
    """Each roadside map of each sample is absent with this probability; a sample keeps at least one source.

    Args: batch_dict:
        source_present (B, 4), frame_id (B,) text
    Returns: batch_dict with
        source_present (B, 4)
    """
    present = batch_dict["source_present"]
    keep = torch.ones_like(present)
    for i, frame_id in enumerate(batch_dict["frame_id"]):
        rng = _rng(step, frame_id)
        lost = torch.from_numpy(rng.random(len(INFRA_SLOTS)) < probability)
        keep[i, INFRA_SLOTS] = (~lost).to(keep)
    kept = present * keep
    nothing_left = (kept.sum(1, keepdim=True) == 0).to(kept)
    return {**batch_dict, "source_present": torch.maximum(kept, present * nothing_left)}


def drop_segments(
    latents: dict[str, Latent], frame_ids: Iterable[str], probability: float, step: int
) -> dict[str, Latent]:
    """Each latent of each sample loses, with this probability, some of its segments, at a rate of its own.

    Cells (raster order) of a lost segment are not received, and their values are zero.
    """
    return {source: _drop_segments(latent, source, frame_ids, probability, step) for source, latent in latents.items()}


def _drop_segments(latent: Latent, source: str, frame_ids: Iterable[str], probability: float, step: int) -> Latent:
    h, w = latent.received.shape[2:]
    segment = torch.arange(h * w, device=latent.received.device) * SEGMENTS // (h * w)
    arrived = torch.stack([_arrived(_rng(step, i, source), probability) for i in frame_ids]).to(segment.device)
    received = latent.received & arrived[:, segment].view(-1, 1, h, w)
    return Latent(torch.where(received, latent.values, 0), received)


def _arrived(rng: np.random.Generator, probability: float) -> Tensor:
    """(SEGMENTS,) bool."""
    rate = rng.uniform(0, MAX_LOSS_RATE) if rng.random() < probability else 0.0
    return torch.from_numpy(rng.random(SEGMENTS) >= rate)


def _rng(step: int, frame_id: str, source: str = "") -> np.random.Generator:
    key = [step, zlib.crc32(str(frame_id).encode())]
    return np.random.default_rng(key + [1 + SOURCES.index(source)] if source else key)
