"""Two makers of data in one folder: the second is told; a lock dies with its process, however that dies."""

import os
import signal
import subprocess
import sys

import pytest

from pcdet_avp.datasets.avp.claim import claimed
from pcdet_avp.datasets.avp.manifest import Manifest, Scene, read_manifest
from pcdet_avp.errors import RecordError
from pcdet_avp.folder_lock import LOCK_FILE, sole_user

pytest.importorskip("fcntl")
HOLD = """
import sys, time
from pathlib import Path
from pcdet_avp.folder_lock import sole_user
with sole_user(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""

FORK = """
import os, sys, time
from pathlib import Path
from pcdet_avp.folder_lock import LOCK_FILE, sole_user
with sole_user(Path(sys.argv[1])):
    leaves = os.fork()
    if not leaves:
        sys.exit()
    os.waitpid(leaves, 0)
    runs, say = os.pipe()
    stays = os.fork()
    if not stays:
        os.write(say, b"!")
        time.sleep(60)
    os.read(runs, 1)  # until it has come so far, a fork holds all that its parent does
    print(stays, (Path(sys.argv[1]) / LOCK_FILE).exists(), flush=True)
    time.sleep(60)
"""


def test_the_second_maker_is_refused_and_the_first_goes_on(tmp_path):
    """Also one who would finish the same data set: its clearing up would remove the frame that is being written."""
    manifest = Manifest((Scene("0000", "test", ("000",)),), complete=False, seed=1)
    with claimed(tmp_path / "set", manifest):
        unfinished = tmp_path / "set/scenes/0000/.000.partial"
        unfinished.mkdir(parents=True)
        for asked in (manifest, Manifest((), seed=2)):
            told = rf"set/\.lock: held by process {os.getpid()} on .*wait until it ends"
            with pytest.raises(RecordError, match=told), claimed(tmp_path / "set", asked):
                pass
        assert unfinished.exists()
        assert read_manifest(tmp_path / "set").seed == 1
    with claimed(tmp_path / "set", manifest):
        assert not unfinished.exists()
    assert not (tmp_path / "set" / LOCK_FILE).exists()


def test_the_lock_of_a_killed_process_is_none(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", HOLD, tmp_path], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    with pytest.raises(RecordError, match=f"held by process {process.pid} on"), sole_user(tmp_path):
        pass
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert (tmp_path / LOCK_FILE).exists()
    with claimed(tmp_path, Manifest((), complete=False)):  # and what it left is no foreign file
        pass
    assert not (tmp_path / LOCK_FILE).exists()


def test_a_forked_child_neither_keeps_nor_ends_the_lock(tmp_path):
    """Those that load a training's data live on for a second after ``kill -9``; the same command goes on at once."""
    process = subprocess.Popen([sys.executable, "-c", FORK, tmp_path], stdout=subprocess.PIPE, text=True)
    child, still_there = process.stdout.readline().split()
    try:
        assert still_there == "True"
        with pytest.raises(RecordError, match=f"held by process {process.pid} on"), sole_user(tmp_path):
            pass
        process.kill()
        process.wait()
        os.kill(int(child), 0)  # it is alive
        with sole_user(tmp_path):
            pass
    finally:
        os.kill(int(child), signal.SIGKILL)
        process.kill()
        process.communicate()


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").touch()
    folder = tmp_path / "file" / "set"
    with pytest.raises(RecordError, match=r"file/set/\.lock: cannot be written"), sole_user(folder):
        pass
