"""Folders of records: one ``Record`` per folder ``scenes/<scene>/<frame>`` (README.md beside this file).

A folder appears whole or not at all: it is written under another name beside its place and then renamed.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from pcdet_avp.datasets.avp.fields import Field
from pcdet_avp.errors import RecordError

SCHEMA_VERSION = 2  # what is written
READ_VERSIONS = (1, 2)  # 1: one roadside unit under the key "infra" instead of the list "roadside_units"
SCENES_DIR = "scenes"
FRAME_FILE = "frame.json"
RANGE_IMAGE, POINT_LIST = "range_image", "points"
# Ends the name of a folder that is still being written; it begins with a dot.
PARTIAL_SUFFIX = ".partial"

_NAME = re.compile(r"[A-Za-z0-9_\-][A-Za-z0-9_.\-]*")


def frame_dir(root: str | Path, frame_id: str) -> Path:
    """The folder of a frame named ``scene/frame``."""
    parts = frame_id.split("/")
    if len(parts) != 2 or not all(_NAME.fullmatch(part) for part in parts):
        raise RecordError(
            f"{root}: frame id must be 'scene/frame' of letters, digits, _, - and inner dots, found {frame_id!r}"
        )
    return Path(root) / SCENES_DIR / parts[0] / parts[1]


def has_frame(root: str | Path, frame_id: str) -> bool:
    """Whether a frame is there with every file at its recorded size (a power cut may leave files empty)."""
    folder = frame_dir(root, frame_id)
    try:
        files = Field.load(folder / FRAME_FILE)["files"]
        return all((folder / name).stat().st_size == files[name]["bytes"].of(int) for name in files.of(dict))
    except (RecordError, OSError):
        return False


def clean_leftovers(root: str | Path) -> int:
    """Remove the unfinished folders of a killed run, while no other run is writing; returns how many there were."""
    leftovers = [p for p in (Path(root) / SCENES_DIR).glob(f"*/.*{PARTIAL_SUFFIX}") if p.is_dir()]
    for folder in leftovers:
        try:
            shutil.rmtree(folder)
        except OSError as error:
            raise RecordError(f"{folder}: cannot remove this unfinished frame ({error.strerror})") from error
    return len(leftovers)


def check_schema(top: Field) -> int:
    """The schema version of a file; a version that is not read is an error."""
    found = top["schema_version"].of(int)
    if found not in READ_VERSIONS:
        known = " and ".join(map(str, READ_VERSIONS))
        raise top["schema_version"].error(f"this package reads schema versions {known}, found {found}")
    return found
