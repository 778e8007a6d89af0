"""Losing roadside maps on purpose while training, since one of two packets may be lost on the air."""

from __future__ import annotations

import zlib

import numpy as np
import torch

from pcdet_avp.structures.sensor_set import SOURCES

INFRA_SLOTS = [i for i, source in enumerate(SOURCES) if source.startswith("infra")]


def drop_roadside_maps(batch_dict: dict, probability: float, step: int) -> dict:
    """Each roadside map of each sample is absent with this probability; a sample keeps at least one source.

    What is lost follows from the training step and the frame, whatever ranks and workers share the frames.

    Args: batch_dict:
        source_present (B, 4), frame_id (B,) text
    Returns: batch_dict with
        source_present (B, 4)
    """
    present = batch_dict["source_present"]
    keep = torch.ones_like(present)
    for i, frame_id in enumerate(batch_dict["frame_id"]):
        rng = np.random.default_rng([step, zlib.crc32(str(frame_id).encode())])
        lost = torch.from_numpy(rng.random(len(INFRA_SLOTS)) < probability)
        keep[i, INFRA_SLOTS] = (~lost).to(keep)
    kept = present * keep
    nothing_left = (kept.sum(1, keepdim=True) == 0).to(kept)
    return {**batch_dict, "source_present": torch.maximum(kept, present * nothing_left)}
