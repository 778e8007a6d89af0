"""An episode as Rerun's ``.rrd``: the garage in 3-D over time, images, clouds, detections, speeds, bytes.

Timeline ``episode``: seconds from the start. ``/world`` is the world frame; what lies below ``/world/ego`` and
``/world/infra_N`` is in that agent's frame, cameras look along z. Rerun keeps float32.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from pcdet_avp.closed_loop.export.drive import DrivenCase
from pcdet_avp.closed_loop.export.formats import ExportSettings
from pcdet_avp.closed_loop.export.record import EpisodeRecord, Found, floor_boxes
from pcdet_avp.closed_loop.export.sensors import Look, looks, sensor_ticks
from pcdet_avp.files import write_bytes
from pcdet_avp.structures.pose import Pose
from pcdet_avp.visualization.palette import EGO_COLOR, EGO_LIGHT, INFRA_LIGHT, TRUE_COLOR

APPLICATION, TIMELINE = "pcdet_avp", "episode"
FUSED, IGNORED, SOLID, PARKED = (255, 90, 170), (155, 104, 130), (128, 126, 120), (90, 95, 105)


def write(drives: Sequence[DrivenCase], stem: Path, settings: ExportSettings) -> list[Path]:
    """The ``.rrd`` of the first drive."""
    file = stem.with_name(f"{stem.name}.rrd")
    stream = rr.RecordingStream(APPLICATION, recording_id=stem.name)
    # Not stream.save(): on a full disk it waits for ever, or leaves a file without its end and says nothing (0.41).
    encoded = stream.binary_stream()
    stream.send_blueprint(_blueprint(drives[0]), make_active=False, make_default=True)
    _log_episode(stream, drives[0], settings)
    write_bytes(file, encoded.read() or b"")
    return [file]


def _blueprint(driven: DrivenCase) -> rrb.Blueprint:
    """The garage beside the cameras of the combination and the speeds."""
    agents = ["ego", *(f"infra_{unit.number}" for unit in driven.record.units if driven.record.uses_infra)]
    cameras = [rrb.Spatial2DView(origin=f"world/{agent}/camera", name=f"{agent} camera") for agent in agents]
    speeds = rrb.TimeSeriesView(origin="speeds", name="speeds (m/s)")
    right = rrb.Vertical(*cameras, speeds)
    return rrb.Blueprint(rrb.Horizontal(rrb.Spatial3DView(origin="world"), right, column_shares=[3, 2]))


def _log_episode(stream: rr.RecordingStream, driven: DrivenCase, settings: ExportSettings) -> None:
    record, frames = driven.record, driven.frames()
    _log_garage(stream, record)
    with_sensors = sensor_ticks(driven, settings)
    for tick, time_s in enumerate(tqdm(record.log.times.tolist(), desc="Rerun", unit="tick")):
        stream.set_time(TIMELINE, duration=time_s)
        stream.log("world/ego", _transform(Pose.from_xyz_yaw(*frames[tick, :2], yaw=frames[tick, 2])))
        _log_truth(stream, record, tick)
        _log_found(stream, "world/detections/fused", record.found[tick], FUSED)
        _log_found(stream, "world/detections/alone", record.alone[tick], EGO_LIGHT)
        _log_numbers(stream, record, tick)
        for look in looks(driven, tick, settings) if tick in with_sensors else ():
            _log_look(stream, look)


def _log_garage(stream: rr.RecordingStream, record: EpisodeRecord) -> None:
    """What stands still, for all times: walls, pillars, parked cars, roadside units."""
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log("facts", rr.AnyValues(**record.facts()), static=True)
    stream.log("world/garage", _boxes(record.scenario.layout.solid_boxes(), SOLID), static=True)
    parked = [user for user in record.users if user.stands]
    boxes = np.array([user.boxes()[0] for user in parked]).reshape(-1, 7)
    labels = [f"{user.name} {user.object_id}" for user in parked]
    stream.log("world/parked", _boxes(boxes, PARKED, labels), static=True)
    places = [(unit.x, unit.y, unit.z) for unit in record.units]
    names = [f"roadside unit {unit.number}" for unit in record.units]
    stream.log("world/units", rr.Points3D(places, labels=names, colors=[INFRA_LIGHT], radii=0.2), static=True)


def _log_truth(stream: rr.RecordingStream, record: EpisodeRecord, tick: int) -> None:
    users = [user for user in record.users if not user.stands]
    boxes = np.array([user.boxes()[tick] for user in users]).reshape(-1, 7)
    stream.log("world/road_users", _boxes(boxes, TRUE_COLOR, [f"{u.name} {u.object_id}" for u in users]))
    stream.log("world/vehicle", _boxes(floor_boxes(record.ego[tick : tick + 1], record.ego_size), EGO_COLOR))


def _log_found(stream: rr.RecordingStream, path: str, found: Found | None, color: tuple[int, int, int]) -> None:
    """Those that the law heeds, and apart from them the rest; empty while perception sleeps."""
    for name, shown, tint in (("heeded", True, color), ("ignored", False, IGNORED)):
        rows = np.zeros(0, bool) if found is None else found.heeded == shown
        boxes = np.zeros((0, 7)) if found is None else found.boxes[rows]
        labels = (
            []
            if found is None
            else [f"{n} {s:.2f}" for n, s in zip(found.names[rows], found.scores[rows], strict=True)]
        )
        stream.log(f"{path}/{name}", _boxes(boxes, tint, labels))


def _log_numbers(stream: rr.RecordingStream, record: EpisodeRecord, tick: int) -> None:
    """m/s; bytes of the roadside maps in use, and the age of the oldest (s)."""
    log, used = record.log, record.messages[tick]
    numbers = {
        "speeds/speed": log.speeds[tick],
        "speeds/target": log.targets[tick],
        "speeds/target_alone": record.targets_alone[tick],
        "link/bytes": sum(message.bytes for message in used),
        "link/age_s": max((message.age_s for message in used), default=0.0),
    }
    for path, value in numbers.items():
        stream.log(path, rr.Scalars(float(value)))


def _log_look(stream: rr.RecordingStream, look: Look) -> None:
    agent = f"world/{look.name}"
    if look.name != "ego":
        stream.log(agent, _transform(look.world_from_agent))
    if look.points is not None:
        grey = (255 * look.points[:, 3:]).round().astype(np.uint8).repeat(3, axis=1)
        stream.log(f"{agent}/points", rr.Points3D(look.points[:, :3], colors=grey, radii=0.02))
    if look.image is not None:
        camera = look.camera
        stream.log(f"{agent}/camera", _transform(camera.agent_from_camera))
        size = [camera.width, camera.height]
        stream.log(f"{agent}/camera", rr.Pinhole(image_from_camera=camera.intrinsics, resolution=size))
        _, jpeg = cv2.imencode(".jpg", look.image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
        stream.log(f"{agent}/camera", rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))


def _boxes(boxes: np.ndarray, color: tuple[int, int, int], labels: Sequence[str] | None = None) -> rr.Boxes3D:
    half = np.zeros(len(boxes))
    turns = np.stack([half, half, np.sin(boxes[:, 6] / 2), np.cos(boxes[:, 6] / 2)], -1)  # x, y, z, w
    named = {"labels": labels, "show_labels": False} if labels is not None else {}
    return rr.Boxes3D(centers=boxes[:, :3], half_sizes=boxes[:, 3:6] / 2, quaternions=turns, colors=[color], **named)


def _transform(pose: Pose) -> rr.Transform3D:
    turn = rr.Quaternion(xyzw=Rotation.from_matrix(pose.rotation).as_quat())
    return rr.Transform3D(translation=pose.translation, quaternion=turn)
