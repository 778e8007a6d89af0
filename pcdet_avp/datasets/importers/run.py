"""Writes a foreign recording as a data set of ours. An interrupted import goes on where it stopped."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from pcdet_avp.datasets.avp.claim import claimed
from pcdet_avp.datasets.avp.fields import Field
from pcdet_avp.datasets.avp.manifest import Manifest, Scene, write_manifest
from pcdet_avp.datasets.avp.record import has_frame, write_record
from pcdet_avp.datasets.avp.splits import SPLITS, assign_splits
from pcdet_avp.datasets.importers.carla import CarlaRecording
from pcdet_avp.datasets.importers.dair_v2x import DairV2x
from pcdet_avp.datasets.importers.opv2v import Opv2v
from pcdet_avp.datasets.importers.recording import Recording, SourceScene
from pcdet_avp.errors import RecordError

FORMATS: dict[str, Callable[[Path], Recording]] = {"opv2v": Opv2v, "dair_v2x": DairV2x, "carla": CarlaRecording}
METADATA = (".json", ".yaml")
_UNNAMEABLE = re.compile(r"[^A-Za-z0-9_\-.]")


def open_recording(format_name: str, src: Path) -> Recording:
    """The recording below ``src``; RecordError where there is none of this format."""
    return FORMATS[format_name](Path(os.path.abspath(src)))  # "." has no name, and names tell scenes and splits


def import_recording(
    recording: Recording,
    format_name: str,
    out: Path,
    *,
    splits: Mapping[str, str] | None = None,
    seed: int = 0,
    skip_missing: bool = False,
) -> Manifest:
    """Write every frame below ``out``, or those that an interrupted import left.

    ``splits``: scene -> split, for every scene; without it the source's own count, and where it has none scenes are
    drawn by ``seed`` (``assign_splits``). A file that is named and absent is a RecordError before anything is
    written, or with ``skip_missing`` leaves its frame out. RecordError also where the source tells the splits of some
    scenes only, and where ``out`` holds something else, such as another recording of the same layout whose scenes and
    frames have the same names.
    """
    scenes = [_with_files(scene, recording, skip_missing) for scene in recording.scenes]
    scenes = [scene for scene in scenes if scene.frames]
    if not scenes:
        raise RecordError(f"{format_name}: no frame has all of its files")
    for scene in scenes:
        if all(file.suffix in METADATA for files in scene.frames.values() for file in files):
            raise RecordError(f"{format_name}: scene {scene.name!r} has no sensor: no picture, no cloud")
    made_by = {"IMPORT": {"FORMAT": format_name, "SOURCE_SHA256": _fingerprint(scenes)}}
    manifest = _plan(scenes, recording.class_names, made_by, splits, seed)
    with claimed(out, manifest):
        _write_frames(recording, scenes, out, manifest)
        manifest = replace(manifest, complete=True)
        write_manifest(out, manifest)
    return manifest


def _write_frames(recording: Recording, scenes: Sequence[SourceScene], out: Path, manifest: Manifest) -> None:
    """Write the frames that are not there yet."""
    total = sum(manifest.frame_counts.values())
    with tqdm(total=total, unit="frame", desc=f"importing into {out}", smoothing=0.1) as bar:
        for scene, source in zip(manifest.scenes, scenes, strict=True):
            for frame_id, frame in zip(scene.frame_ids, source.frames, strict=True):
                if not has_frame(out, frame_id):
                    imported = recording.read(source.name, frame)
                    write_record(out, replace(imported.record, frame_id=frame_id), imported.images)
                bar.update()


def _fingerprint(scenes: Sequence[SourceScene]) -> str:
    """Of the recording, wherever it lies: names and sizes of all its files, frame by frame."""
    digest = hashlib.sha256()
    for scene in scenes:
        for frame, files in scene.frames.items():
            known = " ".join(f"{file.name}:{file.stat().st_size}" for file in files)
            digest.update(f"{scene.name}/{frame} {known}\n".encode())
    return digest.hexdigest()


def _with_files(scene: SourceScene, recording: Recording, skip_missing: bool) -> SourceScene:
    """The scene without frames that lack a file; their absence is an error unless ``skip_missing``."""
    absent = {frame: next((f for f in files if not f.exists()), None) for frame, files in scene.frames.items()}
    lacking = [frame for frame, file in absent.items() if file is not None]
    if lacking and not skip_missing:
        raise RecordError(
            f"{absent[lacking[0]]}: named by the recording, but absent; {len(lacking)} of {len(absent)} frames of "
            f"scene {scene.name} lack a file (--skip_missing leaves such frames out)"
        )
    for frame in lacking:
        recording.notes.add("frame left out, because a file is absent", str(absent[frame]))
    return replace(scene, frames={frame: files for frame, files in scene.frames.items() if absent[frame] is None})


def _plan(
    scenes: Sequence[SourceScene],
    class_names: tuple[str, ...],
    made_by: dict,
    splits: Mapping[str, str] | None,
    seed: int,
) -> Manifest:
    untold = next((scene for scene in scenes if scene.split not in SPLITS), None)
    if splits is None and untold is not None and any(scene.split for scene in scenes):
        where = f"folder {untold.split!r}, which names no split" if untold.split else "no split's folder, as others do"
        raise RecordError(f"scene {untold.name!r} lies in {where}: name the splits with --splits")
    drawn = assign_splits([scene.name for scene in scenes], seed)
    named = [splits.get(s.name) if splits is not None else s.split or drawn[s.name] for s in scenes]
    if None in named:
        raise RecordError(f"the splits name no scene {scenes[named.index(None)].name!r}")
    planned = tuple(
        Scene(_name(scene.name), str(split), tuple(_name(frame) for frame in scene.frames))
        for scene, split in zip(scenes, named, strict=True)
    )
    for names in ([scene.name for scene in planned], *(scene.frames for scene in planned)):
        if len(set(names)) != len(names):
            twice = next(name for name in names if list(names).count(name) > 1)
            raise RecordError(f"two scenes, or two frames of a scene, would be called {twice!r}")
    return Manifest(planned, complete=False, seed=seed, generator=made_by, class_names=class_names)


def _name(name: str) -> str:
    """A scene's or frame's name as our folders may have it."""
    return _UNNAMEABLE.sub("-", name).lstrip(".") or "-"


def read_splits(file: Path) -> dict[str, str]:
    """scene -> split, of {"train": [scenes], "val": [...], "test": [...]}; in DAIR-V2X's file under ``batch_split``."""
    top = Field.load(file)
    lists = top["batch_split"] if "batch_split" in top.value else top
    found: dict[str, str] = {}
    for split in SPLITS:
        for scene in lists.get(split, []):
            name = str(scene.value)
            if found.setdefault(name, split) != split:
                raise scene.error(f"scene {name!r} stands in {found[name]} as well")
    return found
