"""Made-up sets of frames with detections of chosen quality."""

import numpy as np
import pytest

from pcdet_avp.evaluation import Detections, GroundTruth


@pytest.fixture
def make_set():
    return random_set


def random_set(rng, frames=12, per_scene=3, noise=0.1, found=1.0, extra=0):
    """Frames of 4 cars and 3 pedestrians, and detections of a share ``found`` of them with ``noise`` metres."""
    truths, detections = [], []
    for f in range(frames):
        names = np.array(["Car"] * 4 + ["Pedestrian"] * 3)
        xy = np.column_stack([rng.uniform(6, 44, 7), rng.uniform(-14, 14, 7), np.full(7, 0.8)])
        sizes = np.where((names == "Car")[:, None], [4.5, 1.9, 1.6], [0.375, 0.375, 1.8])
        boxes = np.column_stack([xy, sizes, rng.uniform(-3, 3, 7)])
        truths.append(GroundTruth(f"{f // per_scene:03d}/{f:04d}", boxes, names, rng.integers(0, 3, 7)))
        kept = np.flatnonzero(rng.random(7) < found)
        kept = np.concatenate([kept, rng.integers(0, 7, extra)])
        moved = boxes[kept] + np.pad(rng.normal(0, noise, (len(kept), 2)), ((0, 0), (0, 5)))
        detections.append(Detections(truths[-1].frame_id, moved, names[kept], rng.random(len(kept))))
    return truths, detections
