"""One cloud from a file of any kind that README.md here lists."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pcdet_avp.datasets.point_clouds.cloud import Cloud
from pcdet_avp.datasets.point_clouds.columns import read_bin, read_npy
from pcdet_avp.datasets.point_clouds.named import read_pcd, read_ply, read_structured
from pcdet_avp.errors import RecordError

EXTENSIONS = (".bin", ".npy", ".pcd", ".ply")


def read_cloud(file: Path, columns: int | None = None, intensity_scale: float | None = None) -> Cloud:
    """The cloud of one file. ``columns``: of a ``.bin``; ``intensity_scale``: what full intensity is stored as.

    RecordError where the file is damaged, of an unknown kind, lacks an intensity, can be read in several ways, or
    holds values that its layout does not allow.
    """
    kind = file.suffix.lower()
    try:
        if kind == ".bin":
            return read_bin(file, columns, intensity_scale)
        if kind == ".npy":
            return _read_npy(file, columns, intensity_scale)
        if kind in (".pcd", ".ply"):
            return (read_pcd if kind == ".pcd" else read_ply)(file, intensity_scale)
    except (OSError, ValueError, EOFError) as error:
        raise RecordError(f"{file}: not a point cloud ({error})") from error
    raise RecordError(f"{file}: expected a point cloud ({', '.join(EXTENSIONS)}), found another ending")


def _read_npy(file: Path, columns: int | None, scale: float | None) -> Cloud:
    named = np.load(file, allow_pickle=False)
    return read_structured(file, named, scale) if named.dtype.names else read_npy(file, columns, scale)
