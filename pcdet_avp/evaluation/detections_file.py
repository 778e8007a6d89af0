"""Detections on disk, for later: what OpenPCDet keeps as ``result.pkl``, without pickle; and one text per frame.

An .npz file holds boxes_lidar (M, 7) float32, name (M,) text, score (M,) float32, frame (M,) index into
frame_id (F,) text, where every frame stands even if nothing was found in it.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation.inputs import Detections
from pcdet_avp.files import flat_name, write_bytes, write_text

FIELDS = ("frame_id", "frame", "boxes_lidar", "name", "score")


def write_detections(path: Path, detections: Sequence[Detections]) -> None:
    """Write one .npz file; OutputError if it cannot be written."""
    rows = [len(found.boxes) for found in detections]
    nothing = Detections("", np.zeros((0, 7)), np.zeros(0, str), np.zeros(0))
    columns = [(d.boxes, d.names, d.scores) for d in (nothing, *detections)]
    boxes, names, scores = (np.concatenate(column) for column in zip(*columns, strict=True))
    content = io.BytesIO()
    np.savez_compressed(
        content,
        frame_id=np.array([found.frame_id for found in detections], str),
        frame=np.repeat(np.arange(len(rows)), rows),
        boxes_lidar=boxes.astype(np.float32),
        name=names.astype(str),
        score=scores.astype(np.float32),
    )
    write_bytes(path, content.getvalue())


def read_detections(path: Path) -> list[Detections]:
    """What ``write_detections`` wrote; EvaluationError where that is not it."""
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {key: file[key] for key in FIELDS}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise EvaluationError(f"{path}: not a file of detections ({error})") from error
    rows = [content["frame"] == i for i in range(len(content["frame_id"]))]
    return [
        Detections(str(frame_id), *(content[key][mask] for key in FIELDS[2:]))
        for frame_id, mask in zip(content["frame_id"], rows, strict=True)
    ]


def write_texts(folder: Path, detections: Sequence[Detections]) -> None:
    """``folder/scene_frame.txt`` (``files.flat_name``): class, score, x y z dx dy dz heading (m, rad), one a line."""
    for found in detections:
        file = folder / f"{flat_name(found.frame_id)}.txt"
        rows = zip(found.names, found.scores, found.boxes, strict=True)
        text = "".join(f"{name} {score:.4f} {' '.join(f'{v:.4f}' for v in box)}\n" for name, score, box in rows)
        write_text(file, text)
