"""The benchmark of a checkpoint: table and JSON file."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import nn

from pcdet_avp.datasets import build_dataset, has_split
from pcdet_avp.datasets.avp.splits import BY_SCENE, protocol_line, protocol_of
from pcdet_avp.deploy.runtime import TORCH
from pcdet_avp.engine import checkpoint
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.same_split import check_same_split, seen_before
from pcdet_avp.engine.testing.detect import benchmark, detect, driving_thresholds, existing_combos
from pcdet_avp.engine.testing.exported import load_exported
from pcdet_avp.engine.testing.roadside_gain import roadside_gains
from pcdet_avp.errors import OutputError
from pcdet_avp.evaluation.benchmark_table import render
from pcdet_avp.evaluation.detections_file import write_detections, write_texts
from pcdet_avp.evaluation.inputs import Detections
from pcdet_avp.files import write_json, write_text
from pcdet_avp.link.map_size import UNLIMITED
from pcdet_avp.models import build_network
from pcdet_avp.models.compression.wire import Wire
from pcdet_avp.models.precision import chosen_precision
from pcdet_avp.models.weights.checkpoint_file import THRESHOLDS_KEY, read_checkpoint
from pcdet_avp.provenance import provenance
from pcdet_avp.structures.sensor_set import SENSOR_SETS

RESULT = "result.json"


@dataclass(frozen=True)
class BenchmarkResult:
    """Rows of the benchmark table, where they come from; by combination, the full text and what was detected."""

    meta: dict[str, Any]
    rows: list[dict]
    texts: dict[str, str]
    detections: dict[str, list[Detections]] = field(default_factory=dict)
    gains: list[str] = field(default_factory=list)  # the roadside's, with intervals

    @property
    def tables(self) -> str:
        """The benchmark table of every region, beside the paper's, and how sure the roadside's gain is."""
        regions = list(dict.fromkeys(row["region"] for row in self.rows))
        parts = [render(self.rows, self.meta["config"], region) for region in regions]
        protocol = protocol_line(self.meta["split"], self.meta.get("split_by", BY_SCENE))
        notes = [protocol, self.meta["seen_before"]] if "seen_before" in self.meta else [protocol]
        return "\n\n".join([*notes, *parts, "\n".join(self.gains)]).rstrip()

    def write(self, folder: Path, json_file: Path | None = None, save_to_file: bool = False) -> None:
        """``table.md``, details, detections and ``result.json`` into a folder; the JSON also to a file of its own.

        ``save_to_file``: the detections of every frame as text, too, in ``final_result/<combination>/``. Where
        ``result.json`` is, everything is: it is written last. What an earlier test left there is removed.
        """
        _clear(folder)
        write_text(folder / "table.md", self.tables + "\n")
        details = [f"## {combo}\n\n```\n{text}\n```\n" for combo, text in self.texts.items()]
        write_text(folder / "details.md", "\n".join(details))
        for combo, detections in self.detections.items():
            write_detections(folder / "detections" / f"{combo}.npz", detections)
            if save_to_file:
                write_texts(folder / "final_result" / combo, detections)
        content = {"meta": self.meta, "rows": self.rows}
        for file in filter(None, (folder / RESULT, json_file)):
            write_json(file, content)


def _clear(folder: Path) -> None:
    """Remove an earlier test's result and detections, which may be of other weights and other combinations."""
    texts = (file for combo in SENSOR_SETS for file in (folder / "final_result" / combo).glob("*.txt"))
    for file in (folder / RESULT, *(folder / "detections" / f"{combo}.npz" for combo in SENSOR_SETS), *texts):
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(f"{file}: an earlier test's, cannot be removed ({error.strerror})") from error


def load_network(
    cfg: Mapping, path: Path, dataset: Any, ranks: Ranks, logger: logging.Logger, precision: str = "float32"
) -> tuple[nn.Module, dict[str, Any]]:
    """(network with the checkpoint's weights, the checkpoint's content). ``precision`` as in ``models.precision``."""
    content = read_checkpoint(path)
    model = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), dataset).to(ranks.device)
    checkpoint.load_model(model, content, path, logger)
    model.precision = chosen_precision(precision, ranks.device)
    logger.info(f"{path}: iteration {content.get('it', '?')}")
    return model.eval(), content


