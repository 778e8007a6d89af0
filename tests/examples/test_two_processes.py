"""examples/: roadside units and a vehicle, processes that share nothing but a UDP port."""

import itertools
import json
import os
import re
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch

from pcdet_avp.config import load_config, plain
from pcdet_avp.datasets import build_dataset
from pcdet_avp.engine import checkpoint
from pcdet_avp.link import MapStamp, encode
from pcdet_avp.models import build_network
from pcdet_avp.structures.bev_grid import BevGrid

ROOT = Path(__file__).parents[2]
CFG = ROOT / "cfgs" / "avp" / "cp_tiny.yaml"


@pytest.fixture(scope="module")
def weights(tiny_data, tmp_path_factory):
    """A checkpoint with random weights."""
    cfg = load_config(CFG)
    cfg.DATA_CONFIG.DATA_PATH = str(tiny_data)
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split="test")
    torch.manual_seed(0)
    model = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), dataset)
    path = tmp_path_factory.mktemp("weights") / "random.pth"
    checkpoint.save(path, {"model_state": model.state_dict(), "config": plain(cfg)})
    return path


@pytest.fixture
def start(tiny_data, weights):
    """``start(role, *arguments)``: one of the two processes."""
    running = []

    def run(role, *arguments):
        words = [ROOT / "examples" / f"{role}.py", "--cfg", CFG, "--ckpt", weights, "--frames", 1, *arguments]
        words = [sys.executable, *words, "--set", "DATA_CONFIG.DATA_PATH", tiny_data]
        where = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        running.append(subprocess.Popen([str(word) for word in words], env=where, **pipes))
        return running[-1]

    yield run
    for process in running:
        process.kill()
        process.communicate()


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def figures_of(printed):
    """Of the vehicle's last line: frames a second, lost cells (%), age of the maps (ms)."""
    line = r"all: +([\d.]+) Hz +[\d.]+ Mbit/s +lost cells +([\d.]+) % +age +(\d+) ms +[\d.]+ boxes"
    return map(float, re.search(line, printed).groups())


def test_the_vehicle_fuses_what_two_units_send_and_goes_on_when_one_is_killed(start):
    place, both = f"127.0.0.1:{free_port()}", re.compile(r"boxes  unit 0: \d+ maps, \d+ ms  unit 7: \d+ maps, \d+ ms$")
    vehicle = start("vehicle", "--listen", place, "--seconds", 300, "--max_age", 30)
    first, second = (start("roadside_unit", "--to", place, "--seconds", 300, "--unit", unit) for unit in (0, 7))

    def line_with(pattern):
        while not pattern.search(line := vehicle.stdout.readline().strip()):
            assert line, vehicle.communicate()[1]
        return line

    line_with(both)
    second.kill()  # without a word of farewell
    for _ in range(2):
        line_with(re.compile(r"[1-9].* Hz .* boxes"))
    assert first.poll() is None
    vehicle.terminate()
    printed, errors = vehicle.communicate(timeout=60)
    assert vehicle.returncode == 130, errors
    assert "Traceback" not in errors
    assert int(re.search(r"segments: (\d+) accepted", printed)[1]) >= 2
    hz, lost, age_ms = figures_of(printed)
    assert 0 < hz <= 21
    assert lost < 50  # on a busy machine a map may be used before its last segment is there
    assert age_ms > 0
    first.terminate()
    _, errors = first.communicate(timeout=30)
    assert first.returncode == 130, errors
    assert "Traceback" not in errors


@pytest.mark.slow
def test_the_vehicle_goes_on_alone_while_the_roadside_unit_is_killed_and_started_again(start, tmp_path):
    place, summary = f"127.0.0.1:{free_port()}", tmp_path / "vehicle.json"
    vehicle = start("vehicle", "--listen", place, "--seconds", 300, "--max_age", 5, "--summary", summary)

    def line_with(words):
        while words not in (line := vehicle.stdout.readline()):
            assert line, vehicle.communicate()[1]

    for _ in range(2):
        roadside = start("roadside_unit", "--to", place, "--seconds", 300)
        line_with("lost cells")
        roadside.kill()
        line_with("of the vehicle's sensors alone")
    vehicle.terminate()
    printed, errors = vehicle.communicate(timeout=60)
    assert "Traceback" not in errors
    assert "p99" in printed  # the table of what was done until then
    found = json.loads(summary.read_text())
    assert found["ticks"]["done"] >= 2
    assert found["frames_alone"] >= 2
    assert {"encode ego_camera", "warp", "fuse", "backbone", "head", "post-processing"} <= set(found["stages"])


