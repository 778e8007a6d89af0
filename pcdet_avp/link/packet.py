"""A sparse BEV map to bytes and back (paper, section "Feature Compression").

``encode`` cuts a map (C, H, W) into segments, each a run of cells in raster order that fits one transport block
and decodes alone: rows where the map is empty enough, parts of a row where it is not. A lost segment blanks its
cells, not the map. ``decode`` puts any subset of a map's segments together and says which cells are present;
a cell that was sent empty is present and zero.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import PacketError
from pcdet_avp.link.cell_coder import decode_run, encode_run, scratch
from pcdet_avp.link.header import MapFormat, MapStamp, SegmentHeader
from pcdet_avp.link.precision import PRECISIONS, from_codes, int8_exponents, to_codes
from pcdet_avp.link.segment import overhead_bytes, seal, unseal, version_of


@dataclass(frozen=True, eq=False)
class Segment:
    """A decoded run of cells: codes (cells, C) uint16 (see ``cell_models``)."""

    header: SegmentHeader
    codes: np.ndarray


@dataclass(frozen=True, eq=False)
class LatentMap:
    """What is known of a map: values (C, H, W) float32, zero where absent; present (H, W) bool."""

    stamp: MapStamp
    format: MapFormat
    values: np.ndarray
    present: np.ndarray


def encode(
    latent: np.ndarray,
    stamp: MapStamp,
    max_segment_bytes: int,
    precision: str = "float16",
    exponents: np.ndarray | None = None,
) -> list[bytes]:
    """Segments of a map (C, H, W) of floats, each of at most ``max_segment_bytes``; exact zeros are empty elements.

    int8 sends multiples of 2**exponents[c]; without ``exponents`` (C,) they are the smallest that clip nothing.
    """
    if latent.ndim != 3 or latent.dtype.kind != "f":
        raise PacketError(f"latent: expected floats (C, H, W), found {latent.dtype} {latent.shape}")
    if precision == "int8" and exponents is None:
        exponents = int8_exponents(latent)
    channels, height, width = latent.shape
    sent_exponents = () if exponents is None else tuple(int(e) for e in exponents)
    fmt = MapFormat(channels, height, width, precision, sent_exponents)
    codes = to_codes(latent, precision, exponents)
    budget = max_segment_bytes - overhead_bytes(fmt, version_of(stamp.sender, stamp.network))
    return [seal(SegmentHeader(stamp, fmt, first, cells), body) for first, cells, body in _runs(codes, fmt, budget)]


def decode_segment(payload: bytes) -> Segment:
    """The cells of one segment; ``PacketError`` where it is damaged, cut short, foreign or too large."""
    return open_body(*unseal(payload))


def decode(payloads: Iterable[bytes]) -> LatentMap:
    """The map that any of its segments make, in any order; needs at least one, all of one map."""
    partial = None
    for segment in map(decode_segment, payloads):
        partial = partial or PartialMap(segment.header)
        partial.add(segment)
    if partial is None:
        raise PacketError("decode: expected at least one segment, found none")
    return partial.as_map()


def open_body(header: SegmentHeader, body: bytes) -> Segment:
    """Decode the body that came with a header."""
    fmt = header.format
    codes = np.zeros((header.cell_count, fmt.channels), np.uint16)
    if not decode_run(np.frombuffer(body, np.uint8), codes, fmt.width, PRECISIONS[fmt.precision]):
        raise PacketError(f"segment of frame {header.stamp.frame_id}: its body decodes to no map")
    return Segment(header, codes)


class PartialMap:
    """A map that grows segment by segment."""

    def __init__(self, header: SegmentHeader) -> None:
        self.stamp, self.format = header.stamp, header.format
        self._codes = np.zeros((self.format.cells, self.format.channels), np.uint16)
        self._present = np.zeros(self.format.cells, bool)

    @property
    def cells_present(self) -> int:
        return int(np.count_nonzero(self._present))

    def holds(self, header: SegmentHeader) -> bool:
        """Whether every cell of a segment of this map is here already; raise where it is of another map."""
        if (header.stamp, header.format) != (self.stamp, self.format):
            raise PacketError(f"segment says {header.stamp} {header.format}, its map {self.stamp} {self.format}")
        present = self._present[header.first_cell : header.first_cell + header.cell_count]
        if present.any() and not present.all():
            raise PacketError(f"segment at cell {header.first_cell} overlaps another one of its map")
        return bool(present.all())

    def add(self, segment: Segment) -> None:
        """Put a segment's cells in their place; a repeated one changes nothing."""
        if not self.holds(segment.header):
            cells = slice(segment.header.first_cell, segment.header.first_cell + segment.header.cell_count)
            self._codes[cells], self._present[cells] = segment.codes, True

    def as_map(self) -> LatentMap:
        """A copy of what is here."""
        fmt = self.format
        values = from_codes(self._codes, fmt.precision, fmt.exponents).reshape(fmt.shape)
        return LatentMap(self.stamp, fmt, values, self._present.reshape(fmt.shape[1:]).copy())


def _runs(codes: np.ndarray, fmt: MapFormat, budget: int) -> Iterable[tuple[int, int, bytes]]:
    """(first cell, number of cells, body) of segments that cover all cells, each body within the budget (bytes)."""
    octaves, out = scratch(fmt.cells, fmt.width, fmt.channels, max(budget, 0))
    precision, first = PRECISIONS[fmt.precision], 0
    while first < fmt.cells:
        stop, size = encode_run(codes, first, fmt.cells, fmt.width, precision, budget, octaves, out)
        if stop == first:
            raise PacketError(
                f"segments of {budget} B behind their headers cannot hold a cell of {fmt.channels} channels"
            )
        if size < 0:
            stop, size = encode_run(codes, first, stop, fmt.width, precision, budget, octaves, out)
        yield first, stop - first, out[:size].tobytes()
        first = stop
