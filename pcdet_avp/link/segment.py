"""The bytes of a segment: header, body, checksum.

Little-endian. Common to all segments of a map (33 B, in version 2 35 B; for int8 and a byte per channel):
    magic 2s  version u8  kind u8 (modality + 16 precision)  [version 2: sender u16]  frame id u32
    time stamp u64 us  pose 3 f32 (x m, y m, yaw rad: world_from_agent)  channels u8  height u16  width u16
    [int8: exponents i8]
The segment's own (8 B, and 4 B at its end): first cell u32, cells u32, the body, a CRC-32 of all before it.
Every segment repeats the common part, so that any one of them decodes without the others.

Version 1 has no sender and means number 0. Number 0 is written as version 1, so that a site's only unit sends the
bytes that it always sent; every other number is written as version 2. Both versions are read.
"""

from __future__ import annotations

import struct
import zlib
from functools import lru_cache

import numpy as np

from pcdet_avp.errors import PacketError
from pcdet_avp.link.header import MODALITIES, MapFormat, MapStamp, SegmentHeader
from pcdet_avp.link.precision import PRECISIONS

MAGIC = b"AV"
_COMMON = {1: struct.Struct("<2sBBIQ3fBHH"), 2: struct.Struct("<2sBBHIQ3fBHH")}  # by version
_CELLS, _CRC = struct.Struct("<II"), struct.Struct("<I")
SHORTEST = _COMMON[1].size + _CELLS.size + _CRC.size


def version_of(sender: int) -> int:
    """The version in which a unit's segments are written."""
    return 2 if sender else 1


def overhead_bytes(map_format: MapFormat, sender: int = 0) -> int:
    """Bytes of a segment beside its entropy-coded body: both headers and the checksum."""
    return _COMMON[version_of(sender)].size + len(map_format.exponents) + _CELLS.size + _CRC.size


def seal(header: SegmentHeader, body: bytes) -> bytes:
    """The segment as it goes on the air."""
    stamp, fmt = header.stamp, header.format
    kind = MODALITIES.index(stamp.modality) + 16 * PRECISIONS[fmt.precision]
    version, sender = version_of(stamp.sender), [stamp.sender] if stamp.sender else []
    rest = stamp.frame_id, stamp.time_us, stamp.x_m, stamp.y_m, stamp.yaw_rad, *fmt.shape
    common = _COMMON[version].pack(MAGIC, version, kind, *sender, *rest)
    exponents = np.array(fmt.exponents, dtype=np.int8).tobytes()
    segment = common + exponents + _CELLS.pack(header.first_cell, header.cell_count) + body
    return segment + _CRC.pack(zlib.crc32(segment))


def unseal(payload: bytes) -> tuple[SegmentHeader, bytes]:
    """Header and body of a segment; raise ``PacketError`` where it is damaged, cut short or foreign."""
    _check_frame(payload)
    common = _COMMON[payload[2]].size + _exponent_bytes(payload)
    if len(payload) < common + _CELLS.size + _CRC.size:
        raise PacketError(f"segment: {len(payload)} B end inside the header")
    header = SegmentHeader(*_parse_common(payload[:common]), *_CELLS.unpack_from(payload, common))
    return header, payload[common + _CELLS.size : -_CRC.size]


def _check_frame(payload: bytes) -> None:
    """Length, magic, version, checksum: in this order, so that the message names what is wrong."""
    if len(payload) < SHORTEST:
        raise PacketError(f"segment: expected at least {SHORTEST} B, found {len(payload)}")
    if payload[:2] != MAGIC:
        raise PacketError(f"segment: expected magic {MAGIC!r}, found {payload[:2]!r}")
    if payload[2] not in _COMMON:
        raise PacketError(f"segment: expected version {' or '.join(map(str, _COMMON))}, found {payload[2]}")
    if zlib.crc32(payload[: -_CRC.size]) != _CRC.unpack(payload[-_CRC.size :])[0]:
        raise PacketError("segment: checksum does not match")


def _exponent_bytes(payload: bytes) -> int:
    """Bytes behind the common header: for int8 (see the kind) one per channel."""
    *_, channels, _, _ = _COMMON[payload[2]].unpack_from(payload)
    return channels if payload[3] // 16 == PRECISIONS["int8"] else 0


@lru_cache(maxsize=32)
def _parse_common(common: bytes) -> tuple[MapStamp, MapFormat]:
    """Stamp and format; all segments of a map begin with the same bytes."""
    layout = _COMMON[common[2]]
    _, _, kind, *sender, frame_id, time_us, x, y, yaw, channels, height, width = layout.unpack_from(common)
    modality, precision = _of_kind(kind)
    exponents = np.frombuffer(common[layout.size :], dtype=np.int8).tolist()
    stamp = MapStamp(frame_id, time_us, modality, x, y, yaw, *sender)
    return stamp, MapFormat(channels, height, width, precision, tuple(exponents))


def _of_kind(kind: int) -> tuple[str, str]:
    modality, precision = kind % 16, kind // 16
    if modality >= len(MODALITIES) or precision >= len(PRECISIONS):
        raise PacketError(f"segment: unknown modality {modality} or precision {precision}")
    return MODALITIES[modality], list(PRECISIONS)[precision]
