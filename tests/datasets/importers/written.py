"""Our own garage's frames written in the others' layouts, for the tests of the importers.

Nothing of the package converts here: poses, boxes and calibration are written out by formulas of this file, each from
the layout's own description. Unreal's axes: y to the right, degrees. A label of ours is a box (7,) in the ego frame.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml

EGO_ID, SECOND_ID, UNIT_ID = 100, 205, -1
FIRST_OBJECT = 1000  # the id of a frame's first label


@dataclass
class Mount:
    """Where a sensor of an upright agent stands: metres above the floor and ahead, radians of pitch down."""

    x: float
    z: float
    pitch_down: float = 0.0


def mounts_of(frames):
    """(camera, LiDAR) of each agent. The clouds are told in the agents' frames, so a LiDAR may stand anywhere above."""

    def camera(view):
        pose = view.camera.agent_from_camera
        return Mount(float(pose.translation[0]), float(pose.translation[2]), float(-np.arcsin(pose.rotation[2, 2])))

    return {
        "ego": (camera(frames[0].ego), Mount(0.0, 1.9, 0.02)),
        "infra": (camera(frames[0].infra), Mount(0.0, 6.8, 0.5)),
    }


def unreal_pose(agent, mount=None):
    """[x, y, z, roll, yaw, pitch] in Unreal's world of an agent's own pose, or of a sensor on it."""
    x, y, z = agent.translation
    yaw = np.arctan2(agent.matrix[1, 0], agent.matrix[0, 0])
    if mount is None:
        return [x, -y, z, 0.0, -np.degrees(yaw), 0.0]
    x, y = x + mount.x * np.cos(yaw), y + mount.x * np.sin(yaw)
    return [x, -y, z + mount.z, 0.0, -np.degrees(yaw), -np.degrees(mount.pitch_down)]


def in_sensor(points, mount):
    """(P, 4) points of an agent frame in a right-handed sensor frame that pitches about its y axis."""
    c, s = np.cos(mount.pitch_down), np.sin(mount.pitch_down)
    x, z = points[:, 0] - mount.x, points[:, 2] - mount.z
    return np.stack([c * x - s * z, points[:, 1], s * x + c * z, points[:, 3]], 1)


def world_boxes(frame):
    """(N, 7) labels in the world, from the ego frame by hand."""
    x, y, z = frame.ego.world_from_agent.translation
    yaw = np.arctan2(*frame.ego.world_from_agent.matrix[[1, 0], 0])
    boxes, moved = frame.labels.boxes, frame.labels.boxes.copy()
    moved[:, 0] = x + np.cos(yaw) * boxes[:, 0] - np.sin(yaw) * boxes[:, 1]
    moved[:, 1] = y + np.sin(yaw) * boxes[:, 0] + np.cos(yaw) * boxes[:, 1]
    moved[:, 2] += z
    moved[:, 6] += yaw
    return moved


def write_pcd(file, points, names=("x", "y", "z", "intensity")):
    """Binary PCD of float32 columns; a column called rgb is packed as Open3D packs a grey colour."""
    columns = [np.asarray(points[:, i], np.float32) for i in range(3)]
    if names[3] == "rgb":
        grey = np.rint(points[:, 3] * 255).astype(np.uint32)
        columns.append((grey << 16 | grey << 8 | grey).view(np.float32))
    else:
        columns.append(np.asarray(points[:, 3], np.float32))
    header = (
        f"VERSION 0.7\nFIELDS {' '.join(names)}\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {len(points)}\n"
        f"HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    file.write_bytes(header.encode() + np.stack(columns, 1).tobytes())


def write_png(file, image):
    file.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(file), image[..., ::-1])


# ---------------------------------------------------------------- OPV2V


def opv2v_vehicle(box, centre_z=0.3):
    """The entry of a vehicle whose ``location`` lies ``centre_z`` below the middle of its box."""
    x, y, z, dx, dy, dz, heading = box.tolist()
    return {
        "location": [x, -y, z - centre_z],
        "center": [0.0, 0.0, centre_z],
        "angle": [0.0, -float(np.degrees(heading)), 0.0],
        "extent": [dx / 2, dy / 2, dz / 2],
        "speed": 3.0,
    }


