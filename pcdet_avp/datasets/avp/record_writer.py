"""Writing records to disk: the same record gives the same bytes."""

from __future__ import annotations

import errno
import os
import shutil
import uuid
import zlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pcdet_avp.datasets.avp.checks import (
    check_depth,
    check_image,
    check_labels,
    check_points,
    check_time,
    check_upright,
)
from pcdet_avp.datasets.avp.fields import write_record_json
from pcdet_avp.datasets.avp.image_files import encode_depth, encode_image, is_jpeg
from pcdet_avp.datasets.avp.layout import FRAME_FILE, PARTIAL_SUFFIX, POINT_LIST, RANGE_IMAGE, SCHEMA_VERSION, frame_dir
from pcdet_avp.datasets.avp.scan_codec import encode_scan
from pcdet_avp.datasets.avp.units import EGO, Record, check_unit_name
from pcdet_avp.errors import GeometryError, RecordError
from pcdet_avp.structures.frame import AgentView, Frame, Labels
from pcdet_avp.structures.lidar_scan import LidarScan
from pcdet_avp.structures.pose import Pose

Files = dict[str, bytes]  # name -> content, in the order of writing


def write_frame(root: str | Path, frame: Frame) -> int:
    """Write one frame, its roadside unit under the name ``infra``; see ``write_record``."""
    return write_record(root, Record.of(frame))


def write_record(root: str | Path, record: Record, images: Mapping[str, bytes] | None = None) -> int:
    """Write one record below ``root``, replacing an older one of the same id. Returns the bytes it takes.

    ``images``: the PNG or JPEG files that images of the record were decoded from, by the agent's name (``ego`` or a
    unit's); they are stored as they are, not encoded anew. RecordError, and nothing is written, where ``read_record``
    would refuse it.
    """
    folder = frame_dir(root, record.frame_id)
    files: Files = {}
    given = images or {}
    content = {
        "schema_version": SCHEMA_VERSION,
        "frame_id": record.frame_id,
        "time_s": _checked(record, "", check_time, record.time_s),
        "ego": _agent(record, EGO, record.ego, files, given.get(EGO)),
        "roadside_units": [
            {"name": _checked(record, "", check_unit_name, name), **_agent(record, name, view, files, given.get(name))}
            for name, view in record.units.items()
        ],
        "labels": _labels(_checked(record, "", check_labels, record.labels)),
    }
    content["files"] = {n: {"bytes": len(data), "crc32": f"{zlib.crc32(data):08x}"} for n, data in files.items()}
    return _write_folder(folder, files, content)


def _write_folder(folder: Path, files: Files, content: dict) -> int:
    """All files into a folder beside the final one, then one rename."""
    partial = _beside(folder)
    try:
        partial.mkdir(parents=True)
        for name, data in files.items():
            (partial / name).write_bytes(data)
        size = write_record_json(partial / FRAME_FILE, content)
        _move_into_place(partial, folder)
    except OSError as error:
        raise RecordError(f"{folder}: cannot write this frame ({error.strerror})") from error
    finally:
        if partial.exists():
            shutil.rmtree(partial, ignore_errors=True)
    return size + sum(map(len, files.values()))


def _move_into_place(partial: Path, folder: Path) -> None:
    """A rename cannot replace a folder that is not empty, so an older frame is first moved aside."""
    while True:
        try:
            os.rename(partial, folder)
            return
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
        old = _beside(folder)
        with suppress(FileNotFoundError):
            os.rename(folder, old)
        shutil.rmtree(old, ignore_errors=True)


def _beside(folder: Path) -> Path:
    """A name in the same place that no other writer uses and no reader looks at."""
    return folder.with_name(f".{folder.name}.{uuid.uuid4().hex}{PARTIAL_SUFFIX}")


def _checked(record: Record, what: str, check, *args):
    try:
        return check(*args)
    except GeometryError as error:
        raise RecordError(f"frame {record.frame_id}: {what}{error}") from error


def _agent(record: Record, agent: str, view: AgentView, files: Files, image: bytes | None) -> dict:
    pose = view.world_from_agent
    return {
        "world_from_agent": _matrix(_checked(record, f"{agent}.world_from_agent: ", check_upright, pose)),
        "camera": _camera(record, agent, view, files, image),
        "lidar": _lidar(record, agent, view, files),
    }


def _camera(record: Record, agent: str, view: AgentView, files: Files, image: bytes | None) -> dict | None:
    camera = view.camera
    if camera is None:
        if view.image is not None or view.depth is not None:
            raise RecordError(f"frame {record.frame_id}: {agent}: an image or a depth map without its camera")
        return None
    entry: dict[str, Any] = {
        **{key: int(getattr(camera, key)) for key in ("width", "height")},
        **{key: float(getattr(camera, key)) for key in ("fx", "fy", "cx", "cy")},
        "agent_from_camera": _matrix(camera.agent_from_camera),
        "image": None,
        "depth": None,
    }
    picture = f"{agent}_camera.{'jpg' if image is not None and is_jpeg(image) else 'png'}"
    for key, array, check, encode, name, given in (
        ("image", view.image, check_image, encode_image, picture, image),
        ("depth", view.depth, check_depth, encode_depth, f"{agent}_depth.png", None),
    ):
        if array is not None:
            checked = _checked(record, f"{agent}.{key}: ", check, array, camera.height, camera.width)
            entry[key], files[name] = name, encode(checked) if given is None else given
    return entry


def _lidar(record: Record, agent: str, view: AgentView, files: Files) -> dict | None:
    if view.scan is not None:
        name = f"{agent}_lidar.scan.zst"
        files[name] = encode_scan(view.scan)
        return {"format": RANGE_IMAGE, "file": name, **_model(view.scan)}
    if view.points is not None:
        name = f"{agent}_lidar.bin"
        files[name] = _checked(record, f"{agent}.points: ", check_points, view.points).tobytes()
        return {"format": POINT_LIST, "file": name}
    return None


def _model(scan: LidarScan) -> dict:
    model = scan.model
    return {
        "beams": int(model.beams),
        "columns": int(model.columns),
        "elevation_min_rad": float(model.elevation_min),
        "elevation_max_rad": float(model.elevation_max),
        "azimuth_span_rad": float(model.azimuth_span),
        "agent_from_lidar": _matrix(model.agent_from_lidar),
    }


def _labels(labels: Labels) -> list[dict]:
    return [
        {
            "class": str(labels.names[i]),
            "box": [float(v) for v in labels.boxes[i, :7]],
            "id": int(labels.object_ids[i]),
            "visible_vertices": int(labels.visible_vertices[i]),
            "hits": [int(v) for v in labels.hit_counts[i]],
        }
        for i in range(len(labels))
    ]


def _matrix(pose: Pose) -> list[list[float]]:
    return pose.matrix.tolist()
