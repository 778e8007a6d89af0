"""An episode as MCAP with Foxglove's schemas: opens in Foxglove without settings of ours.

Log time is the episode's time from its start (ns). ``world`` is the fixed frame; ``ego`` and ``infra_N`` are the
agents' frames (x ahead, origin on the floor), ``..._camera`` the optical frames (z ahead, y down). Boxes are in
``world``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from foxglove import Channel, Context, open_mcap
from foxglove import channels as ch
from foxglove import messages as msg
from foxglove.mcap import MCAPWriteOptions
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from pcdet_avp.closed_loop.export.drive import DrivenCase
from pcdet_avp.closed_loop.export.formats import ExportSettings
from pcdet_avp.closed_loop.export.record import EpisodeRecord, Found, floor_boxes
from pcdet_avp.closed_loop.export.sensors import Look, looks, sensor_ticks
from pcdet_avp.errors import OutputError
from pcdet_avp.files import replacing
from pcdet_avp.structures.boxes import CORNER_SIGNS, EDGES
from pcdet_avp.structures.pose import Pose
from pcdet_avp.visualization.palette import EGO_COLOR, EGO_LIGHT, INFRA_LIGHT, TRUE_COLOR

PINK, GREY, WALL = (255, 90, 170), (155, 104, 130), (128, 126, 120)
STATE = (
    *("speed_mps", "acceleration_mps2", "target_mps", "target_alone_mps"),
    *("message_bytes", "messages", "message_age_s", "awake"),
)


def write(drives: Sequence[DrivenCase], stem: Path, settings: ExportSettings) -> list[Path]:
    """The MCAP of the first drive."""
    file = stem.with_name(f"{stem.name}.mcap")
    with replacing(file) as aside:
        context = Context()
        options = MCAPWriteOptions(compression_threads=0)
        try:
            with open_mcap(aside, allow_overwrite=True, context=context, writer_options=options) as writer:
                writer.write_metadata("episode", drives[0].record.facts())
                _Log(context).episode(drives[0], settings)
        except RuntimeError as error:  # a full disk, which its writer tells at the end
            raise OutputError(f"{file}: cannot be written ({error})") from error
    return [file]


class _Log:
    """The channels of one file."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._channels: dict[str, object] = {}

    def episode(self, driven: DrivenCase, settings: ExportSettings) -> None:
        record, frames = driven.record, driven.frames()
        self._scene("/garage", _garage(record), 0.0)
        with_sensors = sensor_ticks(driven, settings)
        for tick, time_s in enumerate(tqdm(record.log.times.tolist(), desc="MCAP", unit="tick")):
            ego = Pose.from_xyz_yaw(*frames[tick, :2], yaw=frames[tick, 2])
            self._poses({("world", "ego"): ego}, time_s)
            self._scene("/truth", _truth(record, tick), time_s)
            self._found("/detections/fused", record.found[tick], PINK, time_s)
            self._found("/detections/alone", record.alone[tick], EGO_LIGHT, time_s)
            self._log("/state", Channel, _state(record, tick), time_s, schema=STATE_SCHEMA)
            for look in looks(driven, tick, settings) if tick in with_sensors else ():
                self._look(look, time_s)

    def _log(self, topic: str, kind: type, message: object, time_s: float, **options: object) -> None:
        if topic not in self._channels:
            self._channels[topic] = kind(topic, context=self._context, **options)
        self._channels[topic].log(message, log_time=round(1e9 * time_s))

    def _scene(self, topic: str, entities: list[msg.SceneEntity], time_s: float) -> None:
        """Entities that take the place of all that this topic had."""
        gone = [msg.SceneEntityDeletion(timestamp=_stamp(time_s), type=msg.SceneEntityDeletionType.All)]
        self._log(topic, ch.SceneUpdateChannel, msg.SceneUpdate(deletions=gone, entities=entities), time_s)

    def _found(self, topic: str, found: Found | None, color: tuple[int, int, int], time_s: float) -> None:
        if found is None:
            self._scene(topic, [], time_s)
            return
        rows = zip(found.boxes, found.names, found.scores, found.heeded, strict=True)
        entities = [
            _entity(
                str(number),
                time_s,
                lines=[_outline(box, color if heeded else GREY)],
                facts={"class": name, "score": f"{score:.4f}", "heeded": heeded},
            )
            for number, (box, name, score, heeded) in enumerate(rows)
        ]
        self._scene(topic, entities, time_s)

    def _poses(self, poses: Mapping[tuple[str, str], Pose], time_s: float) -> None:
        transforms = [
            msg.FrameTransform(
                timestamp=_stamp(time_s),
                parent_frame_id=parent,
                child_frame_id=child,
                translation=_vector(pose.translation),
                rotation=_quaternion(pose.rotation),
            )
            for (parent, child), pose in poses.items()
        ]
        self._log("/tf", ch.FrameTransformsChannel, msg.FrameTransforms(transforms=transforms), time_s)

    def _look(self, look: Look, time_s: float) -> None:
        if look.name != "ego":
            self._poses({("world", look.name): look.world_from_agent}, time_s)
        if look.points is not None:
            self._log(f"/{look.name}/points", ch.PointCloudChannel, _cloud(look, time_s), time_s)
        if look.image is not None:
            optical = f"{look.name}_camera"
            self._poses({(look.name, optical): look.camera.agent_from_camera}, time_s)
            calibration = _calibration(look, optical, time_s)
            self._log(f"/{look.name}/camera/calibration", ch.CameraCalibrationChannel, calibration, time_s)
            _, jpeg = cv2.imencode(".jpg", look.image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
            image = msg.CompressedImage(timestamp=_stamp(time_s), frame_id=optical, data=jpeg.tobytes(), format="jpeg")
            self._log(f"/{look.name}/camera/image", ch.CompressedImageChannel, image, time_s)


STATE_SCHEMA = {
    "title": "avp_state",
    "type": "object",
    "properties": {name: {"type": "boolean" if name == "awake" else "number"} for name in STATE},
}


def _state(record: EpisodeRecord, tick: int) -> dict[str, float | bool]:
    """m/s, m/s2; bytes of the roadside maps in use, their number, and the age of the oldest (s)."""
    log, used = record.log, record.messages[tick]
    numbers = (log.speeds[tick], log.accelerations[tick], log.targets[tick], record.targets_alone[tick])
    maps = (sum(m.bytes for m in used), len(used), max((m.age_s for m in used), default=0.0))
    return dict(zip(STATE, (*map(float, numbers), *maps, record.found[tick] is not None), strict=True))


def _garage(record: EpisodeRecord) -> list[msg.SceneEntity]:
    """Walls and pillars, parked cars, and where the roadside units hang."""
    walls = [_cube(box, (*WALL, 90)) for box in record.scenario.layout.solid_boxes()]
    parked = [
        _entity(str(u.object_id), 0.0, cubes=[_cube(u.boxes()[0], (90, 95, 105, 255))])
        for u in record.users
        if u.stands
    ]
    units = [
        _entity(
            f"unit {unit.number}",
            0.0,
            cubes=[_cube((unit.x, unit.y, unit.z, 0.3, 0.3, 0.3, unit.yaw), (*INFRA_LIGHT, 255))],
        )
        for unit in record.units
    ]
    return [_entity("walls and pillars", 0.0, cubes=walls), *parked, *units]


def _truth(record: EpisodeRecord, tick: int) -> list[msg.SceneEntity]:
    """The ego, and every road user that can move."""
    time_s = float(record.log.times[tick])
    (ego,) = floor_boxes(record.ego[tick : tick + 1], record.ego_size)
    users = [
        _entity(
            str(user.object_id),
            time_s,
            cubes=[_cube(user.boxes()[tick], (*TRUE_COLOR, 200))],
            facts={"class": user.name, "body": user.body, "speed_mps": f"{user.speeds[tick]:.3f}"},
        )
        for user in record.users
        if not user.stands
    ]
    return [_entity("ego", time_s, cubes=[_cube(ego, (*EGO_COLOR, 200))]), *users]


def _entity(name: str, time_s: float, facts: Mapping[str, object] | None = None, **primitives: list) -> msg.SceneEntity:
    pairs = [msg.KeyValuePair(key=key, value=str(value)) for key, value in (facts or {}).items()]
    return msg.SceneEntity(timestamp=_stamp(time_s), frame_id="world", id=name, metadata=pairs, **primitives)


def _cube(box: Sequence[float], rgba: Sequence[int]) -> msg.CubePrimitive:
    return msg.CubePrimitive(pose=_box_pose(box), size=_vector(box[3:6]), color=_color(rgba))


def _outline(box: np.ndarray, rgb: Sequence[int]) -> msg.LinePrimitive:
    corners = CORNER_SIGNS * box[3:6] / 2
    points = [msg.Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in corners]
    indices = [index for edge in EDGES for index in edge]
    kind = msg.LinePrimitiveLineType.LineList
    return msg.LinePrimitive(
        type=kind, pose=_box_pose(box), thickness=0.06, points=points, indices=indices, color=_color((*rgb, 255))
    )


def _cloud(look: Look, time_s: float) -> msg.PointCloud:
    number = msg.PackedElementFieldNumericType.Float32
    fields = [
        msg.PackedElementField(name=name, offset=4 * k, type=number)
        for k, name in enumerate(("x", "y", "z", "intensity"))
    ]
    data = np.ascontiguousarray(look.points, "<f4").tobytes()
    stamp, still = _stamp(time_s), _pose(Pose.identity())
    return msg.PointCloud(timestamp=stamp, frame_id=look.name, pose=still, point_stride=16, fields=fields, data=data)


def _calibration(look: Look, frame: str, time_s: float) -> msg.CameraCalibration:
    k, identity = look.camera.intrinsics, np.eye(3)
    projection = np.concatenate([k, np.zeros((3, 1))], axis=1)
    size = {"width": look.camera.width, "height": look.camera.height}
    matrices = {name: m.ravel().tolist() for name, m in (("K", k), ("R", identity), ("P", projection))}
    return msg.CameraCalibration(timestamp=_stamp(time_s), frame_id=frame, **size, **matrices)


def _box_pose(box: Sequence[float]) -> msg.Pose:
    return _pose(Pose.from_xyz_yaw(box[0], box[1], box[2], yaw=box[6]))


def _pose(pose: Pose) -> msg.Pose:
    return msg.Pose(position=_vector(pose.translation), orientation=_quaternion(pose.rotation))


def _vector(values: Iterable[float]) -> msg.Vector3:
    x, y, z = map(float, values)
    return msg.Vector3(x=x, y=y, z=z)


def _quaternion(rotation: np.ndarray) -> msg.Quaternion:
    x, y, z, w = quaternion(rotation)
    return msg.Quaternion(x=x, y=y, z=z, w=w)


def quaternion(rotation: np.ndarray) -> tuple[float, float, float, float]:
    """x, y, z, w of a rotation (3, 3)."""
    return tuple(Rotation.from_matrix(rotation).as_quat().tolist())


def _color(rgba: Sequence[int]) -> msg.Color:
    r, g, b, a = (value / 255 for value in rgba)
    return msg.Color(r=r, g=g, b=b, a=a)


def _stamp(time_s: float) -> msg.Timestamp:
    seconds, rest = divmod(round(1e9 * time_s), 10**9)
    return msg.Timestamp(sec=seconds, nsec=rest)
