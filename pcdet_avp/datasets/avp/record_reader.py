"""Reading records from disk. Nothing is taken on trust: each problem is one RecordError naming file and field."""

from __future__ import annotations

import zlib
from collections.abc import Collection
from pathlib import Path

import numpy as np

from pcdet_avp.datasets.avp.checks import check_points, check_upright, check_vertices
from pcdet_avp.datasets.avp.fields import Field
from pcdet_avp.datasets.avp.image_files import decode_depth, decode_image
from pcdet_avp.datasets.avp.layout import FRAME_FILE, POINT_LIST, RANGE_IMAGE, check_schema, frame_dir
from pcdet_avp.datasets.avp.scan_codec import decode_scan
from pcdet_avp.datasets.avp.units import EGO, FIRST_UNIT, Record, check_unit_name, chosen_unit
from pcdet_avp.errors import GeometryError, RecordError, SensorError
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.ego import centre_in_ego
from pcdet_avp.structures.frame import CLASS_NAMES, AgentView, Frame, Labels
from pcdet_avp.structures.lidar_scan import LidarModel
from pcdet_avp.structures.sensor_set import SOURCES

# What an object counts as where a recording does not say how well it was seen.
DEFAULT_VISIBLE_VERTICES = 8
NO_HITS = (0,) * len(SOURCES)


def read_frame(
    root: str | Path,
    frame_id: str,
    sources: Collection[str] = SOURCES,
    keep_ego: bool = False,
    unit: str | None = None,
) -> Frame:
    """One frame with its calibration and labels, and the data of those sensors that ``sources`` names.

    A sensor that was not asked for, or not recorded, is None in its ``AgentView``; its camera model is there.
    Of several roadside units the one named ``unit`` is read, else the first; without any, the roadside has no sensors.
    A label whose centre lies in the ego's footprint is the ego itself, which is no object: it is left out unless
    ``keep_ego``.
    """
    top = _load(root, frame_id, sources)
    name = _chosen(top, unit)
    return _record(top, [] if name is None else [name], sources, keep_ego).frame(name)


def read_record(root: str | Path, frame_id: str, sources: Collection[str] = SOURCES, keep_ego: bool = False) -> Record:
    """As ``read_frame``, with every roadside unit; ``infra_camera`` and ``infra_lidar`` mean those of all of them."""
    top = _load(root, frame_id, sources)
    return _record(top, _units(top), sources, keep_ego)


def _load(root: str | Path, frame_id: str, sources: Collection[str] = ()) -> Field:
    unknown = set(sources) - set(SOURCES)
    if unknown:
        raise SensorError(f"unknown sources {sorted(unknown)}; known: {', '.join(SOURCES)}")
    top = Field.load(frame_dir(root, frame_id) / FRAME_FILE)
    check_schema(top)
    if top["frame_id"].of(str) != frame_id:
        raise top["frame_id"].error(f"expected {frame_id!r} like the folder, found {top['frame_id'].value!r}")
    return top


def _record(top: Field, names: Collection[str], sources: Collection[str], keep_ego: bool) -> Record:
    units = _units(top)
    ego = _read_agent(top, top["ego"], EGO, sources)
    views = {name: _read_agent(top, units[name], "infra", sources) for name in names}
    labels = read_labels(top)
    labels = labels if keep_ego else labels.select(~centre_in_ego(labels.boxes))
    return Record(top["frame_id"].of(str), top["time_s"].number(), ego, views, labels)


def _units(top: Field) -> dict[str, Field]:
    """The roadside units of a record of any schema version, by name, in their order."""
    if check_schema(top) == 1:
        return {FIRST_UNIT: top["infra"]}
    units: dict[str, Field] = {}
    for entry in top["roadside_units"]:
        name = entry["name"].build(check_unit_name, entry["name"].of(str))
        if name in units:
            raise entry["name"].error(f"{name!r} occurs twice; the names of roadside units differ")
        units[name] = entry
    return units


def _chosen(top: Field, unit: str | None) -> str | None:
    units = _units(top)
    return (top["infra"] if FIRST_UNIT in top.value else top["roadside_units"]).build(chosen_unit, units, unit)


def recorded_sources(root: str | Path, frame_id: str, unit: str | None = None) -> set[str]:
    """The sensors whose data a frame has; of the roadside units the one that ``read_frame`` would take."""
    top = _load(root, frame_id)
    name = _chosen(top, unit)
    agents = {EGO: top["ego"]} | ({} if name is None else {"infra": _units(top)[name]})
    found = set()
    for agent, entry in agents.items():
        camera, lidar = entry["camera"], entry["lidar"]
        found |= {f"{agent}_camera"} if camera and camera.get("image") else set()
        found |= {f"{agent}_lidar"} if lidar else set()
    return found


def read_labels(top: Field) -> Labels:
    """The ground truth of a frame, from its parsed JSON."""
    rows = list(top["labels"])
    if not rows:
        return Labels.empty()
    return top["labels"].build(
        Labels,
        _boxes(rows),
        np.array([_class_name(row["class"]) for row in rows]),
        np.array([row.get("id", i).of(int) for i, row in enumerate(rows)]),
        np.array([_vertices(row.get("visible_vertices", DEFAULT_VISIBLE_VERTICES)) for row in rows]),
        np.stack([_hits(row.get("hits", NO_HITS)) for row in rows]).astype(np.int64),
    )


