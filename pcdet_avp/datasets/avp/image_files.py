"""Images and depth maps as files: written as PNG, read from PNG or JPEG, refused where cut short or damaged."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np

from pcdet_avp.errors import RecordError

DEPTH_UNIT_M = 0.001
DEPTH_LIMIT = 65535  # uint16; farther is written as unknown

# Run-length strategy: on a noisy image smaller than the default and twice as fast.
COLOUR_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
DEPTH_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_DEFAULT]

_PNG_START, _JPEG_START = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
_MARKER, _START_OF_SCAN, _END_OF_IMAGE = 0xFF, 0xDA, 0xD9
_WITHOUT_LENGTH = (0x01, *range(0xD0, 0xD8))
# 0xFF is followed by 0 where it is data, and by 0xD0 to 0xD7 where decoding restarts.
_AFTER_CODED_DATA = re.compile(rb"\xff[^\x00\xd0-\xd7]", re.DOTALL)


def is_jpeg(data: bytes) -> bool:
    """Whether a file begins as a JPEG does."""
    return data.startswith(_JPEG_START)


def encode_image(image: np.ndarray) -> bytes:
    """(H, W, 3) uint8 RGB as PNG."""
    return cv2.imencode(".png", cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2BGR), COLOUR_PNG)[1].tobytes()


def encode_depth(depth: np.ndarray) -> bytes:
    """(H, W) metres as a 16-bit PNG of millimetres; 0, negative, not finite or beyond 65.535 m becomes 0."""
    with np.errstate(invalid="ignore"):
        mm = np.round(np.asarray(depth, np.float64) / DEPTH_UNIT_M)
        mm = np.where((mm > 0) & (mm <= DEPTH_LIMIT), mm, 0)
    return cv2.imencode(".png", mm.astype(np.uint16), DEPTH_PNG)[1].tobytes()


def decode_image(data: bytes, file: Path) -> np.ndarray:
    """(H, W, 3) uint8 RGB."""
    _check_whole(data, file)
    # An orientation tag would turn the image under its calibration.
    image = _decode(data, file, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def decode_depth(data: bytes, file: Path) -> np.ndarray:
    """(H, W) float32 metres, 0 = unknown."""
    if not data.startswith(_PNG_START):
        raise RecordError(f"{file}: a depth map must be a 16-bit PNG, found another file type")
    _check_whole(data, file)
    raw = _decode(data, file, cv2.IMREAD_UNCHANGED)
    if raw.dtype != np.uint16 or raw.ndim != 2:
        raise RecordError(f"{file}: a depth map must have one 16-bit channel, found {raw.dtype} {raw.shape}")
    return raw.astype(np.float32) * np.float32(DEPTH_UNIT_M)


def _decode(data: bytes, file: Path, flags: int) -> np.ndarray:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise RecordError(f"{file}: cannot be decoded ({error})") from error
    if image is None:
        raise RecordError(f"{file}: cannot be decoded as an image")
    return image


def _check_whole(data: bytes, file: Path) -> None:
    """Decoders fill what is missing with grey and say nothing, so look for the end of the file first.

    What stands behind the end, padding or a second picture, is nobody's business.
    """
    if data.startswith(_PNG_START):
        _check_png(data, file)
    elif data.startswith(_JPEG_START):
        _check_jpeg(data, file)
    else:
        raise RecordError(f"{file}: neither PNG nor JPEG, or empty ({len(data)} bytes)")


def _check_jpeg(data: bytes, file: Path) -> None:
    """Walk the segments (marker, length, data) to the end-of-image marker; coded data hold no marker but restarts."""
    at = len(_JPEG_START) - 1
    while at + 2 <= len(data) and data[at] == _MARKER:
        kind = data[at + 1]
        if kind == _END_OF_IMAGE:
            return
        if kind == _MARKER:  # fill byte
            at += 1
            continue
        at += 2 + (0 if kind in _WITHOUT_LENGTH else int.from_bytes(data[at + 2 : at + 4], "big"))
        if kind == _START_OF_SCAN:
            found = _AFTER_CODED_DATA.search(data, at)
            at = found.start() if found else len(data)
    raise RecordError(f"{file}: truncated JPEG, no end-of-image marker in {len(data)} bytes")


def _check_png(data: bytes, file: Path) -> None:
    """Walk the chunks (length, type, data, checksum) to the closing IEND."""
    at = len(_PNG_START)
    while at + 12 <= len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        end = at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(memoryview(data)[at + 4 : end - 4]) != struct.unpack(">I", data[end - 4 : end])[0]:
            raise RecordError(f"{file}: damaged PNG, checksum of chunk {kind!r} at byte {at} is wrong")
        if kind == b"IEND":
            return
        at = end
    raise RecordError(f"{file}: truncated PNG, no IEND chunk in {len(data)} bytes")
