"""examples/: what each half does when the other is absent, falls silent, or comes back."""

import socket
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.manifest import Manifest, Scene, read_manifest, write_manifest
from pcdet_avp.datasets.avp.record import read_record, write_record
from pcdet_avp.engine.real_time import RealTimeReport
from pcdet_avp.errors import AvpError, ConfigError, LinkError, RecordError
from pcdet_avp.link import MapStamp, encode
from pcdet_avp.structures.sensor_set import SensorSet


class Half:
    """Stands for the vehicle's network: notes which maps it is given."""

    shape, network_number = (1, 2, 2), 0x9FE4BB77

    def __init__(self):
        self.seen = []

    def detect(self, sample, world_from_ego, maps):
        self.seen.append((sample, [known.stamp.frame_id for known in maps]))
        return {"pred_boxes": np.zeros((3, 7))}


class Clock:
    """Stands until it is moved on."""

    now_s = 5000.0

    def time(self):
        return self.now_s

    monotonic = time


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def way(example, clock, monkeypatch):
    """A drive with a recording of four frames and maps that are used for a second."""
    args = SimpleNamespace(seconds=600, wait=30, max_age=1.0, unit=None, drop=0.0, rate=20.0, any_network=False)
    args.listen = "127.0.0.1:1"
    frames = [(f"sample {i}", SimpleNamespace(ego=SimpleNamespace(world_from_agent=None))) for i in range(4)]
    vehicle = example("vehicle")
    monkeypatch.setattr(vehicle, "time", clock)
    return vehicle.Drive(Half(), frames, RealTimeReport("vehicle", "numpy", 20.0), args)


def a_map(frame, clock, sender=0, network=0):
    stamp = MapStamp(frame, int(1e6 * clock.now_s), "lidar", 0, 0, 0, sender, network)
    return encode(np.ones((1, 2, 2), np.float32), stamp, 500)


def test_a_vehicle_goes_on_alone_through_a_silence_and_fuses_again_after_it(way, clock):
    way.look()
    assert not way._half.seen  # no map yet: the drive has not begun
    way.hear(a_map(5, clock))
    way.look()
    way.look()  # the same map once more is no new frame
    assert way._half.seen == [("sample 1", [5])]
    clock.now_s += 1.05
    way.look()
    assert way._half.seen[-1] == ("sample 1", [])  # tick 100021
    way.hear(a_map(8, clock))  # the unit was started again
    way.look()
    assert way._half.seen[-1] == ("sample 0", [8])
    assert (way.whole.frames, way.whole.alone, len(way._half.seen)) == (2, 1, 3)
    assert way.figures.as_json()["ticks"] == {"asked_hz": 20.0, "due": 4, "done": 2, "dropped": 2}
    assert "1 frames of the vehicle's sensors alone" in way.whole.line()


def test_a_vehicle_ends_where_the_silence_lasts(way, clock):
    way.hear(a_map(5, clock))
    way.look()
    clock.now_s += 30.0
    assert way.goes_on
    clock.now_s += 0.1
    with pytest.raises(LinkError, match=r"127.0.0.1:1: no map to use within 30 s: 1 accepted; is roadside_unit.py"):
        way.goes_on  # noqa: B018


@pytest.mark.parametrize(
    ("ahead_s", "unit", "why"),
    [
        (7.5, None, "1 accepted, but a roadside clock is 7.5 s ahead of the vehicle's"),
        (-7.5, None, "1 accepted, but older than --max_age 1 s once they were there"),
        (0.0, [2, 5], "1 accepted, but all from units that --unit does not name: 0"),
    ],
)
def test_why_no_map_was_used(way, clock, ahead_s, unit, why):
    way._args.unit, here_s = unit, clock.now_s
    clock.now_s += ahead_s
    segments = a_map(5, clock)
    clock.now_s = here_s
    way.hear(segments)
    way.look()
    assert way._half.seen == []
    clock.now_s += 31
    with pytest.raises(LinkError, match=rf"no map to use within 30 s: {why}$"):
        way.goes_on  # noqa: B018


def test_both_halves_find_the_same_frame_by_the_number_in_the_packet(example):
    number = example("roadside_unit").frame_number
    assert number(100.0, 20.0) == 2000
    assert number((1 << 32) / 20.0 + 0.25, 20.0) == 5  # as far as 32 bits hold it
    assert number(1.7e9, 20.0) < 1 << 32


