"""A placement study as work for Dask that resumes: occupancy by occupancy, then trial by trial.

The output folder holds ``study.json`` (what the results follow from; another study is refused), ``visibility/`` with a
file for each occupancy, and ``episodes.jsonl`` with a line for each trial that was driven.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from pcdet_avp import __version__
from pcdet_avp.errors import RecordError
from pcdet_avp.files import make_folder, write_json
from pcdet_avp.parallel import run_tasks
from pcdet_avp.placement.safe_speed import SpeedJob, SpeedResult, drive_faster
from pcdet_avp.placement.visibility import OccupancyView, Study, load_view, save_view, view_occupancy

CLAIM, EPISODES, VIEWS = "study.json", "episodes.jsonl", "visibility"


def claim_folder(study: Study, out: Path, floor: str) -> None:
    """Note what a folder's results follow from; RecordError if it holds those of another study."""
    make_folder(out / VIEWS)
    content = {
        "version": __version__,
        "plan_sha256": hashlib.sha256(Path(study.plan).read_bytes()).hexdigest(),
        "floor": floor,
        "candidates": study.candidates,
        "seed": study.seed,
        "settings": json.loads(json.dumps(asdict(study.settings))),
    }
    file = out / CLAIM
    if file.exists():
        try:
            held = dict(json.loads(file.read_text()))
        except (ValueError, TypeError) as error:
            raise RecordError(
                f"{file}: does not say what the folder holds ({error}); choose another --out or remove the folder"
            ) from error
        for name, value in content.items():
            if held.get(name) != value:
                raise RecordError(
                    f"{file}: holds a study with another {name}; choose another --out or remove the folder"
                )
    write_json(file, content)


def all_views(
    study: Study, out: Path, occupancies: int, workers: int, scheduler: str | None = None
) -> list[OccupancyView]:
    """The views of occupancies 0 to ``occupancies`` - 1; those on the disk are not made again."""
    files = [out / VIEWS / f"{number:04d}.npz" for number in range(occupancies)]
    missing = [number for number, file in enumerate(files) if not file.exists()]
    bar = tqdm(total=occupancies, initial=occupancies - len(missing), unit="occupancy", desc="visibility")
    with bar:
        for number, view in run_tasks(partial(_numbered_view, study), missing, workers, scheduler):
            save_view(files[number], view)
            bar.update()
    return [_read(file) for file in files]


def _numbered_view(study: Study, number: int) -> tuple[int, OccupancyView]:
    return number, view_occupancy(study, number)


def _read(file: Path) -> OccupancyView:
    try:
        return load_view(file)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise RecordError(f"{file}: cannot be read ({error}); remove it, and it is made anew") from error


def all_speeds(jobs: Sequence[SpeedJob], out: Path, workers: int, scheduler: str | None = None) -> list[SpeedResult]:
    """What the jobs give; those whose line is in the journal are not driven again."""
    journal = _Journal(out / EPISODES)
    missing = [job for job in jobs if job_key(job) not in journal.results]
    with tqdm(total=len(jobs), initial=len(jobs) - len(missing), unit="trial", desc="driving") as bar:
        for key, result in run_tasks(
            _keyed_drive, sorted(missing, key=lambda j: (j.scenario, j.trial)), workers, scheduler
        ):
            journal.add(key, result)
            bar.update()
    return [journal.results[job_key(job)] for job in jobs]


def _keyed_drive(job: SpeedJob) -> tuple[str, SpeedResult]:
    return job_key(job), drive_faster(job)


def job_key(job: SpeedJob) -> str:
    """What a trial's result follows from, without the placement's name. A floor that is not named leaves no trace, so
    that trials from before it could be named keep their keys."""
    values = {**asdict(job), "name": "", "plan": ""}
    if values["floor"] is None:
        del values["floor"]
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:24]


class _Journal:
    """One line of JSON for each trial driven. Left out, so that they are driven again: a line that a killed run cut
    off, and one from before drives that did not finish were counted."""

    def __init__(self, file: Path) -> None:
        self.file, self.results = file, {}
        content = file.read_bytes() if file.exists() else b""
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            with file.open("r+b") as stream:
                stream.truncate(whole)
        for line in content[:whole].splitlines():
            self._take(line)

    def _take(self, line: bytes) -> None:
        try:
            entry: dict[str, Any] = json.loads(line)
            key = entry.pop("key")
            unfinished_at = entry.pop("unfinished_at", None)
            result = SpeedResult(**entry, unfinished_at=tuple(unfinished_at or ()))
        except (ValueError, KeyError, TypeError) as error:
            raise RecordError(
                f"{self.file}: a line is no trial of this version ({error!r}); remove the file"
            ) from error
        if unfinished_at is not None:
            self.results[key] = result

    def add(self, key: str, result: SpeedResult) -> None:
        with self.file.open("a") as stream:
            stream.write(json.dumps({"key": key, **asdict(result)}) + "\n")
        self.results[key] = result
