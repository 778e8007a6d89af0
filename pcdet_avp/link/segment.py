"""The bytes of a segment: header, body, checksum.

Little-endian. Common to all segments of a map (33 B, in versions 2 and 3 35 B, in 4 39 B; for int8 and a byte per
channel):
    magic 2s  version u8  kind u8 (modality + 16 precision)  [versions 2 to 4: sender u16]  [version 4: network u32]
    frame id u32  time stamp u64 us  pose 3 f32 (x m, y m, yaw rad: world_from_agent)
    channels u8  height u16  width u16  [int8: exponents i8]
The segment's own (8 B, in versions 3 and 4 12 B, and 4 B at its end): first cell u32, cells u32,
    [versions 3 and 4: bytes of the body u32]  the body  [versions 3 and 4: padding]  a CRC-32 of all before it.
Every segment repeats the common part, so that any one of them decodes without the others.

Version 1 has no sender and means number 0. Number 0 is written as version 1, so that a site's only unit sends the
bytes that it always sent; every other number is written as version 2. A segment that is filled up to a size, which a
reader of versions 1 and 2 would take for damaged, is written as version 3, and one that says which network made the
map as version 4. All are read.
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
PLAIN, OF_UNIT, PADDED, OF_NETWORK = 1, 2, 3, 4  # versions; each says more than those before it
_COMMON = {
    PLAIN: struct.Struct("<2sBBIQ3fBHH"),
    OF_UNIT: struct.Struct("<2sBBHIQ3fBHH"),
    PADDED: struct.Struct("<2sBBHIQ3fBHH"),
    OF_NETWORK: struct.Struct("<2sBBHIIQ3fBHH"),
}
_CELLS, _LENGTH, _CRC = struct.Struct("<II"), struct.Struct("<I"), struct.Struct("<I")
SHORTEST = _COMMON[PLAIN].size + _CELLS.size + _CRC.size


def version_of(sender: int, network: int = 0, padded: bool = False) -> int:
    """The version in which the segments of a unit's maps are written (see ``MapStamp``)."""
    if network:
        return OF_NETWORK
    if padded:
        return PADDED
    return OF_UNIT if sender else PLAIN


def overhead_bytes(map_format: MapFormat, version: int = PLAIN) -> int:
    """Bytes of a segment beside its entropy-coded body and padding: both headers and the checksum."""
    return _COMMON[version].size + len(map_format.exponents) + _own_bytes(version) + _CRC.size


def padding_overhead_bytes(sender: int, network: int = 0) -> int:
    """What the header of a padded segment takes beyond that of one without padding."""
    padded, bare = (version_of(sender, network, padded) for padded in (True, False))
    return _COMMON[padded].size + _own_bytes(padded) - _COMMON[bare].size - _own_bytes(bare)


def seal(header: SegmentHeader, body: bytes, size: int | None = None) -> bytes:
    """The segment as it goes on the air; with ``size``, filled up with zeros to so many bytes."""
    fmt, version = header.format, version_of(header.stamp.sender, header.stamp.network, padded=size is not None)
    exponents = np.array(fmt.exponents, dtype=np.int8).tobytes()
    segment = _common(header, version) + exponents + _CELLS.pack(header.first_cell, header.cell_count)
    if version >= PADDED:
        segment += _LENGTH.pack(len(body))
    segment += body
    if size is not None:
        least = len(segment) + _CRC.size
        if least > size:
            raise PacketError(f"segment: {least} B cannot be filled up to {size} B")
        segment += bytes(size - least)
    return segment + _CRC.pack(zlib.crc32(segment))


def _common(header: SegmentHeader, version: int) -> bytes:
    stamp, fmt = header.stamp, header.format
    kind = MODALITIES.index(stamp.modality) + 16 * PRECISIONS[fmt.precision]
    origin = {PLAIN: [], OF_NETWORK: [stamp.sender, stamp.network]}.get(version, [stamp.sender])
    rest = stamp.frame_id, stamp.time_us, stamp.x_m, stamp.y_m, stamp.yaw_rad, *fmt.shape
    return _COMMON[version].pack(MAGIC, version, kind, *origin, *rest)


def _own_bytes(version: int) -> int:
    """Bytes of the segment's own header."""
    return _CELLS.size + (_LENGTH.size if version >= PADDED else 0)


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
    if payload[2] < PADDED:
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
    _, _, kind, *origin, frame_id, time_us, x, y, yaw, channels, height, width = layout.unpack_from(common)
    modality, precision = _of_kind(kind)
    exponents = np.frombuffer(common[layout.size :], dtype=np.int8).tolist()
    stamp = MapStamp(frame_id, time_us, modality, x, y, yaw, *origin)
    return stamp, MapFormat(channels, height, width, precision, tuple(exponents))


def _of_kind(kind: int) -> tuple[str, str]:
    modality, precision = kind % 16, kind // 16
    if modality >= len(MODALITIES) or precision >= len(PRECISIONS):
        raise PacketError(f"segment: unknown modality {modality} or precision {precision}")
    return MODALITIES[modality], list(PRECISIONS)[precision]
