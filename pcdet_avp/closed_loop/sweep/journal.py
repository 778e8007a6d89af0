"""Finished episodes on disk while a sweep runs: one line each, appended whole or cut off when read again.

A folder belongs to one seed and one way of driving; ``sweep.json`` says which, and what each perception was built
from, so that a sweep goes on only with what it began with. Other code may go on with it; ``sweep.json`` lists the
commits that drove.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pcdet_avp import __version__
from pcdet_avp.closed_loop.sweep.episode_row import Case, EpisodeRow
from pcdet_avp.closed_loop.sweep.results import SUMMARY
from pcdet_avp.errors import AvpError, RecordError
from pcdet_avp.files import write_bytes, write_json
from pcdet_avp.folder_lock import sole_user
from pcdet_avp.provenance import git_commit
from pcdet_avp.sim.scenarios.table import file_name, plays_on_plan

JOURNAL, CLAIM = "journal.jsonl", "sweep.json"
SENSORS = "sensors"  # key of the claim: DATA_CONFIG as perceptions with sensors have it
COMMITS, UNKNOWN = "git_commits", "unknown"  # key of the claim; a commit that was not kept
Finished = dict[Case, tuple[EpisodeRow, float]]  # record and wall seconds of every finished episode


class Journal:
    """The finished episodes of a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.finished = folder, {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = os.open(folder / JOURNAL, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        except OSError as error:
            raise RecordError(f"{folder}: cannot be written ({error.strerror})") from error
        self._read()

    def _read(self) -> None:
        """Take in all whole lines and cut off what a killed run may have left of one."""
        content = (self.folder / JOURNAL).read_bytes()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            os.ftruncate(self._file, whole)
        for number, line in enumerate(content[:whole].splitlines(), start=1):
            self._take(*_parsed(line, f"{self.folder / JOURNAL}: line {number}"))

    def add(self, row: EpisodeRow, wall_s: float) -> None:
        """Append a finished episode; it is on the disk when this returns."""
        line = json.dumps({"row": row.columns(), "wall_s": round(wall_s, 3)}) + "\n"
        if os.write(self._file, line.encode()) != len(line):
            raise RecordError(f"{self.folder / JOURNAL}: the disk is full")
        os.fsync(self._file)
        self._take(row, wall_s)

    def _take(self, row: EpisodeRow, wall_s: float) -> None:
        self.finished[row.case] = row, wall_s

    def note_commit(self) -> None:
        """Say in the claim which code drives from here on; the claim has been made."""
        held, commit = json.loads((self.folder / CLAIM).read_text()), git_commit() or f"version {__version__}"
        known = held.get(COMMITS) or ([self._last_commit()] if self.finished else [])
        if commit not in known:
            write_json(self.folder / CLAIM, {**held, COMMITS: [*known, commit]})

    def _last_commit(self) -> str:
        """That of the folder's summary: whoever wrote it drove the episodes from before the claim listed commits."""
        try:
            return json.loads((self.folder / SUMMARY).read_text(encoding="utf-8"))["meta"]["git_commit"] or UNKNOWN
        except (OSError, ValueError, KeyError):
            return UNKNOWN

    def close(self) -> None:
        os.close(self._file)


def driven_by(folder: Path) -> list[str]:
    """The commits that have driven a folder's episodes, in their order; [] where that was not kept."""
    try:
        return list(json.loads((folder / CLAIM).read_text(encoding="utf-8")).get(COMMITS, []))
    except (OSError, ValueError):
        return []


def _parsed(line: bytes, where: str) -> tuple[EpisodeRow, float]:
    try:
        entry = json.loads(line)
        return EpisodeRow.from_columns(entry["row"]), float(entry["wall_s"])
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordError(
            f"{where}: not a finished episode of this version ({error!r}); choose another --out or remove it"
        ) from error


@contextmanager
def open_journal(folder: Path, claim: Mapping[str, Any]) -> Iterator[Journal]:
    """The folder's journal, if what is to run agrees with what it holds (``claim``: name -> what must agree).

    RecordError where it does not, or where another process has it open. A run that ends in an error of ours before its
    first episode, such as for weights of another configuration, leaves the folder as it was.
    """
    with sole_user(folder):
        journal, file = Journal(folder), folder / CLAIM
        try:
            before, count = file.read_bytes() if file.exists() else None, len(journal.finished)
            _claim(file, json.loads(json.dumps(claim)))
            try:
                yield journal
            except AvpError:
                if len(journal.finished) == count:
                    _restore(file, before)
                    if before is None and not count:
                        (folder / JOURNAL).unlink()
                raise
        finally:
            journal.close()


def _restore(file: Path, content: bytes | None) -> None:
    """The claim of the runs before; no file where there was none."""
    if content is None:
        file.unlink()
    else:
        write_bytes(file, content)


def _claim(file: Path, claim: dict[str, Any]) -> None:
    try:
        held = dict(json.loads(file.read_text())) if file.exists() else {}
    except (ValueError, TypeError) as error:
        raise RecordError(
            f"{file}: does not say what the folder holds ({error}); choose another --out or remove the folder"
        ) from error
    for name in claim:
        if name not in held:
            _refuse_namesake(file, name, held)
    _refuse_other_sensors(file, claim, held)
    for name, value in claim.items():
        if held.get(name, value) not in (value, {}):  # {}: of a version that did not say what the oracle was built from
            which = f" ({held[name]}, here {value})" if isinstance(value, int) else ""
            raise RecordError(
                f"{file}: holds a sweep with another {name}{which}; choose another --out or remove the folder"
            )
    write_json(file, {**held, **claim})


def _refuse_other_sensors(file: Path, claim: Mapping[str, Any], held: Mapping[str, Any]) -> None:
    """RecordError where a perception was driven with other sensors than those of the claim."""
    # Folders from before there was the key: line of sight says its sensors itself.
    known = [held[SENSORS]] if SENSORS in held else [each["data_cfg"] for each in held.values() if _has_sensors(each)]
    if SENSORS in claim and any(each != claim[SENSORS] for each in known):
        raise RecordError(
            f"{file}: holds a sweep with other sensors than those of this --cfg (and --set): which of two perceptions "
            "is at fault can be told only with the same; give that --cfg, or choose another --out"
        )


def _has_sensors(claimed: Any) -> bool:
    return isinstance(claimed, Mapping) and "SENSORS" in claimed.get("data_cfg", {})


def _refuse_namesake(file: Path, name: str, held: Mapping[str, Any]) -> None:
    """RecordError where the folder holds the same scenario on a plan whose file has the same name in another folder:
    the pages and videos of both would have the same names."""
    others = [other for other in held if plays_on_plan(other) and file_name(other) == file_name(name)]
    if plays_on_plan(name) and others:
        raise RecordError(
            f"{file}: holds a sweep of {others[0]}, whose plan has the same name as that of {name}; choose another "
            "--out or another name"
        )
