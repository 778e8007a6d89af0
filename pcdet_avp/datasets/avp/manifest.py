"""``dataset.json``: what a data set holds, what made it, and which scenes belong to which split."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pcdet_avp import __version__
from pcdet_avp.datasets.avp.fields import Field, write_record_json
from pcdet_avp.datasets.avp.layout import PARTIAL_SUFFIX, SCHEMA_VERSION, check_schema, frame_dir
from pcdet_avp.datasets.avp.splits import BY_SCENE, SPLITS, assign_splits, split_shares
from pcdet_avp.errors import RecordError
from pcdet_avp.files import replacing
from pcdet_avp.structures.frame import CLASS_NAMES

MANIFEST_FILE = "dataset.json"


@dataclass(frozen=True)
class Scene:
    """A scene's name, its split and the names of its frames in order of time."""

    name: str
    split: str
    frames: tuple[str, ...]

    @property
    def frame_ids(self) -> list[str]:
        return [f"{self.name}/{frame}" for frame in self.frames]


def planned_scenes(generate: Mapping[str, Any], seed: int, frames: int) -> tuple[Scene, ...]:
    """The scenes of a data set of so many frames that GENERATE describes, each with its split."""
    per_scene = generate["FRAMES_PER_SCENE"]
    names = [f"{number:04d}" for number in range(math.ceil(frames / per_scene))]
    splits = assign_splits(names, seed, *split_shares(generate))
    frame_names = [f"{number:03d}" for number in range(per_scene)]
    return tuple(Scene(n, splits[n], tuple(frame_names[: frames - i * per_scene])) for i, n in enumerate(names))


@dataclass(frozen=True)
class Manifest:
    """The content of ``dataset.json``. ``complete`` is false until every frame that it lists has been written."""

    scenes: tuple[Scene, ...]
    complete: bool = True
    seed: int | None = None
    generator: dict = field(default_factory=dict)  # the configuration that made the data
    package_version: str = __version__
    class_names: tuple[str, ...] = CLASS_NAMES

    def frame_ids(self, split: str, protocol: str = BY_SCENE) -> list[str]:
        """Every frame of one split, scene by scene; ``protocol``: DATA_CONFIG.SPLIT_BY."""
        if split not in SPLITS:
            raise RecordError(f"{MANIFEST_FILE}: unknown split {split!r}; known: {', '.join(SPLITS)}")
        if protocol == BY_SCENE:
            return [frame_id for scene in self.scenes if scene.split == split for frame_id in scene.frame_ids]
        return [frame_id for frame_id, drawn in self._drawn_by_frame().items() if drawn == split]

    def _drawn_by_frame(self) -> dict[str, str]:
        """frame id -> split, scene by scene: a permutation of all frames by the data set's seed (0 where it has none
        that is a whole number), with the shares that its scenes were split by (GENERATE.SPLIT)."""
        frame_ids = [frame_id for scene in self.scenes for frame_id in scene.frame_ids]
        shares = split_shares(self.generator.get("GENERATE") or {})
        seed = self.seed if isinstance(self.seed, int) and self.seed >= 0 else 0
        drawn = assign_splits(frame_ids, seed, *shares)
        return {frame_id: drawn[frame_id] for frame_id in frame_ids}

    @property
    def frame_counts(self) -> dict[str, int]:
        """Frames per split."""
        return {split: len(self.frame_ids(split)) for split in SPLITS}


def write_manifest(root: str | Path, manifest: Manifest) -> None:
    """Write ``dataset.json``, whole and on the disk; RecordError if it cannot be written."""
    file = Path(root) / MANIFEST_FILE
    partial = file.with_name(f".{MANIFEST_FILE}{PARTIAL_SUFFIX}")
    with replacing(file, aside=partial, sync=True, error=RecordError):
        write_record_json(partial, _content(manifest))


def _content(manifest: Manifest) -> dict:
    return {
        "schema_version": SCHEMA_VERSION,
        "package_version": manifest.package_version,
        "complete": manifest.complete,
        "seed": manifest.seed,
        "generator": manifest.generator,
        "class_names": list(manifest.class_names),
        "frame_counts": manifest.frame_counts,
        "scenes": [{"name": s.name, "split": s.split, "frames": list(s.frames)} for s in manifest.scenes],
    }


def read_manifest(root: str | Path) -> Manifest:
    """Read and check ``dataset.json``; fields that a foreign exporter cannot know are optional."""
    top = Field.load(Path(root) / MANIFEST_FILE)
    check_schema(top)
    return Manifest(
        scenes=_scenes(top["scenes"]),
        complete=top.get("complete", True).of(bool),
        seed=top.get("seed").value,
        generator=top.get("generator", {}).of(dict),
        package_version=top.get("package_version", "unknown").of(str),
        class_names=_class_names(top["class_names"]),
    )


def manifest_hash(root: str | Path) -> str:
    """SHA-256 of ``dataset.json``, which tells data sets apart whose frames have the same names."""
    file = Path(root) / MANIFEST_FILE
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError as error:
        raise RecordError(f"{file}: cannot be read ({error.strerror})") from error


def _scenes(entries: Field) -> tuple[Scene, ...]:
    scenes, seen = [], set()
    for entry in entries:
        name, split = entry["name"].of(str), entry["split"].of(str)
        if name in seen:
            raise entry["name"].error(f"scene {name!r} is listed twice; a scene belongs to one split")
        if split not in SPLITS:
            raise entry["split"].error(f"expected one of {', '.join(SPLITS)}, found {split!r}")
        seen.add(name)
        scene = Scene(name, split, tuple(frame.of(str) for frame in entry["frames"]))
        if len(set(scene.frames)) != len(scene.frames):
            raise entry["frames"].error("a frame is listed twice")
        for frame_id in scene.frame_ids:
            frame_dir(entries.file.parent, frame_id)  # refuses names that are none
        scenes.append(scene)
    return tuple(scenes)


def _class_names(field: Field) -> tuple[str, ...]:
    names = tuple(name.of(str) for name in field)
    unknown = [name for name in names if name not in CLASS_NAMES]
    if unknown:
        raise field.error(f"unknown class {unknown[0]!r}; known: {', '.join(CLASS_NAMES)}")
    return names
