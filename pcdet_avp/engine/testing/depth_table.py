"""Depth errors on road users by distance, from the cameras' depth distributions: the result of depth training."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.splits import BY_SCENE, protocol_line, protocol_of
from pcdet_avp.engine import checkpoint
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.loader import batches
from pcdet_avp.engine.same_split import check_same_split, seen_before
from pcdet_avp.files import write_json, write_text
from pcdet_avp.models import build_network
from pcdet_avp.models.encoders.depth_branch import depth_truth
from pcdet_avp.models.encoders.encoder import present_rows, suffix_of
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint
from pcdet_avp.provenance import provenance
from pcdet_avp.structures.sensor_set import agent_of

DISTANCE_EDGES_M = (0.0, 10.0, 20.0, 30.0, 47.0)  # along the optical axis
CLOSE_M = 0.3
ALL_CAMERAS = "C+C"
HEADER = (
    "| camera | depth (m) | pixels | median error (m) | 80 % below (m) | median error (image pixels) | within 0.3 m |\n"
    "|---|---|---|---|---|---|---|"
)


@dataclass(frozen=True)
class DepthErrors:
    """Errors at the feature pixels on road users: true depth (P,) m, error (P,) m, and error in image pixels (P,)."""

    depth_m: np.ndarray
    error_m: np.ndarray
    error_px: np.ndarray

    @classmethod
    def joined(cls, parts: list[DepthErrors]) -> DepthErrors:
        """All of them, one after the other."""
        columns = ("depth_m", "error_m", "error_px")
        return cls(*(np.concatenate([np.zeros(0), *(getattr(p, name) for p in parts)]) for name in columns))

    def rows(self, source: str) -> list[dict[str, Any]]:
        """One row per interval of DISTANCE_EDGES_M, its numbers null where it has no pixel."""
        rows = []
        for low, high in pairwise(DISTANCE_EDGES_M):
            inside = (self.depth_m >= low) & (self.depth_m < high)
            numbers = _summary(self.error_m[inside], self.error_px[inside]) if inside.any() else dict.fromkeys(NUMBERS)
            rows.append({"source": source, "depth_m": [low, high], "pixels": int(inside.sum())} | numbers)
        return rows


NUMBERS = ("median_m", "p80_m", "median_px", "within_0.3m")


def _summary(error_m: np.ndarray, error_px: np.ndarray) -> dict[str, float]:
    values = np.median(error_m), np.percentile(error_m, 80), np.median(error_px), (error_m <= CLOSE_M).mean()
    return {name: round(float(value), 4) for name, value in zip(NUMBERS, values, strict=True)}


def floor_pixels(depth: Tensor, estimate: Tensor, to_cam: Tensor, to_img: Tensor) -> Tensor:
    """How many image pixels apart the rows are in which a floor point of either depth appears.

    depth and estimate (P,) metres along the optical axis; to_cam (P, 4, 4) from the agent's frame, whose floor is
    z = 0; to_img (P, 3, 4). A camera at height h, pitched down by p, sees the floor at depth Z in row
    cy + f (h / Z - sin p) / cos p.
    """
    agent_from_cam = torch.linalg.inv(to_cam.double())
    height, sine = agent_from_cam[:, 2, 3], -agent_from_cam[:, 2, 2]
    focal = to_img[:, 1, 1].double()
    return focal * height / (1 - sine**2).sqrt() * (1 / estimate.double() - 1 / depth.double()).abs()


@torch.no_grad()
def depth_errors(
    model: nn.Module, dataset: Any, ranks: Ranks, batch_size: int = 1, workers: int = 0
) -> dict[str, DepthErrors]:
    """Depth errors of each camera over the split; ``model`` is a ``CameraDepth`` network. Ranks share the frames."""
    model.eval()
    mine: dict[str, list[DepthErrors]] = {source: [] for source in model.sources}
    frames = range(ranks.rank, len(dataset), ranks.world)
    keys = [[(i, ALL_CAMERAS) for i in frames[at : at + batch_size]] for at in range(0, len(frames), batch_size)]
    with tqdm(total=len(dataset), unit="frame", desc=f"depth on {dataset.split}", disable=not ranks.is_first) as bar:
        for batch_dict in batches(dataset, keys, ranks, workers):
            for source, errors in _of_batch(model, batch_dict):
                mine[source].append(errors)
            bar.update(int(batch_dict["batch_size"]) * ranks.world)
    parts = ranks.gather(mine)
    return {source: DepthErrors.joined([e for part in parts for e in part[source]]) for source in model.sources}


def _of_batch(model: nn.Module, batch_dict: dict) -> Iterator[tuple[str, DepthErrors]]:
    for source, estimate in model(batch_dict)[0].items():
        rows, suffix = present_rows(batch_dict, source), suffix_of(source)
        crop_px = model.encoder_of(source).crop_px[agent_of(source)]
        depth, on_users = depth_truth(batch_dict, source, rows, tuple(estimate.shape[1:]), crop_px)
        image = rows[on_users.nonzero()[:, 0]]
        calibration = (batch_dict[key + suffix][image] for key in ("trans_lidar_to_cam", "trans_cam_to_img"))
        depth, estimate = depth[on_users], estimate[on_users]
        columns = depth, (estimate - depth).abs(), floor_pixels(depth, estimate, *calibration)
        yield source, DepthErrors(*(column.double().cpu().numpy() for column in columns))


def _load(cfg: Mapping, path: Path, dataset: Any, ranks: Ranks) -> tuple[nn.Module, dict[str, Any]]:
    """(network, the checkpoint's content); what a whole network has besides is left out, nothing may be missing."""
    content = read_checkpoint(path)
    check_same_split(content, cfg["DATA_CONFIG"], path)
    model = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), dataset).to(ranks.device)
    own = {key: value for key, value in content["model_state"].items() if key in model.state_dict()}
    checkpoint.load_model(model, {**content, "model_state": own}, path)
    return model, content


