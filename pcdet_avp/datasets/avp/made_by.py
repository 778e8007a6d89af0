"""Whether the data on disk are what a configuration describes: no others are trained or tested on unnoticed."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pcdet_avp.config import plain
from pcdet_avp.config_scenes import completed
from pcdet_avp.datasets.avp.manifest import MANIFEST_FILE, Manifest
from pcdet_avp.errors import RecordError

PARTS = ("SENSORS", "GENERATE")  # of DATA_CONFIG: what the generator makes data from
SEED, PLAN = "GENERATE.SEED", "GENERATE.PLAN"
BESIDE = ("GENERATE.SCENES", "GENERATE.SPLIT", "GENERATE.SOURCES")  # which of the scenes and sensors, not what they are


def check_made_by(manifest: Manifest, dataset_cfg: Mapping, root: Path) -> None:
    """RecordError naming every key of SENSORS and GENERATE that the data were made with another value of.

    Recordings that say nothing of a generator, and configurations without these sections, pass. The seed may also be
    the one that tools/create_data.py was told by --seed.
    """
    unlike = _unlike(manifest, dataset_cfg, PARTS)
    if unlike:
        raise RecordError(_message(root / MANIFEST_FILE, unlike))


def describes(dataset_cfg: Mapping, manifest: Manifest) -> bool:
    """Whether GENERATE of a configuration makes the scenes of a data set; how many, their splits and which sensors are
    captured may differ. Published weights know of a plan no more than its file's name."""
    return all(
        key.startswith(BESIDE) or (key == PLAN and _one_is_the_others_name(found, said))
        for key, found, said in _unlike(manifest, dataset_cfg, ("GENERATE",))
    )


def _one_is_the_others_name(found: Any, said: Any) -> bool:
    return isinstance(found, str) and isinstance(said, str) and (Path(found).name == said or Path(said).name == found)


def _unlike(manifest: Manifest, dataset_cfg: Mapping, parts: tuple[str, ...]) -> list[tuple[str, Any, Any]]:
    """Key, value that the data were made with, and the configuration's, of what differs."""
    differences = []
    for part in parts:
        if part in manifest.generator and part in dataset_cfg:
            ours, theirs = complete(dataset_cfg)[part], complete(manifest.generator)[part]
            differences += _differences(theirs, ours, part)
    return [(key, found, said) for key, found, said in differences if key != SEED or said != manifest.seed]


def complete(made_from: Mapping) -> dict:
    """SENSORS and GENERATE as plain values; settings of generated scenes that are absent have their defaults."""
    parts = {part: plain(made_from[part]) for part in PARTS if part in made_from}
    return {**parts, "GENERATE": completed(parts["GENERATE"])} if parts.get("GENERATE") else parts


def _message(file: Path, unlike: list[tuple[str, Any, Any]]) -> str:
    values = "; ".join(f"DATA_CONFIG.{key} {found!r}, the configuration says {said!r}" for key, found, said in unlike)
    as_made = " ".join(f"DATA_CONFIG.{key} {_argument(found)}" for key, found, _ in unlike)
    return (
        f"{file}: these data were made with {values}; make new ones in another folder (--set DATA_CONFIG.DATA_PATH "
        f"DIR), or say what these are (--set {as_made})"
    )


def _argument(value: Any) -> str:
    """As --set reads it from a shell."""
    return shlex.quote(json.dumps(value))


def _differences(theirs: Any, ours: Any, key: str) -> list[tuple[str, Any, Any]]:
    """Key, value there and here; an empty section and none at all are the same."""
    if isinstance(theirs, dict) and isinstance(ours, dict):
        names = [*theirs, *(name for name in ours if name not in theirs)]
        parts = [_differences(theirs.get(name), ours.get(name), f"{key}.{name}") for name in names]
        return [difference for part in parts for difference in part]
    same = theirs == ours or (None in (theirs, ours) and {} in (theirs, ours))
    return [] if same else [(key, theirs, ours)]
