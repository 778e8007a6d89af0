"""Long work that is killed (SIGKILL) at random moments and started again, until it ends (see ``endurance.py``).

Every start is a fork of this process, which has imported everything, into a session of its own: there, the tool of
``tools/`` runs as from a command line. So kills fall into the work and not into the seconds that imports take. Half of
the kills take the whole process group, as a machine that loses its power does, half the tool's own process only, as
``kill -9`` does: its workers are then orphans, and the next start may meet them.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import runpy
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

REPOSITORY = Path(__file__).parents[1]
POLL_S = 0.002
PR_SET_CHILD_SUBREAPER = 36  # of linux/prctl.h
SHARE = 0.7  # of an uninterrupted run's time, in which the moment of a kill is drawn: a later start has less to do
MOST_WRITES, JUST_AFTER_S = 4, 0.02  # a kill at a write comes so soon after the first to third one that is seen
ORPHANS_S = 60.0  # within which every process of a killed run must be gone
LIMIT_S = 3600.0  # of one start; nothing here takes so long on any machine
AT_A_WRITE, AT_ANY_TIME = "when a file was being written", "at any time"


@dataclass(frozen=True)
class Work:
    """A tool, and what is to be compared.

    ``arguments(folder)``: its command line. ``finished(folder)``: what is finished so far by name, as digests; it may
    grow and must not change. ``result(folder)``: the same of what must equal an uninterrupted run in the end.
    ``writing(folder)``: whether a file is just being written.
    """

    name: str
    arguments: Callable[[Path], list]
    finished: Callable[[Path], dict[str, str]]
    result: Callable[[Path], dict[str, str]]
    writing: Callable[[Path], bool]


@dataclass
class Round:
    """One work from nothing to its end: how often it was killed, and what was found."""

    work: str
    number: int
    kills: int = 0
    of_the_group: int = 0
    at_a_write: int = 0
    half_written: int = 0  # kills after which an unfinished file lay there
    compared: int = 0
    faults: list[str] = field(default_factory=list)


def digest(*contents: bytes) -> str:
    return hashlib.sha256(b"".join(contents)).hexdigest()


def half_written(folder: Path) -> bool:
    """Whether a file or folder lies there under the name that it has until it is whole."""
    return any(name.endswith((".partial", ".tmp")) for _, folders, files in os.walk(folder) for name in folders + files)


def start(work: Work, folder: Path) -> int:
    """Start the work in a fork; its process id, which is also that of its session and group."""
    folder.mkdir(parents=True, exist_ok=True)
    pid = os.fork()
    if pid:
        return pid
    status = 70
    try:
        os.setsid()
        log = os.open(folder.with_name(f"{folder.name}.log"), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        for stream in (1, 2):
            os.dup2(log, stream)
        os.chdir(folder)
        sys.argv = [str(word) for word in work.arguments(folder)]
        runpy.run_path(sys.argv[0], run_name="__main__")
        status = 0
    except SystemExit as ending:
        status = ending.code if isinstance(ending.code, int) else 1
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def run_to_the_end(work: Work, folder: Path) -> tuple[int, float]:
    """Exit status and seconds of an undisturbed run."""
    began, pid = time.monotonic(), start(work, folder)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), time.monotonic() - began


def killed_round(
    work: Work, folder: Path, number: int, kills: int, whole_s: float, expected: dict[str, str], seed: list[int]
) -> Iterator[Round]:
    """Start, kill and start again, at most ``kills`` times, until the work is done; yields after every kill.

    The last round is the outcome: also what was lost, what differs from ``expected``, and who is left.
    """
    rng, outcome, before, groups = np.random.default_rng([*seed, number]), Round(work.name, number), {}, []
    while True:
        allowed = outcome.kills < kills
        status, group = _one_start(work, folder, rng, whole_s if allowed else None, outcome)
        groups.append(group)
        after = work.finished(folder)
        lost = [name for name, content in before.items() if after.get(name) != content]
        outcome.faults += [
            f"{work.name}, round {number}, kill {outcome.kills}: lost or changed {name}" for name in lost
        ]
        before = after
        if status is not None:
            break
        yield outcome
    if status:
        outcome.faults.append(f"{work.name}, round {number}: ended with exit status {status}, see {folder}.log")
    outcome.faults += [f"{work.name}, round {number}: process group {g} is left" for g in groups if not _gone(g)]
    found = work.result(folder)
    outcome.compared = len(expected)
    differing = [name for name in {**expected, **found} if expected.get(name) != found.get(name)]
    outcome.faults += [f"{work.name}, round {number}: differs in {name}" for name in differing]
    yield outcome


def _one_start(
    work: Work, folder: Path, rng: np.random.Generator, whole_s: float | None, outcome: Round
) -> tuple[int | None, int]:
    """Run once; exit status, or None if it was killed, and the process group. ``whole_s`` None: nobody kills it."""
    moment = AT_A_WRITE if rng.random() < 0.5 else AT_ANY_TIME
    wait_s, writes, alone = rng.uniform(0, SHARE * (whole_s or 1)), rng.integers(1, MOST_WRITES), rng.random() < 0.5
    pid, began, busy = start(work, folder), time.monotonic(), False
    due = None if moment == AT_A_WRITE else began + wait_s
    while True:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status), pid
        now = time.monotonic()
        if whole_s is not None and due is None:
            before, busy = busy, work.writing(folder)
            writes -= busy and not before
            due = now + rng.uniform(0, JUST_AFTER_S) if writes == 0 else None
        if whole_s is not None and due is not None and now >= due:
            return _kill(pid, folder, alone, moment, outcome), pid
        if now - began > LIMIT_S:
            outcome.faults.append(f"{work.name}: did not end within {LIMIT_S:g} s")
            return _kill(pid, folder, False, moment, outcome), pid
        time.sleep(POLL_S)


def _kill(pid: int, folder: Path, alone: bool, moment: str, outcome: Round) -> int | None:
    """SIGKILL; None, or the exit status of a process that was quicker."""
    try:
        (os.kill if alone else os.killpg)(pid, signal.SIGKILL)
    except ProcessLookupError:  # it has not begun a session yet
        os.kill(pid, signal.SIGKILL)
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if status != -signal.SIGKILL:
        return status
    outcome.kills += 1
    outcome.of_the_group += not alone
    outcome.at_a_write += moment == AT_A_WRITE
    outcome.half_written += half_written(folder)
    return None


def _gone(group: int) -> bool:
    """Whether nobody of a process group is left, or will be within ``ORPHANS_S``."""
    end = time.monotonic() + ORPHANS_S
    while time.monotonic() < end:
        with suppress(ChildProcessError):
            os.waitpid(-group, os.WNOHANG)  # orphans are ours (``adopt_orphans``)
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def adopt_orphans() -> None:
    """Become the parent of the workers of killed runs (Linux), so that they are no zombies when they have ended."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