@dataclass(frozen=True)
class DepthResult:
    """Rows of the depth table, and where they come from."""

    meta: dict[str, Any]
    rows: list[dict[str, Any]]

    @property
    def tables(self) -> str:
        """The table in Markdown."""
        title = f"Depth errors of {self.meta['config']} on road users, {self.meta['frames']} frames"
        protocol = protocol_line(self.meta["split"], self.meta.get("split_by", BY_SCENE))
        return "\n".join([title, protocol, "", HEADER, *map(_line, self.rows)])

    @property
    def scalars(self) -> dict[str, float]:
        """The medians in metres, named for TensorBoard."""
        names = {f"depth/{row['source']}/{row['depth_m'][0]:.0f}-{row['depth_m'][1]:.0f}": row for row in self.rows}
        return {name: row["median_m"] for name, row in names.items() if row["pixels"]}

    def write(self, folder: Path, json_file: Path | None = None) -> None:
        """``depth.json`` and ``depth.md`` into a folder; the JSON also to a file of its own."""
        for file in filter(None, (folder / "depth.json", json_file)):
            write_json(file, {"meta": self.meta, "rows": self.rows})
        write_text(folder / "depth.md", self.tables + "\n")


def _line(row: Mapping[str, Any]) -> str:
    low, high = row["depth_m"]
    start = f"| {row['source']} | {low:.0f}-{high:.0f} | {row['pixels']} |"
    if not row["pixels"]:
        return f"{start} - | - | - | - |"
    errors = " | ".join(f"{row[name]:.2f}" for name in NUMBERS[:3])
    return f"{start} {errors} | {100 * row['within_0.3m']:.1f} % |"


def run_depth_test(
    cfg: Mapping,
    config_name: str,
    path: Path,
    ranks: Ranks,
    logger: logging.Logger,
    *,
    split: str = "val",
    batch_size: int = 1,
    workers: int = 0,
    started: float | None = None,
) -> DepthResult:
    """The depth table of a checkpoint of a ``CameraDepth`` network, or of a whole network with the same encoders."""
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split=split, logger=logger)
    model, content = _load(cfg, path, dataset, ranks)
    if seen := seen_before(content, dataset):
        logger.warning(seen)
    dataset.sources = model.sources
    errors = depth_errors(model, dataset, ranks, batch_size, workers)
    weights = checkpoint.weights_hash(content["model_state"])
    seed = content.get("sampler", {}).get("seed")
    meta = provenance(cfg, config_name, seed=seed, weights_hash=weights, started=started)
    meta |= {"checkpoint": Path(path).name, "iterations": content.get("it")}
    meta |= {"split": split, "split_by": protocol_of(cfg["DATA_CONFIG"]), "frames": len(dataset)}
    return DepthResult(meta, [row for source, of_source in errors.items() for row in of_source.rows(source)])