def _boxes(rows: list[Field]) -> np.ndarray:
    """(N, 7), sizes positive."""
    boxes = np.stack([row["box"].numbers(7) for row in rows])
    flat = (boxes[:, 3:6] <= 0).any(1)
    if flat.any():
        raise rows[int(np.argmax(flat))]["box"].error("every size must be positive")
    return boxes


def _class_name(field: Field) -> str:
    if field.of(str) not in CLASS_NAMES:
        raise field.error(f"unknown class {field.value!r}; known: {', '.join(CLASS_NAMES)}")
    return field.value


def _vertices(field: Field) -> int:
    return field.build(check_vertices, field.of(int))


def _hits(field: Field) -> np.ndarray:
    hits = field.numbers(len(SOURCES))
    if hits.min() < 0:
        raise field.error(f"expected 0 or more, found {hits.min():g}")
    return hits


def _read_agent(top: Field, entry: Field, agent: str, sources: Collection[str]) -> AgentView:
    pose = entry["world_from_agent"].build(check_upright, entry["world_from_agent"].pose())
    camera, image, depth = _read_camera(top, entry["camera"], f"{agent}_camera" in sources)
    scan, points = _read_lidar(top, entry["lidar"], f"{agent}_lidar" in sources)
    return AgentView(pose, camera, image, depth, points, scan)


def _read_camera(top: Field, entry: Field, wanted: bool):
    """(PinholeCamera, image, depth); all None without a camera."""
    if not entry:
        return None, None, None
    camera = entry.build(
        PinholeCamera,
        entry["width"].of(int),
        entry["height"].of(int),
        *(entry[key].number() for key in ("fx", "fy", "cx", "cy")),
        entry["agent_from_camera"].pose(),
    )
    image, depth = (
        _read_picture(top, entry.get(key), decode, camera) if wanted else None
        for key, decode in (("image", decode_image), ("depth", decode_depth))
    )
    return camera, image, depth


def _read_picture(top: Field, field: Field, decode, camera: PinholeCamera) -> np.ndarray | None:
    if not field:
        return None
    data, file = _read_file(top, field)
    picture = decode(data, file)
    if picture.shape[:2] != (camera.height, camera.width):
        height, width = picture.shape[:2]
        raise RecordError(
            f"{file}: {width} x {height} pixels, but {field.name.rsplit('.', 1)[0]} in {FRAME_FILE} "
            f"is for {camera.width} x {camera.height}"
        )
    return picture


def _read_lidar(top: Field, entry: Field, wanted: bool):
    """(LidarScan or None, points (P, 4) float32 or None)."""
    if not entry:
        return None, None
    kind = entry["format"].of(str)
    if kind == POINT_LIST:
        return None, _read_points(top, entry["file"]) if wanted else None
    if kind != RANGE_IMAGE:
        raise entry["format"].error(f"expected {RANGE_IMAGE!r} or {POINT_LIST!r}, found {kind!r}")
    model = entry.build(
        LidarModel,
        entry["beams"].of(int),
        entry["columns"].of(int),
        *(entry[key].number() for key in ("elevation_min_rad", "elevation_max_rad", "azimuth_span_rad")),
        entry["agent_from_lidar"].pose(),
    )
    if not wanted:
        return None, None
    data, file = _read_file(top, entry["file"])
    scan = decode_scan(data, model, file)
    return scan, scan.points()


def _read_points(top: Field, field: Field) -> np.ndarray:
    data, file = _read_file(top, field)
    if len(data) % 16:
        raise RecordError(f"{file}: cloud of wrong length: {len(data)} bytes are no whole number of 4 float32 values")
    try:
        return check_points(np.frombuffer(data, "<f4").reshape(-1, 4)).astype(np.float32)
    except GeometryError as error:
        raise RecordError(f"{file}: {error}") from error


def _read_file(top: Field, field: Field) -> tuple[bytes, Path]:
    """The content of a file of this frame, held against its recorded size and checksum where there are any."""
    name = field.of(str)
    if "/" in name or "\\" in name or name.startswith("."):
        raise field.error(f"expected the name of a file in this folder, found {name!r}")
    file = top.file.parent / name
    try:
        data = file.read_bytes()
    except OSError as error:
        raise RecordError(
            f"{file}: cannot be read ({error.strerror}); named by {field.name} in {FRAME_FILE}"
        ) from error
    known = top.get("files", {}).get(name, {})
    size, checksum = known.get("bytes", len(data)).of(int), known.get("crc32")
    if size != len(data):
        raise RecordError(f"{file}: truncated or changed: expected {size} bytes, found {len(data)}")
    if checksum and checksum.of(str) != f"{zlib.crc32(data):08x}":
        raise RecordError(f"{file}: damaged: crc32 should be {checksum.value}, is {zlib.crc32(data):08x}")
    return data, file
