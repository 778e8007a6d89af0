"""DAIR-V2X-C -> records. Right-handed axes, metres; calibration as chains of a rotation and a translation.

<src>/cooperative/data_info.json lists pairs of a vehicle's and a roadside frame; <src>/vehicle-side/data_info.json and
<src>/infrastructure-side/data_info.json name each frame's calibration files; all paths are relative to their side.

    vehicle LiDAR --lidar_to_novatel--> novatel --novatel_to_world--> world <--virtuallidar_to_world-- roadside LiDAR
    LiDAR --lidar_to_camera, virtuallidar_to_camera--> optical camera frame --cam_K--> pixel

Ours from theirs (axes.py says how):
    an agent's frame    below its LiDAR, along the LiDAR's x axis; the camera must look that way, within 60 degrees
    floor               nowhere recorded. Taken from the labels: their lower faces, as seen from each side's LiDAR,
                        within 30 m of it. The median over a scene is how high the LiDAR hangs; a scene without such a
                        label is left out, and counted
    offset              ``system_error_offset`` of the pair, else ``relative_error`` of the calibration, is added to the
                        roadside's place in the world
    camera              ``cam_K`` alone: the images are taken as undistorted, as DAIR-V2X's own code takes them
    shear               virtuallidar_to_camera is no rotation in some frames (its rows have length 0.83 in one that
                        users report). What it does to the pixels goes into the intrinsics; other calibration that is
                        no rotation becomes the nearest one if it is near (``axes.REPAIRED``), and is refused beyond
    box                 the eight vertices ``world_8_points``; a box with a size of 0 is left out, as DAIR-V2X's code
                        does
    class               Car, Van, Truck and Bus are Car, as in DAIR-V2X's benchmark; others are left out and counted
    intensity           stored as 0 to 255
The cooperative labels hold vehicles only: class_names is Car, so that nobody trains pedestrians as background. The
vehicle itself, should the roadside have labelled it, is left out where frames are read, as in every record. A scene is
a batch (``batch_id`` of the vehicle's side).
Sources: DAIR-V2X's data/README.md, v2x/v2x_utils/transformation_utils.py, v2x/dataset/dataset_utils/label.py,
v2x/config.py, tools/dataset_converter/{calib_i2v,concatenate_pcd2bin}.py; issues 22 and 64 of AIR-THU/DAIR-V2X on the
shear.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcdet_avp.datasets.avp.fields import Field
from pcdet_avp.datasets.avp.units import FIRST_UNIT, Record
from pcdet_avp.datasets.importers.axes import cloud_in_agent, corner_box, pinhole, repaired_pose, upright
from pcdet_avp.datasets.importers.dair_sides import (
    Side,
    entry_of,
    offset_of,
    rotation_and_translation,
    text,
    transform_of,
)
from pcdet_avp.datasets.importers.recording import (
    Imported,
    Notes,
    SourceScene,
    WorldBox,
    folder_of,
    labels_in_ego,
    load_list,
    number_of,
    read_image,
    read_points,
)
from pcdet_avp.errors import RecordError
from pcdet_avp.structures.frame import AgentView
from pcdet_avp.structures.pose import Pose

CARS = ("car", "van", "truck", "bus")
FULL_INTENSITY = 255.0
NEAR_M = 30.0  # labels that tell where the floor is
MAX_CAMERA_YAW = np.radians(60.0)
MICROSECOND_S = 1e-6
BY_CORNERS = "label whose 3d_dimensions differ by more than 0.1 m from its eight vertices, which are taken"


class DairV2x:
    """A ``Recording`` (see recording.py)."""

    class_names: tuple[str, ...] = ("Car",)

    def __init__(self, src: Path) -> None:
        self.notes = Notes()
        self._src = _cooperative_folder(folder_of(src))
        chain = ("calib_lidar_to_novatel_path", "calib_novatel_to_world_path")
        self._vehicle = Side.open(self._src, "vehicle-side", chain, "calib_lidar_to_camera_path")
        self._roadside = Side.open(
            self._src,
            "infrastructure-side",
            ("calib_virtuallidar_to_world_path",),
            "calib_virtuallidar_to_camera_path",
        )
        self._pairs: dict[str, dict[str, Field]] = {}
        for pair in load_list(self._src / "cooperative" / "data_info.json"):
            entry = entry_of(self._vehicle, pair, "vehicle")
            frames = self._pairs.setdefault(text(entry["batch_id"]), {})
            if frames.setdefault(Path(entry["pointcloud_path"].of(str)).stem, pair) is not pair:
                self.notes.add("pair left out, because an earlier one has the same vehicle frame", _name_of(pair))
        self._heights: dict[str, tuple[float, float]] = {}
        self.scenes: Sequence[SourceScene] = [self._scene(name) for name in self._pairs if self._has_floor(name)]
        if not self.scenes:
            raise RecordError(f"{self._src}: {'; '.join(self.notes.lines())}")

    def _scene(self, name: str) -> SourceScene:
        pairs = dict(sorted(self._pairs[name].items(), key=lambda item: self._time(item[1])))
        return SourceScene(name, {frame: self._files(pair) for frame, pair in pairs.items()})

    def _files(self, pair: Field) -> list[Path]:
        sides = ((self._vehicle, "vehicle"), (self._roadside, "infrastructure"))
        files = [file for side, key in sides for file in side.files(entry_of(side, pair, key))]
        return [*files, self._src / pair["cooperative_label_path"].of(str)]

    def _time(self, pair: Field) -> int:
        field = entry_of(self._vehicle, pair, "vehicle")["pointcloud_timestamp"]
        digits = text(field)
        if not digits.isdecimal():
            raise field.error(f"expected microseconds, found {digits!r}")
        return int(digits)

    def read(self, scene: str, frame: str) -> Imported:
        """One frame; RecordError names the file and what is wrong with it."""
        pair = self._pairs[scene][frame]
        vehicle, roadside = self._world_from_lidars(pair)
        boxes = self._boxes(pair)
        heights = self._heights.get(scene)
        if heights is None:
            raise RecordError(f"{self._src}: batch {scene}: no frame has all of its files")
        images: dict[str, bytes] = {}
        ego = self._view(self._vehicle, entry_of(self._vehicle, pair, "vehicle"), vehicle, heights[0], "ego", images)
        entry = entry_of(self._roadside, pair, "infrastructure")
        unit = self._view(self._roadside, entry, roadside, heights[1], FIRST_UNIT, images)
        start = min(self._time(other) for other in self._pairs[scene].values())
        time_s = (self._time(pair) - start) * MICROSECOND_S
        labels = labels_in_ego(ego.world_from_agent, boxes)
        return Imported(Record(f"{scene}/{frame}", time_s, ego, {FIRST_UNIT: unit}, labels), images)

    def _world_from_lidars(self, pair: Field) -> tuple[Pose, Pose]:
        """Of the vehicle and of the roadside unit, the latter moved by the pair's offset."""
        vehicle = self._chained(self._vehicle, entry_of(self._vehicle, pair, "vehicle"))
        entry = entry_of(self._roadside, pair, "infrastructure")
        offset = pair.get("system_error_offset")
        if not offset or not isinstance(offset.value, dict):
            offset = Field.load(self._roadside.file(entry, self._roadside.chain[0])).get("relative_error", {})
        dx, dy = (offset_of(offset.get(key, 0.0)) for key in ("delta_x", "delta_y"))
        return vehicle, Pose.from_xyz_yaw(dx, dy) @ self._chained(self._roadside, entry)

    def _chained(self, side: Side, entry: Field) -> Pose:
        pose = Pose.identity()
        for key in side.chain:
            top = transform_of(side.file(entry, key))
            step, off = top.build(repaired_pose, *rotation_and_translation(top))
            if off:
                kind = Path(entry[key].of(str)).parent.name
                self.notes.add(
                    f"{kind} that is no rotation, replaced by the nearest one", f"{top.file}, off by {off:.2g}"
                )
            pose = step @ pose
        return pose

    def _view(
        self, side: Side, entry: Field, world_from_lidar: Pose, height: float, name: str, images: dict[str, bytes]
    ) -> AgentView:
        world_from_agent = upright(world_from_lidar, float(world_from_lidar.translation[2]) - height)
        agent_from_lidar = world_from_agent.inverse() @ world_from_lidar
        camera = image = points = None
        if side.camera:
            image, images[name] = read_image(side.file(entry, "image_path"))
            camera = self._camera(side, entry, agent_from_lidar, image)
        if side.lidar:
            cloud = read_points(side.file(entry, "pointcloud_path"), intensity_scale=FULL_INTENSITY)
            points = cloud_in_agent(agent_from_lidar, cloud)
        return AgentView(world_from_agent, camera, image, None, points)

    def _camera(self, side: Side, entry: Field, agent_from_lidar: Pose, image: np.ndarray):
        top, size = transform_of(side.file(entry, side.to_camera)), (image.shape[1], image.shape[0])
        intrinsics = Field.load(side.file(entry, "calib_camera_intrinsic_path"))["cam_K"].numbers(9).reshape(3, 3)
        camera, skew_px = top.build(pinhole, *size, intrinsics, *rotation_and_translation(top))
        if skew_px:
            what = "camera calibration that is no rotation, its shear taken into the intrinsics"
            self.notes.add(what, f"{top.file}, up to {skew_px:.1f} pixels of skew left out")
        camera = replace(camera, agent_from_camera=agent_from_lidar @ camera.agent_from_camera)
        x, y, _ = camera.agent_from_camera.rotation[:, 2]
        if abs(np.arctan2(y, x)) > MAX_CAMERA_YAW:
            raise top.error(
                f"the camera looks {np.degrees(np.arctan2(y, x)):.0f} degrees away from the LiDAR's x axis: the axes "
                "are not those of DAIR-V2X"
            )
        return camera

    def _boxes(self, pair: Field) -> list[WorldBox]:
        file = self._src / pair["cooperative_label_path"].of(str)
        found = (self._box(number, row) for number, row in enumerate(load_list(file)))
        return [box for box in found if box is not None]

    def _box(self, number: int, row: Field) -> WorldBox | None:
        kind = row["type"].of(str)
        if kind.lower() not in CARS:
            self.notes.add(f"label of type {kind} left out", row.file)
            return None
        box = row["world_8_points"].build(corner_box, row["world_8_points"].numbers(8, 3))
        sizes = row.get("3d_dimensions", {})
        stated = np.array([number_of(sizes[key]) for key in "lwh"]) if sizes.value else None
        if box is None or (stated is not None and stated.min() <= 0):
            self.notes.add("label without a size left out", _name_of(row))
            return None
        if stated is not None and np.abs(box[3:6] - stated).max() > 0.1:
            self.notes.add(BY_CORNERS, _name_of(row))
        return WorldBox(number, "Car", box)

    def _has_floor(self, scene: str) -> bool:
        """Note how high a scene's two LiDARs hang above the road, metres: medians over its labels near them.

        False, and told, where no label is near one of them. A scene without one whole frame is left to who reads it.
        """
        above: tuple[list[float], list[float]] = ([], [])
        notes, self.notes = self.notes, Notes()  # the labels are read again, and counted then
        whole = [p for p in self._pairs[scene].values() if all(file.exists() for file in self._files(p))]
        for pair in whole:
            boxes = self._boxes(pair)
            for heights, pose in zip(above, self._world_from_lidars(pair), strict=True):
                heights += _heights_over(pose, boxes)
        self.notes = notes
        if whole and not all(above):
            side = ("vehicle", "roadside unit")[[*map(bool, above)].index(False)]
            what = f"no label within {NEAR_M:g} m of the {side}'s LiDAR tells where the road is"
            self.notes.add(f"batch left out, because {what}", f"batch {scene}, {len(whole)} frames")
            return False
        if whole:
            self._heights[scene] = (float(np.median(above[0])), float(np.median(above[1])))
        return True


def _heights_over(world_from_lidar: Pose, boxes: Iterable[WorldBox]) -> list[float]:
    place = world_from_lidar.translation
    near = (b.box for b in boxes if np.hypot(*(b.box[:2] - place[:2])) <= NEAR_M)
    return [float(place[2] - (box[2] - box[5] / 2)) for box in near]


def _name_of(pair: Field) -> str:
    return f"{pair.file}: {pair.name}"


def _cooperative_folder(src: Path) -> Path:
    """``src`` itself, or the folder of DAIR-V2X-C below it."""
    for folder in (src, src / "cooperative-vehicle-infrastructure"):
        if (folder / "cooperative" / "data_info.json").exists():
            return folder
    raise RecordError(f"{src}: no DAIR-V2X-C: expected cooperative/data_info.json")
