"""Detections as pictures: one frame, seen with several sensor combinations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import nn

from pcdet_avp.datasets.avp.collate import load_batch
from pcdet_avp.evaluation.inputs import Detections
from pcdet_avp.structures.sensor_set import SensorSet
from pcdet_avp.visualization.detections import comparison

ALL_SENSORS = SensorSet.parse("CL+CL")
MIN_SCORE = 0.3  # where no score was chosen on the validation split


def detection_picture(
    model: nn.Module,
    dataset,
    index: int,
    combos: Sequence[str],
    device: torch.device,
    min_scores: Mapping[str, float] | None = None,
) -> np.ndarray:
    """(H, W, 3) uint8: what the network finds in a frame with each of the combinations. Leaves no trace in a run.

    ``min_scores``: class -> lowest score that is shown, ``MIN_SCORE`` by default.
    """
    was_training = model.training
    devices = [device] if device.type == "cuda" else []
    with torch.random.fork_rng(devices), torch.no_grad():
        model.eval()
        found = {combo: _find(model, dataset, index, combo, device) for combo in combos}
        model.train(was_training)
    results = {
        combo: (dataset.read(index, SensorSet.parse(combo)), above_scores(detections, min_scores or {}))
        for combo, detections in found.items()
    }
    return comparison(dataset.read(index, ALL_SENSORS), dataset.prepare_config.grid, results)


def _find(model: nn.Module, dataset, index: int, combo: str, device: torch.device) -> Detections:
    batch_dict = load_batch(dataset.collate_batch([dataset[(index, combo)]]), device)
    predictions, _ = model(batch_dict)
    return Detections.from_annotation(
        dataset.generate_prediction_dicts(batch_dict, predictions, dataset.class_names)[0]
    )


def above_scores(detections: Detections, min_scores: Mapping[str, float]) -> Detections:
    """Those that score at least what their class needs, ``MIN_SCORE`` where ``min_scores`` does not say."""
    least = np.array([min_scores.get(str(name), MIN_SCORE) for name in detections.names])
    return detections.select(detections.scores >= least)
