"""What the reader of a foreign layout gives, and the checks that all of them share."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from pcdet_avp.datasets.avp.fields import Field
from pcdet_avp.datasets.avp.image_files import decode_image, is_jpeg
from pcdet_avp.datasets.avp.units import Record
from pcdet_avp.datasets.point_clouds.read import read_cloud
from pcdet_avp.errors import GeometryError, RecordError
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.frame import Labels
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SOURCES

T = TypeVar("T")
SEEN_BY_ALL = 8  # visible vertices of a label whose visibility nobody recorded


@dataclass(frozen=True)
class SourceScene:
    """A scene: frames in order of time, with the files that each needs, and the split where the source tells it."""

    name: str
    frames: Mapping[str, Sequence[Path]]
    split: str | None = None


@dataclass(frozen=True, eq=False)
class Imported:
    """A record, and the files (PNG or JPEG) that its images were decoded from: agent's name -> bytes."""

    record: Record
    images: Mapping[str, bytes]


@dataclass
class Notes:
    """What was left out or repaired: counted, with the first place where it happened, and told when the import ends."""

    counts: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def add(self, what: str, where: str | Path) -> None:
        self.counts[what] += 1
        self.first.setdefault(what, str(where))

    def lines(self) -> list[str]:
        """One line a kind."""
        return [f"{count} x {what} (first: {self.first[what]})" for what, count in sorted(self.counts.items())]


class Recording(Protocol):
    """A foreign recording, opened. ``class_names``: the classes whose every object is labelled."""

    class_names: tuple[str, ...]
    scenes: Sequence[SourceScene]
    notes: Notes

    def read(self, scene: str, frame: str) -> Imported:
        """One frame; RecordError names the file and what is wrong with it."""
        ...


@dataclass(frozen=True, eq=False)
class WorldBox:
    """An object of the source: id, our class, box (7,) in our axes in the world."""

    object_id: int
    name: str
    box: np.ndarray


def labels_in_ego(world_from_ego: Pose, boxes: Sequence[WorldBox]) -> Labels:
    """Ground truth in the ego frame; how many vertices are visible, and how many points hit, nobody recorded."""
    if not boxes:
        return Labels.empty()
    moved = transform_boxes(world_from_ego.inverse(), np.stack([b.box for b in boxes]))
    return Labels(
        moved,
        np.array([b.name for b in boxes]),
        np.array([b.object_id for b in boxes], np.int64),
        np.full(len(boxes), SEEN_BY_ALL),
        np.zeros((len(boxes), len(SOURCES)), np.int64),
    )


def number_of(field: Field) -> float:
    """A finite number that the source may have written as a text."""
    try:
        return Field(float(field.value), field.file, field.name).number()
    except (TypeError, ValueError) as error:
        raise field.error(f"expected a number, found {field.value!r}") from error


def by_number(name: str) -> list[str | int]:
    """Sorts names by the numbers in them: ``tick_9`` before ``tick_10``."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]


def folder_of(src: Path) -> Path:
    """The folder to import; RecordError where there is none."""
    if not src.is_dir():
        raise RecordError(f"{src}: expected the folder of a recording, found {'a file' if src.exists() else 'nothing'}")
    return src


def subfolders(folder: Path) -> list[Path]:
    """Folders below one, by name; hidden ones left out."""
    return sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))


def read_points(file: Path, columns: int | None = None, intensity_scale: float | None = None) -> np.ndarray:
    """(P, 4) float32 x, y, z, intensity in [0, 1], in the LiDAR's own axes."""
    return read_cloud(file, columns, intensity_scale).points


def load_list(file: Path) -> list[Field]:
    """The objects of a JSON file that is a list."""
    try:
        value = json.loads(read_bytes(file).decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise RecordError(f"{file}: damaged or cut short, not JSON ({error})") from error
    return list(Field(value, file))


def read_bytes(file: Path) -> bytes:
    """The content of a file that the recording names."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise RecordError(f"{file}: cannot be read ({error.strerror})") from error


def read_image(file: Path) -> tuple[np.ndarray, bytes]:
    """(H, W, 3) uint8 RGB, and the file's bytes; RecordError where it is damaged."""
    data = read_bytes(file)
    return decode_image(data, file), data


def read_raw_depth(file: Path, far_m: float = 1000.0) -> np.ndarray:
    """(H, W) float32 metres of CARLA's raw depth picture: (R + 256 G + 65536 B) / (256^3 - 1) of ``far_m``.

    RecordError where it is damaged, or was saved in another way than raw: as a JPEG, or in grey, which is what CARLA's
    colour converters write.
    """
    data = read_bytes(file)
    if is_jpeg(data):
        raise RecordError(f"{file}: a depth picture must be a PNG; in a JPEG the distances are lost")
    picture = decode_image(data, file)
    red, green, blue = (picture[..., i].astype(np.float64) for i in range(3))
    if np.array_equal(red, green) and np.array_equal(red, blue) and ((red > 0) & (red < 255)).any():
        raise RecordError(f"{file}: grey throughout: save depth raw (carla.ColorConverter.Raw), expected R, G and B")
    return ((red + 256 * green + 65536 * blue) * (far_m / (256**3 - 1))).astype(np.float32)


def placed(where: Field | Path, make: Callable[..., T], *args) -> T:
    """``make(*args)``; a GeometryError becomes a RecordError that names the file and the field."""
    if isinstance(where, Field):
        return where.build(make, *args)
    try:
        return make(*args)
    except GeometryError as error:
        raise RecordError(f"{where}: {error}") from error


def some_exist(files: Iterable[Path]) -> bool:
    """Whether any of these files is there: if none is, the recording lacks the sensor; if some are, all are needed."""
    return any(file.exists() for file in files)
