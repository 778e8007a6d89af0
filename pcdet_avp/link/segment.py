"""The bytes of a segment: header, body, checksum.

Little-endian. Common to all segments of a map (33 B, in versions 2 and 3 35 B; for int8 and a byte per channel):
    magic 2s  version u8  kind u8 (modality + 16 precision)  [versions 2 and 3: sender u16]  frame id u32
    time stamp u64 us  pose 3 f32 (x m, y m, yaw rad: world_from_agent)  channels u8  height u16  width u16
    [int8: exponents i8]
The segment's own (8 B, in version 3 12 B, and 4 B at its end): first cell u32, cells u32,
    [version 3: bytes of the body u32]  the body  [version 3: padding]  a CRC-32 of all before it.
Every segment repeats the common part, so that any one of them decodes without the others.

Version 1 has no sender and means number 0. Number 0 is written as version 1, so that a site's only unit sends the
bytes that it always sent; every other number is written as version 2. A segment that is filled up to a size, which a
reader of versions 1 and 2 would take for damaged, is written as version 3. All three are read.
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
PADDED = 3  # the version that says how long its body is
_COMMON = {1: struct.Struct("<2sBBIQ3fBHH"), 2: struct.Struct("<2sBBHIQ3fBHH")}  # by version
_COMMON[PADDED] = _COMMON[2]
_CELLS, _LENGTH, _CRC = struct.Struct("<II"), struct.Struct("<I"), struct.Struct("<I")
SHORTEST = _COMMON[1].size + _CELLS.size + _CRC.size


def version_of(sender: int) -> int:
    """The version in which a unit's segments are written, unless they are padded."""
    return 2 if sender else 1


def overhead_bytes(map_format: MapFormat, sender: int = 0, padded: bool = False) -> int:
    """Bytes of a segment beside its entropy-coded body and padding: both headers and the checksum."""
    version = PADDED if padded else version_of(sender)
    return _COMMON[version].size + len(map_format.exponents) + _own_bytes(version) + _CRC.size


def padding_overhead_bytes(sender: int) -> int:
    """What the header of a padded segment takes beyond that of one without padding."""
    version = version_of(sender)
    return _COMMON[PADDED].size + _own_bytes(PADDED) - _COMMON[version].size - _own_bytes(version)


def seal(header: SegmentHeader, body: bytes, size: int | None = None) -> bytes:
    """The segment as it goes on the air; with ``size``, filled up with zeros to so many bytes."""
    fmt, version = header.format, version_of(header.stamp.sender) if size is None else PADDED
    exponents = np.array(fmt.exponents, dtype=np.int8).tobytes()
    segment = _common(header, version) + exponents + _CELLS.pack(header.first_cell, header.cell_count)
    if size is not None:
        padding = size - overhead_bytes(fmt, padded=True) - len(body)
        if padding < 0:
            raise PacketError(f"segment: {size - padding} B cannot be filled up to {size} B")
        segment, body = segment + _LENGTH.pack(len(body)), body + bytes(padding)
    return segment + body + _CRC.pack(zlib.crc32(segment + body))


def _common(header: SegmentHeader, version: int) -> bytes:
    stamp, fmt = header.stamp, header.format
    kind = MODALITIES.index(stamp.modality) + 16 * PRECISIONS[fmt.precision]
    sender = [] if version == 1 else [stamp.sender]
    rest = stamp.frame_id, stamp.time_us, stamp.x_m, stamp.y_m, stamp.yaw_rad, *fmt.shape
    return _COMMON[version].pack(MAGIC, version, kind, *sender, *rest)


def _own_bytes(version: int) -> int:
    """Bytes of the segment's own header."""
    return _CELLS.size + (_LENGTH.size if version == PADDED else 0)


def unseal(payload: bytes) -> tuple[SegmentHeader, bytes]:
    """Header and body of a segment; raise ``PacketError`` where it is damaged, cut short or foreign."""
    _check_frame(payload)
    common = _COMMON[payload[2]].size + _exponent_bytes(payload)
    start, end = common + _own_bytes(payload[2]), len(payload) - _CRC.size
    if end < start:
        raise PacketError(f"segment: {len(payload)} B end inside the header")
    header = SegmentHeader(*_parse_common(payload[:common]), *_CELLS.unpack_from(payload, common))
    return header, payload[start : _end_of_body(payload, start, end)]


def _end_of_body(payload: bytes, start: int, end: int) -> int:
    """Where the body ends; of a padded segment, the rest up to ``end`` means nothing."""
    if payload[2] != PADDED:
        return end
    (length,) = _LENGTH.unpack_from(payload, start - _LENGTH.size)
    if length > end - start:
        raise PacketError(f"segment: a body of {length} B does not fit the {end - start} B behind its header")
    return start + length


def _check_frame(payload: bytes) -> None:
    """Length, magic, version, checksum: in this order, so that the message names what is wrong."""
    if len(payload) < SHORTEST:
        raise PacketError(f"segment: expected at least {SHORTEST} B, found {len(payload)}")
    if payload[:2] != MAGIC:
        raise PacketError(f"segment: expected magic {MAGIC!r}, found {payload[:2]!r}")
    if payload[2] not in _COMMON:
        raise PacketError(f"segment: expected version {min(_COMMON)} to {max(_COMMON)}, found {payload[2]}")
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