def run_test(
    cfg: Mapping,
    config_name: str,
    path: Path,
    combos: Sequence[str],
    ranks: Ranks,
    logger: logging.Logger,
    *,
    split: str = "test",
    batch_size: int = 1,
    workers: int = 0,
    wire: bool = False,
    started: float | None = None,
    runtime: str = TORCH,
    precision: str = "auto",
) -> BenchmarkResult:
    """Evaluate a checkpoint on a split; ``wire`` sends every roadside map through encoded bytes.

    With another runtime than torch, ``path`` is the folder of an exported network.
    """
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split=split, logger=logger)
    if runtime == TORCH:
        model, content = _load_to_test(cfg, path, dataset, ranks, logger, precision)
    else:
        model, content = load_exported(cfg, path, runtime)
    if not wire and model.codec.map_size != UNLIMITED:
        logger.warning("MODEL.COMPRESSION.MAX_BYTES holds for maps on the wire: without --wire this table is not of it")
    combos = existing_combos(dataset, combos, "--combos", logger)
    found = detect(model, dataset, combos, ranks, batch_size, workers, Wire(model.codec) if wire else None)
    rows, texts = benchmark(dataset, found, content.get(THRESHOLDS_KEY))
    seed = content.get("sampler", {}).get("seed")
    meta = provenance(cfg, config_name, seed=seed, weights_hash=content["weights_hash"], started=started)
    gains = roadside_gains(dataset, found.detections)
    meta |= _about(path, content, dataset, wire)
    meta |= {"precision": getattr(model, "precision", "float32"), "split_by": protocol_of(cfg["DATA_CONFIG"])}
    meta |= {"seen_before": content["seen_before"]} if content.get("seen_before") else {}
    return BenchmarkResult(meta, rows, texts, found.detections, gains)


def _load_to_test(
    cfg: Mapping, path: Path, dataset: Any, ranks: Ranks, logger: logging.Logger, precision: str
) -> tuple[nn.Module, dict[str, Any]]:
    """``load_network``, and in the content the weights' hash and what they have seen of ``dataset`` in training.

    Raises where they were trained on these data by another split.
    """
    model, content = load_network(cfg, path, dataset, ranks, logger, precision)
    check_same_split(content, cfg["DATA_CONFIG"], path)
    seen, weights = seen_before(content, dataset), checkpoint.weights_hash(content["model_state"])
    return model, {**content, "seen_before": seen, "weights_hash": weights}


def _about(path: Path, content: Mapping[str, Any], dataset: Any, wire: bool) -> dict[str, Any]:
    return {
        "checkpoint": content.get("checkpoint") or Path(path).name,
        "runtime": content.get("runtime") or TORCH,
        "iterations": content.get("it", content.get("iterations")),
        "trained_minutes": round(content["elapsed_s"] / 60, 1) if "elapsed_s" in content else None,
        "split": dataset.split,
        "frames": len(dataset),
        THRESHOLDS_KEY: content.get(THRESHOLDS_KEY),
        "bytes_per_map": "mean len of all segments of a map" if wire else "not measured: run with --wire",
    }


def store_driving_thresholds(
    cfg: Mapping, path: Path, ranks: Ranks, logger: logging.Logger, batch_size: int = 1, workers: int = 0
) -> dict[str, float]:
    """Choose a score threshold per class on the validation split and write it into the checkpoint; done once."""
    content = read_checkpoint(path)
    if THRESHOLDS_KEY in content:
        return content[THRESHOLDS_KEY]
    if not has_split(cfg.DATA_CONFIG, "val"):
        logger.warning("the data set has no validation split: no score thresholds for driving were chosen")
        return {}
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split="val", logger=logger)
    model, _ = load_network(cfg, path, dataset, ranks, logger)
    combos = existing_combos(dataset, None, "score thresholds", logger)
    chosen = driving_thresholds(dataset, detect(model, dataset, combos, ranks, batch_size, workers))
    if ranks.is_first:
        checkpoint.save(path, content | {THRESHOLDS_KEY: chosen})
    ranks.wait()
    logger.info("score thresholds for driving: " + ", ".join(f"{name} {score:.3f}" for name, score in chosen.items()))
    return chosen
