"""The files of DAIR-V2X-C: a side's list of frames, its calibration, and the habits of their JSON.

Numbers stand as texts in some files and as numbers in others, an absent offset is an empty text, some calibration lies
inside ``transform``, and translations are columns or rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcdet_avp.datasets.avp.fields import Field
from pcdet_avp.datasets.importers.recording import load_list, number_of, some_exist


@dataclass(frozen=True)
class Side:
    """A vehicle's or a roadside unit's frames: cloud's path as the pairs give it -> entry of data_info.json."""

    folder: Path
    chain: tuple[str, ...]  # calibration from the LiDAR to the world, by the keys of an entry
    to_camera: str
    entries: Mapping[str, Field]
    camera: bool
    lidar: bool

    @classmethod
    def open(cls, src: Path, name: str, chain: tuple[str, ...], to_camera: str) -> Side:
        folder = src / name
        rows = load_list(folder / "data_info.json")
        entries = {f"{name}/{row['pointcloud_path'].of(str)}": row for row in rows}
        camera, lidar = (
            some_exist(folder / row[key].of(str) for row in rows) for key in ("image_path", "pointcloud_path")
        )
        return cls(folder, chain, to_camera, entries, camera, lidar)

    def file(self, entry: Field, key: str) -> Path:
        return self.folder / entry[key].of(str)

    def files(self, entry: Field) -> list[Path]:
        """What a frame needs: calibration, and the sensors that the side has any file of."""
        keys = [*self.chain, *(["pointcloud_path"] if self.lidar else [])]
        keys += [self.to_camera, "calib_camera_intrinsic_path", "image_path"] if self.camera else []
        return [self.file(entry, key) for key in keys]


def entry_of(side: Side, pair: Field, key: str) -> Field:
    named = pair[f"{key}_pointcloud_path"]
    if named.of(str) not in side.entries:
        raise named.error(f"{named.value!r} is not listed in {side.folder / 'data_info.json'}")
    return side.entries[named.value]


def text(field: Field) -> str:
    """Numbers are texts in some of the files and numbers in others."""
    return str(field.value if isinstance(field.value, int) else field.of(str))


def offset_of(field: Field) -> float:
    """Metres; an empty text means none."""
    return 0.0 if field.value == "" else number_of(field)


def transform_of(file: Path) -> Field:
    """The object that holds ``rotation`` and ``translation``: the whole file, or its ``transform``."""
    top = Field.load(file)
    return top["transform"] if "transform" in top.of(dict) else top


def rotation_and_translation(top: Field) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,), which files write as a column or as a row."""
    translation = top["translation"]
    flat = np.ravel(np.asarray(translation.value, dtype=object))
    return top["rotation"].numbers(3, 3), Field(flat.tolist(), top.file, translation.name).numbers(3)