def opv2v_agent(folder, timestamp, view, mounts, vehicles):
    """One agent's yaml, cloud and front camera."""
    folder.mkdir(parents=True, exist_ok=True)
    camera, lidar = mounts
    k = [[float(view.camera.fx), 0.0, float(view.camera.cx)], [0.0, float(view.camera.fy), float(view.camera.cy)]]
    content = {
        "true_ego_pos": [float(v) for v in unreal_pose(view.world_from_agent)],
        "lidar_pose": [float(v) for v in unreal_pose(view.world_from_agent, lidar)],
        "camera0": {
            "cords": [float(v) for v in unreal_pose(view.world_from_agent, camera)],
            "intrinsic": [*k, [0.0, 0.0, 1.0]],
        },
        "vehicles": vehicles,
    }
    (folder / f"{timestamp}.yaml").write_text(yaml.safe_dump(content))
    write_pcd(folder / f"{timestamp}.pcd", in_sensor(view.points, lidar) * [1, -1, 1, 1], ("x", "y", "z", "rgb"))
    write_png(folder / f"{timestamp}_camera0.png", view.image)


def write_opv2v(root, frames, mounts):
    """One scenario with a timestamp for each frame; each agent lists half of the cars, and the second the ego, too."""
    for number, frame in enumerate(frames):
        stamp, boxes = f"{68 + 2 * number:06d}", world_boxes(frame)
        cars = [i for i, name in enumerate(frame.labels.names) if name == "Car"]
        listed = {FIRST_OBJECT + i: opv2v_vehicle(boxes[i]) for i in cars}
        here = dict(list(listed.items())[::2])
        there = dict(list(listed.items())[1::2]) | {
            EGO_ID: opv2v_vehicle(np.array([*ego_place(frame), 0.8, 4.8, 1.9, 1.6, 0.0]))
        }
        opv2v_agent(root / str(EGO_ID), stamp, frame.ego, mounts["ego"], here)
        opv2v_agent(root / str(UNIT_ID), stamp, frame.infra, mounts["infra"], there)
        opv2v_agent(root / str(SECOND_ID), stamp, frame.ego, mounts["ego"], there)


def ego_place(frame):
    return frame.ego.world_from_agent.translation[:2].tolist()


# ---------------------------------------------------------------- CARLA


def transform(pose):
    x, y, z, roll, yaw, pitch = (float(v) for v in pose)
    return {"location": {"x": x, "y": y, "z": z}, "rotation": {"pitch": pitch, "yaw": yaw, "roll": roll}}


def carla_actor(object_id, name, box):
    """A vehicle's actor stands on the ground, a pedestrian's in the middle of its capsule."""
    x, y, z, dx, dy, dz, heading = box.tolist()
    below = dz / 2 if name == "Car" else 0.0
    kind = "vehicle.garage.car" if name == "Car" else "walker.pedestrian.0001"
    return {
        "id": object_id,
        "type_id": kind,
        "attributes": {"number_of_wheels": "4"} if name == "Car" else {"age": "adult"},
        "transform": transform([x, -y, z - below, 0.0, -np.degrees(heading), 0.0]),
        "bounding_box": {
            "location": {"x": 0.0, "y": 0.0, "z": below},
            "extent": {"x": dx / 2, "y": dy / 2, "z": dz / 2},
        },
    }


def raw_depth(depth):
    """CARLA's encoding of metres, where nothing was hit as at 1000 m."""
    code = np.rint(np.where(depth > 0, depth, 1000.0).astype(np.float64) / 1000.0 * (256**3 - 1)).astype(np.int64)
    return np.stack([code & 255, code >> 8 & 255, code >> 16], -1).astype(np.uint8)


def carla_agent(root, name, view, mounts, frame_name, sensors, poses, suffix):
    camera, lidar = mounts
    height, width = view.image.shape[:2]
    fov = 2 * np.degrees(np.arctan(width / 2 / view.camera.fx))
    attributes = {"image_size_x": str(width), "image_size_y": str(height), "fov": repr(float(fov))}
    for kind, picture in (("rgb", view.image), ("depth", raw_depth(view.depth))):
        sensors[f"{name}_{kind}"] = {"agent": name, "type": f"sensor.camera.{kind}", "attributes": attributes}
        poses[f"{name}_{kind}"] = transform(unreal_pose(view.world_from_agent, camera))
        write_png(root / f"{name}_{kind}" / f"{frame_name}.png", picture)
    sensors[f"{name}_lidar"] = {"agent": name, "type": "sensor.lidar.ray_cast", "attributes": {"channels": "16"}}
    poses[f"{name}_lidar"] = transform(unreal_pose(view.world_from_agent, lidar))
    points = (in_sensor(view.points, lidar) * [1, -1, 1, 1]).astype(np.float32)
    write_carla_cloud(root / f"{name}_lidar" / f"{frame_name}{suffix}", points)


