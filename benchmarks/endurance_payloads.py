"""Damaged payloads of every kind, and what the decoders and the receiver make of them (see ``endurance.py``).

Segments of maps carry a CRC-32. It finds every damage to 1 to 3 bits of a segment below 11 kB, and every damage that
lies within 32 neighbouring bits; of all other damage it passes one in 2**32. It is no signature: whoever writes a
fitting checksum is believed, which is what the security layer of a radio message is for. So damage comes in two kinds:

``plain``    the checksum is as it was: a segment that is taken is a wrong acceptance, unless nothing has changed
``forged``   the checksum fits the damage: the parser behind it must refuse, or return what is well-formed and can be
             encoded and decoded again

Messages in UPER and LiDAR scans have no checksum of their own: only the class of the error and what comes out are
checked there.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from endurance_damage import DAMAGES, resealed

from pcdet_avp.datasets.avp import scan_codec
from pcdet_avp.errors import PacketError, RecordError
from pcdet_avp.link import MapStamp, Receiver, encode, packet, rounded
from pcdet_avp.link.cpm import CLASS_NAMES, OBJECT, dequantise, quantise
from pcdet_avp.link.cpm_asn1 import CpmCodec
from pcdet_avp.link.precision import from_codes
from pcdet_avp.structures.lidar_scan import LidarModel, LidarScan
from pcdet_avp.structures.pose import Pose

PER_BATCH = 2000
SHAPE = (8, 20, 30)
MAX_SEGMENT = 700  # bytes
NOW_US = 400_000
SMALL = 10_000  # elements of a segment that goes another round
TAKEN_EVERY = 250  # payloads
SCAN = LidarModel(16, 60, -0.4, 0.1, 2 * np.pi, Pose.identity())
# Which decoder the k-th payload meets: messages are slow to decode, the receiver is what a vehicle runs.
TURNS = ("segment", "receiver", "segment", "map", "receiver", "segment", "scan", "receiver", "segment", "message")


@dataclass
class Findings:
    """Counts by ``decoder: what became of it``, the slowest payload (s), and what must not have happened."""

    counts: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    faults: list[str] = field(default_factory=list)


class Sent:
    """Good payloads of every kind, the same for every batch; decoding one of each compiles what numba compiles."""

    def __init__(self, asn1: Path | None = None) -> None:
        rng = np.random.default_rng(0)
        self.maps: dict[tuple[str, int], np.ndarray] = {}
        self.segments: list[bytes] = []
        for frame in range(1, 5):
            for modality, precision in (("lidar", "float16"), ("camera", "int8")):
                latent = np.cumsum(rng.normal(size=SHAPE), axis=2) * (rng.random(SHAPE[1:]) < 0.4)
                stamp = MapStamp(frame, 50_000 * frame, modality, 12.5, -3.25, 0.5)
                self.segments += encode(latent, stamp, MAX_SEGMENT, precision)
                self.maps[modality, frame] = rounded(latent, precision)
        self.known = set(self.segments)
        ranges = (rng.integers(500, 60_000, (16, 60)) * (rng.random((16, 60)) < 0.8)).astype(np.uint16)
        scan = LidarScan(SCAN, ranges, rng.integers(0, 256, (16, 60)).astype(np.uint8))
        self.scans = [scan_codec.encode_scan(scan)]
        self.codec = CpmCodec.from_folder(asn1) if asn1 else None
        self.messages = [self.codec.encode(_objects(rng, n)) for n in (1, 3, 8, 20)] if self.codec else []
        for payload in self.segments:
            packet.decode_segment(payload)


def _objects(rng: np.random.Generator, n: int) -> np.ndarray:
    boxes = np.column_stack([rng.uniform(-50, 50, (n, 3)), rng.uniform(0.3, 6, (n, 3)), rng.uniform(-4, 4, n)])
    return quantise(boxes, [CLASS_NAMES[i % 3] for i in range(n)], rng.random(n), rng.uniform(-9, 9, (n, 2)))


def attack(sent: Sent, seed: int, batch: int, count: int = PER_BATCH) -> Findings:
    """Damage ``count`` payloads and decode them; a batch depends on its number and the seed alone."""
    rng, found = np.random.default_rng([seed, batch]), Findings()
    vehicle, anyone = Receiver(SHAPE), Receiver()
    for number in range(count):
        decoder = TURNS[number % len(TURNS)]
        if decoder == "message" and not sent.codec:
            decoder = "segment"
        payload, forged = _damaged(sent, decoder, rng)
        began = time.perf_counter()
        try:
            fate = _meet(decoder, payload, forged, sent, vehicle, anyone)
        except Exception as error:  # whatever it is: that is what is looked for
            fate = "another error"
            found.faults.append(_report(seed, batch, number, decoder, repr(error), payload))
        found.slowest_s = max(found.slowest_s, time.perf_counter() - began)
        found.counts[f"{decoder}: {fate}"] += 1
        if fate == "wrongly accepted":
            found.faults.append(_report(seed, batch, number, decoder, fate, payload))
    found.faults += _wrong_maps(sent, vehicle, seed, batch)
    return found


def _report(seed: int, batch: int, number: int, decoder: str, what: str, payload: bytes) -> str:
    return f"seed {seed}, batch {batch}, payload {number}, {decoder}: {what}: {payload[:64].hex()}"


def _damaged(sent: Sent, decoder: str, rng: np.random.Generator) -> tuple[bytes, bool]:
    """A damaged payload for a decoder, and whether its checksum was made to fit."""
    good = {"message": sent.messages, "scan": sent.scans}.get(decoder, sent.segments)
    payload, other = good[rng.integers(len(good))], good[rng.integers(len(good))]
    if decoder == "receiver" and rng.random() < 0.3:
        return payload, False  # what arrives whole between the damaged ones
    damaged = DAMAGES[rng.integers(len(DAMAGES))](payload, other, rng)
    if good is sent.segments and len(damaged) > 4 and rng.random() < 0.5:
        return resealed(damaged), True
    return damaged, False


def _meet(decoder: str, payload: bytes, forged: bool, sent: Sent, vehicle: Receiver, anyone: Receiver) -> str:
    """What became of a payload, in words; errors other than the documented one come out."""
    try:
        if decoder == "receiver":
            return _received(payload, forged, sent, vehicle, anyone)
        DECODERS[decoder](payload, sent)
    except DOCUMENTED[decoder]:
        return "refused"
    if decoder in ("message", "scan"):
        return "accepted, well-formed (no checksum)"
    if payload in sent.known:
        return "accepted, unchanged"
    return "accepted, well-formed (forged checksum)" if forged else "wrongly accepted"


def _segment(payload: bytes, sent: Sent) -> None:
    """Decode; what comes out must be well-formed, and the same after another round."""
    segment = packet.decode_segment(payload)
    fmt = segment.header.format
    values = from_codes(segment.codes, fmt.precision, fmt.exponents)
    if not np.isfinite(values).all() or segment.codes.shape != (segment.header.cell_count, fmt.channels):
        raise ValueError("a segment that is not well-formed was accepted")
    if segment.codes.size <= SMALL:
        row, exponents = values.reshape(fmt.channels, 1, -1), np.array(fmt.exponents) if fmt.exponents else None
        again = packet.decode(encode(row, segment.header.stamp, 1 << 20, fmt.precision, exponents))
        if not np.array_equal(again.values, row):
            raise ValueError("an accepted segment decodes to something else after another round")


def _map(payload: bytes, sent: Sent) -> None:
    """Decode among good segments of a map; of the damaged one only its own cells may come."""
    values = packet.decode([payload, *sent.segments[:2]]).values
    if not np.isfinite(values).all():
        raise ValueError("a map with values that are not finite was accepted")


def _message(payload: bytes, sent: Sent) -> None:
    objects = sent.codec.decode(payload)
    if objects.dtype != OBJECT or len(dequantise(objects).names) != len(objects):
        raise ValueError("a message that is not well-formed was accepted")


def _scan(payload: bytes, sent: Sent) -> None:
    scan = scan_codec.decode_scan(payload, SCAN, Path("scan"))
    if scan.range_mm.shape != (SCAN.beams, SCAN.columns):
        raise ValueError("a scan that is not well-formed was accepted")


DOCUMENTED = {"segment": PacketError, "map": PacketError, "message": PacketError, "scan": RecordError}
DOCUMENTED["receiver"] = ()  # it raises nothing
DECODERS: dict[str, Callable[[bytes, Sent], None]] = {
    "segment": _segment,
    "map": _map,
    "message": _message,
    "scan": _scan,
}


def _received(payload: bytes, forged: bool, sent: Sent, vehicle: Receiver, anyone: Receiver) -> str:
    """Two receivers: one that knows its map's shape and meets no forgery, one that takes whatever decodes."""
    anyone.push(payload)
    if sum(anyone.counts.values()) % TAKEN_EVERY == 0:
        anyone.take("lidar", NOW_US)
    if forged:
        return "forged, to a receiver of any map"
    accepted = vehicle.push(payload)
    if payload in sent.known:
        return "good, taken" if accepted else "good, repeated or late"
    return "wrongly accepted" if accepted else "refused"


def _wrong_maps(sent: Sent, vehicle: Receiver, seed: int, batch: int) -> list[str]:
    """The maps that a receiver gives out after all damage are those that were sent, where cells are present."""
    faults = []
    for modality in ("lidar", "camera"):
        taken = vehicle.take(modality, NOW_US)
        if taken is not None:
            expected = np.where(taken.present, sent.maps[modality, taken.stamp.frame_id], 0)
            if not np.array_equal(taken.values, expected):
                faults.append(f"seed {seed}, batch {batch}: the receiver's {modality} map is not the one that was sent")
    return faults
