"""One process at a time in a folder: two makers of a data set would remove each other's unfinished frames, two
trainings would write over each other's checkpoints, and of two sweeps the last one to end would leave tables without
the other's episodes."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pcdet_avp.errors import RecordError
from pcdet_avp.files import mkdir

try:
    import fcntl
except ModuleNotFoundError:  # not on Windows: there, nothing is locked
    fcntl = None  # type: ignore[assignment]

LOCK_FILE = ".lock"
_held: set[int] = set()  # open files of the locks that this process has


def _let_go() -> None:
    """In a process that was forked: the lock is its parent's and must not outlive it."""
    for handle in _held:
        os.close(handle)
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)


@contextmanager
def sole_user(root: Path) -> Iterator[None]:
    """While the block lasts, no other process enters one for the folder ``root``, which is made; RecordError where one
    has.

    The lock ends with the process that holds it, however that ends; the file that a killed one leaves means nothing.
    Where the file system knows no locks, there is none.
    """
    file = root / LOCK_FILE
    try:
        mkdir(root)
        handle = _locked(file)
    except OSError as error:
        raise RecordError(f"{file}: cannot be written ({error.strerror})") from error
    _held.add(handle)
    try:
        yield
    finally:
        if handle in _held:
            _held.remove(handle)
            with suppress(OSError):
                file.unlink()
            os.close(handle)


def _locked(file: Path) -> int:
    """The file, open and locked."""
    while True:
        handle = os.open(file, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            _lock(handle, file)
        except BaseException:
            os.close(handle)
            raise
        if _is(handle, file):
            return handle
        os.close(handle)  # the one that held it before has just removed it


def _lock(handle: int, file: Path) -> None:
    try:
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.read(handle, 100).decode(errors="replace").strip() or "unknown"
        raise RecordError(
            f"{file}: held by process {holder}, which works in this folder; expected none: wait until it ends"
        ) from None
    except OSError:
        return  # a file system without locks
    os.ftruncate(handle, 0)
    os.write(handle, f"{os.getpid()} on {platform.node()}\n".encode())


def _is(handle: int, file: Path) -> bool:
    """Whether the open file is still the one of this name."""
    try:
        return os.path.samestat(os.fstat(handle), file.stat())
    except FileNotFoundError:
        return False