def write_carla_cloud(file, points):
    """As raw_data, as numpy's file of it, or as lidar.save_to_disk writes it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    if file.suffix == ".bin":
        file.write_bytes(points.tobytes())
    elif file.suffix == ".npy":
        np.save(file, points)
    else:
        fields = "".join(f"property float32 {name}\n" for name in "xyzI")
        rows = "\n".join(" ".join(f"{v:.4f}" for v in point) for point in points)
        file.write_text(f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{fields}end_header\n{rows}\n")


def write_carla(root, frames, mounts, suffix=".npy"):
    """One scene; the ego is among the actors, and so is a bicycle."""
    sensors = {}
    (root / "frames").mkdir(parents=True)
    for number, frame in enumerate(frames):
        name, poses, boxes = f"{412 + number}", {}, world_boxes(frame)
        for agent, view in (("ego", frame.ego), ("mast", frame.infra)):
            part = mounts["ego" if agent == "ego" else "infra"]
            carla_agent(root, agent, view, part, name, sensors, poses, suffix)
        actors = [carla_actor(FIRST_OBJECT + i, str(n), boxes[i]) for i, n in enumerate(frame.labels.names)]
        ego = carla_actor(EGO_ID, "Car", np.array([*ego_place(frame), 0.8, 4.8, 1.9, 1.6, 0.0]))
        ego["transform"] = transform(unreal_pose(frame.ego.world_from_agent))
        bicycle = carla_actor(3, "Car", boxes[0]) | {"type_id": "vehicle.bh.crossbike"}
        bicycle["attributes"] = {"number_of_wheels": "2"}
        content = {"timestamp": 7.5 + 0.1 * number, "sensors": poses, "actors": [ego, bicycle, *actors]}
        (root / "frames" / f"{name}.json").write_text(json.dumps(content))
    (root / "scene.json").write_text(json.dumps({"ego": EGO_ID, "sensors": sensors}))


# ---------------------------------------------------------------- DAIR-V2X-C

WORLD_LIFT_M = 21.5  # of the floor in the written world
VEHICLE_LIDAR, ROADSIDE_LIDAR = Mount(0.0, 1.9, 0.03), Mount(0.0, 6.5, 0.02)
NOVATEL_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x right, y forward
NOVATEL_SHIFT = np.array([0.1, -0.4, 0.9])


def rigid(mount):
    """(3, 3) and (3,): agent from a sensor that pitches about its y axis."""
    c, s = np.cos(mount.pitch_down), np.sin(mount.pitch_down)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.array([mount.x, 0.0, mount.z])


def world_of(view):
    c, s = view.world_from_agent.matrix[0, 0], view.world_from_agent.matrix[1, 0]
    place = view.world_from_agent.translation + [0, 0, WORLD_LIFT_M]
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), place


def chained(outer, inner):
    return outer[0] @ inner[0], outer[0] @ inner[1] + outer[1]


def inverted(pose):
    return pose[0].T, -pose[0].T @ pose[1]


def dair_side(root, side, number, view, lidar, offset, shear):
    """Files of one side's frame; its entry of data_info.json."""
    folder, name = root / side, f"{number:06d}"
    vehicle = side == "vehicle-side"
    world_from_lidar = chained(world_of(view), rigid(lidar))
    camera_from_lidar = chained(
        inverted((view.camera.agent_from_camera.rotation, view.camera.agent_from_camera.translation)), rigid(lidar)
    )
    if vehicle:
        novatel_from_lidar = (NOVATEL_TURN.T, NOVATEL_SHIFT)
        chain = {
            "lidar_to_novatel": {"transform": record(novatel_from_lidar)},
            "novatel_to_world": record(chained(world_from_lidar, inverted(novatel_from_lidar))),
        }
    else:
        moved = (world_from_lidar[0], world_from_lidar[1] - [*offset, 0.0])
        chain = {"virtuallidar_to_world": record(moved) | {"relative_error": {"delta_x": "", "delta_y": ""}}}
    kind = "lidar_to_camera" if vehicle else "virtuallidar_to_camera"
    camera = view.camera
    k = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    if shear is not None:  # K (R p + t) stays as it is
        k = k @ np.linalg.inv(shear)
        camera_from_lidar = shear @ camera_from_lidar[0], shear @ camera_from_lidar[1]
    chain |= {kind: record(camera_from_lidar), "camera_intrinsic": {"cam_D": [0.0] * 5, "cam_K": k.ravel().tolist()}}
    for calib, content in chain.items():
        write_json(folder / "calib" / calib / f"{name}.json", content)
    turned, place = rigid(lidar)
    points = view.points.astype(np.float64)
    points[:, :3] = (points[:, :3] - place) @ turned
    points[:, 3] = np.rint(points[:, 3] * 255)
    (folder / "velodyne").mkdir(parents=True, exist_ok=True)
    write_pcd(folder / "velodyne" / f"{name}.pcd", points)
    write_png(folder / "image" / f"{name}.jpg", view.image)
    return {
        "image_path": f"image/{name}.jpg",
        "pointcloud_path": f"velodyne/{name}.pcd",
        "pointcloud_timestamp": str(1626155123000000 + 100000 * number),
        "batch_id": str(number // 2),
        **{f"calib_{calib}_path": f"calib/{calib}/{name}.json" for calib in chain},
    }


def record(pose):
    return {"rotation": pose[0].tolist(), "translation": pose[1].reshape(3, 1).tolist()}


def write_json(file, content):
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content))


