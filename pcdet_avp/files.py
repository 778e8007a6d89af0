"""Files that are written whole or not at all, also where a process is killed; ConfigError where they cannot be."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from typing import Any

from pcdet_avp.errors import ConfigError


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, where they are not there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot make this folder ({error.strerror})") from error


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file aside and move it into place; its folder is made."""
    aside = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        aside.write_bytes(content)
        os.replace(aside, path)
    except OSError as error:
        with suppress(OSError):
            aside.unlink()
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from error


def write_text(path: Path, text: str) -> None:
    """As ``write_bytes``, in UTF-8."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: Path, content: Any) -> None:
    """As ``write_bytes``; NaN is a bug here."""
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def flat_name(frame_id: str) -> str:
    """A file's name for ``scene/frame``, another one for every other such id: ``scene_frame``.

    Where the frame's own name holds ``_``, the slash becomes ``@``, so that ``lot_a/1`` and ``lot/a_1`` stay apart.
    """
    scene, _, frame = frame_id.replace("%", "%25").replace("@", "%40").rpartition("/")
    plain = scene and "/" not in scene and "_" not in frame
    return f"{scene}_{frame}" if plain else "@".join(filter(None, [scene.replace("/", "@"), frame]))


def unlike_names(files: Sequence[Path]) -> list[str]:
    """A name for each of some files: its stem where no other has it, else its whole name, else that with a number.

    Upper case makes no name different, because on some file systems it does not.
    """
    stems = Counter(file.stem.lower() for file in files)
    taken: set[str] = set()
    names = []
    for file in files:
        stem = [file.stem] if stems[file.stem.lower()] == 1 else []
        candidates = chain(stem, [file.name], (f"{file.name}_{i}" for i in count(2)))
        names.append(next(name for name in candidates if name.lower() not in taken))
        taken.add(names[-1].lower())
    return names
