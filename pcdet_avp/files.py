"""Files that are written whole or not at all, also if the process is killed; OutputError if they cannot be written."""

from __future__ import annotations

import errno
import json
import os
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain, count
from pathlib import Path
from typing import Any

from pcdet_avp.errors import AvpError, OutputError

_made: list[Path] = []  # folders that this process made, the outer ones first


def mkdir(folder: Path) -> None:
    """Make a folder and its parents, if they do not exist; OSError as ``Path.mkdir``.

    ``remove_empty_folders`` knows those that were made.
    """
    folder = Path(os.path.abspath(folder))
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    _made.extend(reversed(missing))


def remove_empty_folders() -> None:
    """Remove the folders that this process made and left empty; for a tool that ends in an error."""
    while _made:
        with suppress(OSError):
            _made.pop().rmdir()


def make_folder(folder: Path) -> None:
    """Make a folder and its parents, if they do not exist."""
    try:
        mkdir(folder)
    except OSError as error:
        raise OutputError(f"{folder}: cannot make this folder ({error.strerror})") from error


def check_writable(path: Path) -> None:
    """OutputError where no file of this name can be written; for long work, before it begins. Makes the folder."""
    make_folder(path.parent)
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise OutputError(f"{path}: cannot write this file ({error.strerror})") from error


@contextmanager
def replacing(
    path: Path, *, aside: Path | None = None, sync: bool = False, error: type[AvpError] = OutputError
) -> Iterator[Path]:
    """Yield the path of a new file beside ``path``, which takes its place when the block ends; the folder is made.

    If the block raises, ``path`` stays as it was and the new file is removed; an OSError becomes an ``error`` that
    names ``path``. ``aside`` is another name for the new file, in the same folder. ``sync``: file and renaming are on
    the disk when the block ends, so that they survive a power cut.
    """
    aside = aside or path.with_name(f"{path.name}.{os.getpid()}.tmp")
    try:
        mkdir(path.parent)
        yield aside
        if sync:
            _sync(aside)
        os.replace(aside, path)
        if sync and os.name == "posix":
            _sync(path.parent)
    except OSError as problem:
        raise error(f"{path}: cannot be written ({problem.strerror or problem})") from problem
    finally:
        with suppress(OSError):
            aside.unlink()


def _sync(path: Path) -> None:
    """Wait until a file, or the entries of a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file; its folder is made."""
    with replacing(path) as aside:
        aside.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write a whole text file in UTF-8; its folder is made."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: Path, content: Any) -> None:
    """Write a whole JSON file; its folder is made. NaN is a bug here (ValueError)."""
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
