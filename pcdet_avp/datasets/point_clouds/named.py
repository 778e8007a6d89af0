"""Clouds whose file names its fields: PCD by pypcd4, PLY by plyfile, structured ``.npy``. Fields in any order."""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcdet_avp.datasets.point_clouds.cloud import SCALE_HINT, Cloud, finite_rows, intensity_problem, position_problem
from pcdet_avp.errors import RecordError

INSTALL = 'pip install "pcdet_avp[clouds]"'
# In the order of preference; compared without upper case.
INTENSITY_NAMES = ("intensity", "i", "scalar_intensity", "reflectivity", "reflectance", "remission")
COLOURS = {"rgb", "rgba"}  # PCL's packed colours
BYTE = 255.0

Fields = Mapping[str, np.ndarray]  # name -> (P,)


def read_pcd(file: Path, scale: float | None) -> Cloud:
    """ascii, binary or binary_compressed."""
    try:
        from pypcd4 import PointCloud
    except ImportError as error:
        raise RecordError(f"{file}: PCD is read by pypcd4: {INSTALL}") from error
    try:
        cloud = PointCloud.from_fileobj(io.BufferedReader(io.BytesIO(_tidy_pcd(file.read_bytes()))))
        data = np.atleast_1d(cloud.pc_data)
        fields = {name.lower(): data[name] for name in data.dtype.names or ()}
        for packed in COLOURS & fields.keys():
            fields |= dict(zip(("red", "green", "blue"), _unpack_rgb(fields[packed]), strict=True))
    except (ValueError, RuntimeError, KeyError, IndexError, TypeError, struct.error) as error:
        raise RecordError(f"{file}: not a PCD file, or damaged ({_first_line(error)})") from error
    if len(data) != cloud.metadata.points:
        raise RecordError(f"{file}: truncated: POINTS says {cloud.metadata.points}, found {len(data)}")
    return from_fields(file, fields, scale, f"PCD ({cloud.metadata.data.value})")


def _tidy_pcd(data: bytes) -> bytes:
    """With the optional COUNT line; columns of ascii parted by one space, as pypcd4 expects both."""
    head = re.match(rb"(?s).*?^DATA[ \t]+(\w+)[^\n]*\n", data, re.MULTILINE)
    if head is None:
        raise ValueError("no DATA line")
    header, body = head.group(0), data[head.end() :]
    fields = re.search(rb"^FIELDS[ \t]+([^\r\n]*)", header, re.MULTILINE)
    if fields and not re.search(rb"^COUNT\b", header, re.MULTILINE):
        ones = b" ".join([b"1"] * len(fields.group(1).split()))
        header = header.replace(b"\nWIDTH", b"\nCOUNT " + ones + b"\nWIDTH", 1)
    if head.group(1) == b"ascii":
        body = b"".join(b" ".join(line.split()) + b"\n" for line in body.splitlines() if line.strip())
    return header + body


def _unpack_rgb(packed: np.ndarray) -> list[np.ndarray]:
    """(P,) float32, uint32 or int32 with 0xAARRGGBB -> red, green, blue (P,) uint8."""
    bits = np.ascontiguousarray(packed, np.float32).view(np.uint32) if packed.dtype.kind == "f" else packed
    return [((bits >> shift) & 255).astype(np.uint8) for shift in (16, 8, 0)]


def read_ply(file: Path, scale: float | None) -> Cloud:
    """ascii or binary, the element ``vertex``."""
    try:
        from plyfile import PlyData, PlyParseError
    except ImportError as error:
        raise RecordError(f"{file}: PLY is read by plyfile: {INSTALL}") from error
    try:
        vertex = PlyData.read(str(file), mmap=False)["vertex"]
        fields = {p.name.lower(): np.asarray(vertex[p.name]) for p in vertex.properties}
    except (PlyParseError, ValueError, KeyError, IndexError, TypeError) as error:
        raise RecordError(f"{file}: not a PLY file with vertices, or damaged ({_first_line(error)})") from error
    return from_fields(file, fields, scale, "PLY")


def read_structured(file: Path, rows: np.ndarray, scale: float | None) -> Cloud:
    """An .npy array with named fields."""
    fields = {name.lower(): rows[name].ravel() for name in rows.dtype.names or ()}
    return from_fields(file, fields, scale, ".npy")


def from_fields(file: Path, fields: Fields, scale: float | None, kind: str) -> Cloud:
    """x, y, z and an intensity out of named columns (P,)."""
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise RecordError(f"{file}: no field {', '.join(missing)}; fields: {', '.join(fields) or 'none'}")
    name, values = _intensity(file, fields)
    divisor = scale or (BYTE if values.dtype == np.uint8 else 1.0)
    rows = np.stack([np.asarray(v, np.float64) for v in (fields["x"], fields["y"], fields["z"], values)], 1)
    good = finite_rows(rows)
    problem = position_problem(good) or intensity_problem(good[:, 3], divisor)
    if problem:
        raise RecordError(f"{file}: {problem} (field {name}, {values.dtype}). {SCALE_HINT}")
    good[:, 3] /= divisor
    layout = f"{kind}: x, y, z, intensity = {name} / {divisor:g}"
    return Cloud(good.astype(np.float32), layout, len(rows) - len(good))


def _intensity(file: Path, fields: Fields) -> tuple[str, np.ndarray]:
    """By name; or red, where the colour is grey or red alone, as Open3D and OPV2V keep an intensity."""
    for name in INTENSITY_NAMES:
        if name in fields:
            return name, fields[name]
    if all(name in fields for name in ("red", "green", "blue")):
        red, green, blue = (fields[name] for name in ("red", "green", "blue"))
        if np.array_equal(green, blue) and (not green.any() or np.array_equal(red, green)):
            return "red", red
    raise RecordError(f"{file}: no intensity among its fields {', '.join(fields)}; known: {', '.join(INTENSITY_NAMES)}")


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