def world_8_points(box):
    """Vertices of a box (7,) of the written world: front left, front right, rear right, rear left; then above."""
    x, y, z, length, width, height, heading = box
    c, s = np.cos(heading), np.sin(heading)
    signs = ((1, 1), (1, -1), (-1, -1), (-1, 1))
    corners = [(a * length / 2, b * width / 2, h) for h in (-height / 2, height / 2) for a, b in signs]
    return [[x + c * a - s * b, y + s * a + c * b, z + WORLD_LIFT_M + h] for a, b, h in corners]


def dair_label(kind, box):
    length, width, height = box[3:6].tolist()
    sizes = {"h": height, "w": width, "l": length}
    return {"type": kind, "world_8_points": world_8_points(box), "3d_dimensions": sizes}


def write_dair_v2x(root, frames, offset=(0.4, -0.7), shear=None):
    """Two frames a batch; ``offset`` of the roadside's place is told to each pair; ``shear`` (3, 3) of its camera."""
    sides, pairs = {"vehicle-side": [], "infrastructure-side": []}, []
    for number, frame in enumerate(frames):
        for side, view, lidar in (
            ("vehicle-side", frame.ego, VEHICLE_LIDAR),
            ("infrastructure-side", frame.infra, ROADSIDE_LIDAR),
        ):
            bend = shear if side == "infrastructure-side" else None
            sides[side].append(dair_side(root, side, number, view, lidar, offset, bend))
        kinds = ("Car", "Van", "Truck", "Bus")
        boxes = world_boxes(frame)
        cars = [i for i, name in enumerate(frame.labels.names) if name == "Car"]
        labels = [dair_label(kinds[i % 4], boxes[i]) for i in cars]
        flat = boxes[cars[0]].copy()
        flat[3:6] = 0
        labels += [dair_label("Cyclist", boxes[cars[0]]), dair_label("Car", flat)]
        write_json(root / "cooperative" / "label_world" / f"{number:06d}.json", labels)
        pairs.append(
            {
                **{
                    f"{side.split('-')[0]}_{kind}_path": f"{side}/{entry[f'{kind}_path']}"
                    for side, entry in ((s, sides[s][-1]) for s in sides)
                    for kind in ("image", "pointcloud")
                },
                "cooperative_label_path": f"cooperative/label_world/{number:06d}.json",
                "system_error_offset": {"delta_x": offset[0], "delta_y": offset[1]},
            }
        )
    for side, rows in sides.items():
        write_json(root / side / "data_info.json", rows)
    write_json(root / "cooperative" / "data_info.json", pairs)
    return Path(root)