def test_a_roadside_unit_ends_where_nobody_listens(example, clock, monkeypatch):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    roadside_unit = example("roadside_unit")
    monkeypatch.setattr(roadside_unit, "time", clock)
    sender = roadside_unit.Sender(f"127.0.0.1:{port}", wait_s=9.0)
    sender.send([b"one", b"two", b"three"])
    with pytest.raises(LinkError, match=f"--to 127.0.0.1:{port}: nobody listens there"):
        sender.check_heard()
    clock.now_s += 9.1
    with pytest.raises(LinkError, match=r"nobody listens there .* for 9 s"):
        sender.send([b"one", b"two", b"three"])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", port))
        sender.send([b"one", b"two", b"three"])
        assert [listening.recv(100) for _ in range(3)] == [b"one", b"two", b"three"]
        sender.send([b"four"])
        sender.check_heard()
        assert listening.recv(100) == b"four"
    sender.close()


def test_a_half_that_fails_ends_the_demonstration(example):
    real_time = example("real_time")

    def process(code):
        return subprocess.Popen([sys.executable, "-S", "-c", code], stdout=subprocess.PIPE, text=True)

    sleeping, failing = process("import time; time.sleep(60)"), process("raise SystemExit(2)")
    with pytest.raises(AvpError, match=r"roadside_unit.py ended with status 2"):
        real_time.await_end(
            {"vehicle": sleeping, "roadside_unit": failing}, real_time.pass_on(sleeping), real_time.pass_on(failing)
        )
    sleeping.kill()


def test_the_lines_of_every_second_are_passed_on(example, capsys):
    real_time = example("real_time")
    lines = "listening on here\\n 12.0 Hz    1.00 Mbit/s\\nall: 12.0 Hz  1 Mbit/s\\n  1.0 of 20 Hz: 1 of 1 ticks\\n"
    talking = subprocess.Popen(
        [sys.executable, "-S", "-c", f'print("{lines}", end="")'], stdout=subprocess.PIPE, text=True
    )
    real_time.await_end({"vehicle": talking}, real_time.pass_on(talking, until="listening"))
    real_time.await_end({"vehicle": talking}, real_time.pass_on(talking))
    assert capsys.readouterr().out == " 12.0 Hz    1.00 Mbit/s\n"


def test_maps_of_another_network_are_left_out_and_named_once(way, clock, capsys):
    """They would decode to maps of the right shape, and of nonsense."""
    for frame in (1, 2):
        way.hear(a_map(frame, clock, sender=3, network=0xCA46F1BD))
    way.look()
    assert way._half.seen == []
    words = "its maps are of network ca46f1bd, this vehicle's is 9fe4bb77: not used (see --any_network)"
    assert capsys.readouterr().out == f"unit 3: {words}\n"
    way.hear(a_map(1, clock, network=0x9FE4BB77))
    way.look()
    assert way._half.seen == [("sample 1", [1])]
    clock.now_s += 31
    with pytest.raises(LinkError, match=r"2 foreign, 1 accepted: .*ca46f1bd, this vehicle's is 9fe4bb77"):
        way.goes_on  # noqa: B018


def test_a_recording_without_the_sensors_of_a_half_is_refused(example, tiny_data, tmp_path):
    """A roadside unit would send nothing, twenty times a second."""
    cfg = load_config("cfgs/avp/cp_tiny.yaml")
    record = read_record(tiny_data, read_manifest(tiny_data).frame_ids("test")[0])
    write_record(tmp_path, replace(record, frame_id="a/0", units={}))
    write_manifest(tmp_path, Manifest((Scene("a", "test", ("0",)),), complete=True))
    cfg.DATA_CONFIG.DATA_PATH = str(tmp_path)
    roadside_unit = example("roadside_unit")
    ((sample, _),) = roadside_unit.recording(cfg, "test", 8, SensorSet.parse("CL+none"))
    assert len(sample["points"])
    with pytest.raises(RecordError, match=r"split 'test': expected infra_camera or infra_lidar, found none"):
        roadside_unit.recording(cfg, "test", 8, roadside_unit.SENSORS)


NO_ADDRESS = ("47020", ":47020", "host:0", "host:65536", "host:\u00b2", f"{'a' * 64}:47020", "a..b:1")


@pytest.mark.parametrize("text", NO_ADDRESS)
def test_what_is_no_address_is_refused(example, text):
    with pytest.raises(ConfigError, match=r"--to: expected HOST:PORT, found"):
        example("roadside_unit").address(text, "--to")