@pytest.mark.slow
def test_the_demonstration_writes_the_figures_of_both_halves(tiny_data, weights, tmp_path):
    words = [sys.executable, ROOT / "examples" / "real_time.py", "--cfg", CFG, "--ckpt", weights, "--minutes", 0.1]
    words += ["--frames", 1, "--out", tmp_path / "figures.json", "--set", "DATA_CONFIG.DATA_PATH", tiny_data]
    where = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([str(w) for w in words], env=where, capture_output=True, text=True, check=False, timeout=500)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "figures.json").read_text())
    assert found["vehicle"]["ticks"]["done"] <= found["roadside_unit"]["ticks"]["done"]
    assert {"encode infra_camera", "encode infra_lidar", "compress", "pack", "send", "whole frame"} == set(
        found["roadside_unit"]["stages"]
    )
    assert found["vehicle"]["age_ms"]["p50"] > 0
    assert "of the frames sent" in done.stdout


@pytest.fixture
def run_here(tiny_data, weights, monkeypatch, capsys):
    """``run_here(role, *arguments, more=settings)``: one of the two in this process; exit status, output, errors."""

    def run(role, *arguments, more=()):
        words = [role, "--cfg", CFG, "--ckpt", weights, "--frames", 1, *arguments]
        words += ["--set", "DATA_CONFIG.DATA_PATH", tiny_data, *more]
        monkeypatch.setattr(sys, "argv", list(map(str, words)))
        monkeypatch.syspath_prepend(ROOT / "examples")
        before = signal.getsignal(signal.SIGTERM)
        status = 0
        try:
            runpy.run_path(str(ROOT / "examples" / f"{role}.py"), run_name="__main__")
        except SystemExit as ended:
            status = ended.code
        finally:
            signal.signal(signal.SIGTERM, before)
        return status, *capsys.readouterr()

    return run


@contextmanager
def full_maps(place, shape, tick_s=0.05):
    """While this lasts, a thread sends maps (c, h, w) of ones to a UDP port, which any network takes for its own."""
    done = threading.Event()

    def send():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
            for number in itertools.takewhile(lambda _: not done.wait(tick_s), itertools.count()):
                stamp = MapStamp(number, int(1e6 * time.time()), "lidar", 0.0, 0.0, 0.0)
                for payload in encode(np.ones(shape, np.float32), stamp, 1475):
                    sending.sendto(payload, place)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def test_the_vehicle_ends_by_itself_when_its_time_is_over(run_here, weights):
    port = free_port()
    reduced = torch.load(weights, weights_only=True)["model_state"]["codec.codecs.lidar.reduce.weight"]
    cfg = load_config(CFG)
    grid = BevGrid.from_range(cfg.DATA_CONFIG.POINT_CLOUD_RANGE, cfg.DATA_CONFIG.VOXEL_SIZE)
    with full_maps(("127.0.0.1", port), (len(reduced), grid.height // 2, grid.width // 2)):
        status, printed, errors = run_here("vehicle", "--listen", f"127.0.0.1:{port}", "--seconds", 0.3)
    assert (status, errors) == (0, "")
    hz, lost, _ = figures_of(printed)
    assert hz > 0
    assert lost == 0


def test_a_limit_that_no_map_which_names_its_network_keeps_is_refused(run_here):
    """57 bytes by docs/wire_format.md; 56 would be enough without the network's number."""
    told = "MODEL.COMPRESSION.MAX_BYTES: expected 57 or more, an empty float16 map of "
    status, _, errors = run_here("roadside_unit", "--unit", 3, more=("MODEL.COMPRESSION.MAX_BYTES", 56))
    assert status == 2
    assert told in errors
    assert "of roadside unit 3 that says which network made it, found 56" in errors


def test_what_is_wrong_is_one_line(run_here):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        wrong = {
            "cannot be bound": ("vehicle", "--listen", f"127.0.0.1:{taken.getsockname()[1]}"),
            "--to: expected HOST:PORT, found 'here'": ("roadside_unit", "--to", "here"),
            "--unit: expected a number below 65536, found 65536": ("roadside_unit", "--unit", 65_536),
            "no segment at all; is roadside_unit.py running": ("vehicle", "--listen", f"127.0.0.1:{free_port()}"),
            "nobody listens there (is vehicle.py running": ("roadside_unit", "--to", f"127.0.0.1:{free_port()}"),
        }
        for words, command in wrong.items():
            status, _, errors = run_here(*command, "--wait", 0.2)
            assert status == 2
            assert words in errors
            assert len(errors.strip().splitlines()) == 1
