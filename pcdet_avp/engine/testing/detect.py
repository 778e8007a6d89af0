"""Detections of a trained network on a split, for any of the sensor sets: the input of the benchmark table."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.loader import batches
from pcdet_avp.errors import SensorError
from pcdet_avp.evaluation import Detections, evaluate, score_thresholds
from pcdet_avp.evaluation.benchmark_table import benchmark_rows
from pcdet_avp.models.compression.wire import Wire
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SOURCES, SensorSet, combos_with


@dataclass(frozen=True)
class DetectionRun:
    """For each sensor set: detections, one per frame of the split in its order, and bytes of every map sent."""

    detections: dict[str, list[Detections]]
    sizes: dict[str, dict[str, list[int]]]  # combination -> modality -> bytes; empty where no bytes were made

    def bytes_per_map(self, combo: str) -> dict[str, float]:
        """Mean over the maps sent, by modality."""
        return {modality: float(np.mean(sizes)) for modality, sizes in self.sizes[combo].items()}


def parse_combos(text: str) -> list[str]:
    """``"all"`` or names between commas, in the paper's order."""
    wanted = list(SENSOR_SETS) if text == "all" else [name.strip() for name in text.split(",") if name.strip()]
    if not wanted:
        raise SensorError(f"--combos {text!r}: expected all, or some of {', '.join(SENSOR_SETS)}")
    for name in wanted:
        SensorSet.parse(name)
    return [name for name in SENSOR_SETS if name in wanted]


def existing_combos(dataset: Any, wanted: Sequence[str] | None, asked_by: str, logger: logging.Logger) -> list[str]:
    """Those of ``wanted`` that the data set can show; None or all six: whatever it can, and the log says what not.

    A name that stands there twice stays twice (it is drawn twice as often in training).

    SensorError where one that was asked for by name needs sensors that no frame has, or where all need some.
    """
    sources = getattr(dataset, "recorded_sources", SOURCES)
    there = combos_with(sources)
    if not there:
        raise SensorError(
            f"{dataset.root_path}: recorded are {', '.join(sources) or 'no sensors'} only: every sensor combination "
            "has a sensor of the vehicle"
        )
    if wanted is None or set(wanted) == set(SENSOR_SETS):
        missing = [name for name in SENSOR_SETS if name not in there]
        if missing:
            logger.info(f"recorded are {', '.join(sources)}: sensor combinations {', '.join(there)} only")
        return [name for name in there for _ in range(1 if wanted is None else list(wanted).count(name))]
    for name in wanted:
        if name not in there:
            raise SensorError(
                f"{asked_by}: {name}: recorded are {', '.join(sources)} only; expected some of {', '.join(there)}"
            )
    return list(wanted)


def detect(
    model: nn.Module,
    dataset,
    combos: Sequence[str],
    ranks: Ranks,
    batch_size: int = 1,
    workers: int = 0,
    wire: Wire | None = None,
) -> DetectionRun:
    """Run the network over the whole split once per combination; ranks share the frames, all get the result."""
    was_training = model.training
    model.eval()
    mine = {combo: ([], defaultdict(list)) for combo in combos}
    total = len(dataset) * len(combos)
    with tqdm(total=total, unit="frame", desc=f"testing on {dataset.split}", disable=not ranks.is_first) as bar:
        for combo, annotations, sizes in _results(model, dataset, combos, ranks, batch_size, workers, wire):
            mine[combo][0].extend(annotations)
            for modality, of_batch in sizes.items():
                mine[combo][1][modality] += of_batch
            bar.set_postfix_str(combo, refresh=False)
            bar.update(len(annotations) * ranks.world)
    model.train(was_training)
    parts = ranks.gather(mine)
    detections = {combo: _in_order(dataset, [part[combo][0] for part in parts]) for combo in combos}
    return DetectionRun(detections, {combo: _joined([part[combo][1] for part in parts]) for combo in combos})


def _results(model, dataset, combos, ranks, batch_size, workers, wire) -> Iterator[tuple[str, list[dict], dict]]:
    """(combination, annotations, bytes) of every batch of this rank's frames; one loader serves all combinations."""
    frames = range(ranks.rank, len(dataset), ranks.world)
    parts = [frames[start : start + batch_size] for start in range(0, len(frames), batch_size)]
    keys = [[(index, combo) for index in part] for combo in combos for part in parts]
    for of_batch, batch_dict in zip(keys, batches(dataset, keys, ranks, workers), strict=True):
        with torch.no_grad():
            predictions, _ = model(batch_dict) if wire is None else model(batch_dict, link=wire)
        annotations = dataset.generate_prediction_dicts(batch_dict, predictions, dataset.class_names)
        yield of_batch[0][1], annotations, {} if wire is None else wire.take_sizes()


def _joined(parts: Sequence[Mapping[str, list[int]]]) -> dict[str, list[int]]:
    return {modality: [n for part in parts for n in part.get(modality, [])] for part in parts for modality in part}


def _in_order(dataset, parts: Sequence[Sequence[Mapping]]) -> list[Detections]:
    by_frame = {str(annotation["frame_id"]): annotation for part in parts for annotation in part}
    return [Detections.from_annotation(by_frame[frame_id]) for frame_id in dataset.frame_ids]


def benchmark(
    dataset, found: DetectionRun, min_scores: Mapping[str, float] | None = None
) -> tuple[list[dict], dict[str, str]]:
    """(rows of the benchmark table, the full text of each combination's evaluation)."""
    truths, regions = dataset.ground_truths(), dataset.regions()
    rows, texts = [], {}
    for combo, detections in found.detections.items():
        texts[combo], numbers = evaluate(truths, detections, regions, dataset.class_names, min_scores)
        rows += benchmark_rows(combo, numbers, regions, found.bytes_per_map(combo))
    return rows, texts


def driving_thresholds(dataset, found: DetectionRun) -> dict[str, float]:
    """For each class, the score from which on F1 at the loose IoU is best over all combinations together.

    One number per class serves every combination, because the roadside may vanish at any frame. For the
    validation split.
    """
    truths, region = dataset.ground_truths(), dataset.regions()[-1]
    together = [detections for of_combo in found.detections.values() for detections in of_combo]
    return score_thresholds(truths * len(found.detections), together, region, dataset.class_names)


def as_scalars(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """The overall columns of the first region, named for TensorBoard."""
    first = rows[0]["region"] if rows else ""
    scalars = {}
    for row in (r for r in rows if r["region"] == first):
        for name in (key for key, cells in row.items() if isinstance(cells, dict) and "overall" in cells):
            for overlap, ap in row[name]["overall"].items():
                if ap is not None:
                    scalars[f"eval/{name}_{overlap}/{row['combo']}"] = ap
    return scalars
