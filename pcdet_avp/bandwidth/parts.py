"""Results of single frames on disk, so that a study goes on where it stopped. Each file appears whole or not at all."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pcdet_avp.bandwidth.frame_runner import FrameResult
from pcdet_avp.bandwidth.late_fusion import Boxes
from pcdet_avp.bandwidth.transmit import Sent
from pcdet_avp.config import config_hash
from pcdet_avp.datasets.avp.manifest import MANIFEST_FILE, manifest_hash
from pcdet_avp.files import flat_name, write_bytes


def key_of(cfg: Mapping, data_root: Path, weights: str, *conditions: Any) -> str:
    """Eight digits that change with anything that changes the result of a frame; for the name of a folder.

    The configuration's hash does not tell where the data lie, and frames of two data sets have the same names. Data
    without a manifest are known by their place.
    """
    data = manifest_hash(data_root) if (data_root / MANIFEST_FILE).exists() else str(data_root.absolute())
    known = config_hash(cfg), data, weights, conditions
    return hashlib.sha256(repr(known).encode()).hexdigest()[:8]


class Parts:
    """A folder with a file per frame; ``combos`` and ``labels`` give the order of the detections in a file."""

    def __init__(self, folder: Path, combos: Sequence[str], labels: Sequence[str]) -> None:
        self.folder, self.combos = folder, list(combos)
        self.keys = [(combo, label) for combo in combos for label in labels]

    def save(self, frame_id: str, result: FrameResult) -> None:
        """Write a frame's result aside and move it into place; a combination may lack a roadside list."""
        nothing = _boxes(np.zeros((0, 9), np.float32))
        lists = [result.found[key] for key in self.keys]
        lists += [result.roadside.get(combo, nothing) for combo in self.combos]
        buffer = io.BytesIO()
        rows, counts = np.concatenate([_rows(boxes) for boxes in lists]), [len(boxes.scores) for boxes in lists]
        np.savez_compressed(buffer, rows=rows, counts=counts, sent=json.dumps(_plain(result)))
        write_bytes(self._file(frame_id), buffer.getvalue())

    def load(self, frame_id: str) -> FrameResult | None:
        """A frame's result, or None where it has to be computed (again)."""
        try:
            with np.load(self._file(frame_id)) as content:
                rows, counts, sent = content["rows"], content["counts"], json.loads(str(content["sent"]))
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            return None
        lists = [_boxes(part) for part in np.split(rows, np.cumsum(counts)[:-1])]
        found = dict(zip(self.keys, lists, strict=False))
        roadside = dict(zip(self.combos, lists[len(self.keys) :], strict=True))
        by_label = {
            label: {source: Sent(**numbers) for source, numbers in of_label.items()}
            for label, of_label in sent["sent"].items()
        }
        blocks = {int(mcs): of_mcs for mcs, of_mcs in sent["blocks"].items()}
        return FrameResult(found, roadside, by_label, blocks)

    def _file(self, frame_id: str) -> Path:
        return self.folder / f"{flat_name(frame_id)}.npz"


def _rows(boxes: Boxes) -> np.ndarray:
    """(n, 9) float32: box, score, label."""
    return torch.cat([boxes.boxes, boxes.scores[:, None], boxes.labels[:, None]], 1).float().cpu().numpy()


def _boxes(rows: np.ndarray) -> Boxes:
    return Boxes(torch.from_numpy(rows[:, :7]), torch.from_numpy(rows[:, 7]), torch.from_numpy(rows[:, 8]).long())


def _plain(result: FrameResult) -> dict:
    sent = {label: {s: asdict(numbers) for s, numbers in of_label.items()} for label, of_label in result.sent.items()}
    return {"sent": sent, "blocks": result.blocks}
