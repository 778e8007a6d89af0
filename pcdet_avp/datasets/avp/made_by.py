"""Whether the data on disk are what a configuration describes: no others are trained or tested on unnoticed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pcdet_avp.config import plain
from pcdet_avp.config_scenes import completed
from pcdet_avp.datasets.avp.manifest import MANIFEST_FILE, Manifest
from pcdet_avp.errors import RecordError

PARTS = ("SENSORS", "GENERATE")  # of DATA_CONFIG: what the generator makes data from
SEED = "GENERATE.SEED"


def check_made_by(manifest: Manifest, dataset_cfg: Mapping, root: Path) -> None:
    """RecordError for the first key of SENSORS or GENERATE that the data were made with another value of.

    Recordings that say nothing of a generator, and configurations without these sections, pass. The seed may also be
    the one that tools/create_data.py was told by --seed.
    """
    for part in PARTS:
        if part in manifest.generator and part in dataset_cfg:
            ours, theirs = complete(dataset_cfg)[part], complete(manifest.generator)[part]
            for key, found, expected in _differences(theirs, ours, part):
                if key != SEED or expected != manifest.seed:
                    raise RecordError(_message(root / MANIFEST_FILE, key, found, expected))


def complete(made_from: Mapping) -> dict:
    """SENSORS and GENERATE as plain values; settings of generated scenes that are absent have their defaults."""
    parts = {part: plain(made_from[part]) for part in PARTS if part in made_from}
    return {**parts, "GENERATE": completed(parts["GENERATE"])} if parts.get("GENERATE") else parts


def _message(file: Path, key: str, found: Any, expected: Any) -> str:
    return (
        f"{file}: these data were made with DATA_CONFIG.{key} {found!r}, the configuration says {expected!r}; make new "
        f"ones in another folder (--set DATA_CONFIG.DATA_PATH DIR), or say what these are (--set DATA_CONFIG.{key})"
    )


def _differences(theirs: Any, ours: Any, key: str) -> list[tuple[str, Any, Any]]:
    """Key, value there and here; an empty section and none at all are the same."""
    if isinstance(theirs, dict) and isinstance(ours, dict):
        names = [*theirs, *(name for name in ours if name not in theirs)]
        parts = [_differences(theirs.get(name), ours.get(name), f"{key}.{name}") for name in names]
        return [difference for part in parts for difference in part]
    same = theirs == ours or (None in (theirs, ours) and {} in (theirs, ours))
    return [] if same else [(key, theirs, ours)]
