"""Places, angles and sizes worked out by hand, in recordings written as text: no formula of ours or of ``written.py``.

Unreal's yaw of 90 degrees faces +y, which is to the right of +x; what lies at smaller x is then on the right-hand side.
"""

import json
import random
from contextlib import suppress

import numpy as np
import pytest
import yaml
from datasets.importers.written import write_carla_cloud, write_json, write_pcd, write_png

from pcdet_avp.datasets.importers import axes
from pcdet_avp.datasets.importers.run import open_recording
from pcdet_avp.errors import GeometryError, RecordError
from pcdet_avp.structures.pose import Pose

QUARTER = np.pi / 2
GREY = np.full((60, 80, 3), 90, np.uint8)


def only_record(format_name, root):
    recording = open_recording(format_name, root)
    (scene,) = recording.scenes
    (frame,) = scene.frames
    return recording.read(scene.name, frame).record


# ---------------------------------------------------------------- Unreal's frames

OPV2V = """
true_ego_pos: [10.0, 20.0, 0.5, 0.0, 90.0, 0.0]
lidar_pose: [10.0, 20.0, 2.5, 0.0, 90.0, 0.0]
camera0:
  cords: [10.0, 22.0, 1.5, 0.0, 90.0, 0.0]
  intrinsic: [[40.0, 0.0, 40.0], [0.0, 40.0, 30.0], [0.0, 0.0, 1.0]]
ego_speed: 3.0
vehicles:
  7: {location: [10.0, 30.0, 0.5], center: [0.0, 0.0, 0.75], extent: [2.25, 0.9, 0.75], angle: [0.0, 90.0, 0.0]}
  8: {location: [5.0, 25.0, 0.5], center: [0.0, 0.0, 1.0], extent: [2.5, 1.0, 1.0], angle: [0.0, 120.0, 0.0]}
  9: {location: [15.0, 28.0, 0.5], center: [1.0, 0.0, 0.8], extent: [2.0, 0.9, 0.8], angle: [0.0, 0.0, 0.0]}
  3: {location: [10.0, 20.0, 0.5], center: [0.0, 0.0, 0.8], extent: [2.4, 1.0, 0.8], angle: [0.0, 90.0, 0.0]}
"""
# 7 is 10 m ahead and faces as the ego. 8 is 5 m ahead and 5 m to the right; 30 degrees further clockwise than the ego,
# so its heading is -30 degrees. 9 faces +x, which is to the ego's left (heading +90); its box's middle lies 1 m before
# its own origin at (15, 28), that is at (16, 28): 8 m ahead and 6 m to the left. 3 is the ego.
OPV2V_BOXES = [
    [10.0, 0.0, 0.75, 4.5, 1.8, 1.5, 0.0],
    [5.0, -5.0, 1.0, 5.0, 2.0, 2.0, -np.pi / 6],
    [8.0, 6.0, 0.8, 4.0, 1.8, 1.6, QUARTER],
]


@pytest.fixture
def opv2v(tmp_path):
    folder = tmp_path / "2026_01_01_00_00_00" / "3"
    folder.mkdir(parents=True)
    (folder / "000068.yaml").write_text(OPV2V)
    # 4 m ahead of the LiDAR, 1 m to its right (+y there), 1.5 m below it.
    write_pcd(folder / "000068.pcd", np.array([[4.0, 1.0, -1.5, 1.0], [4.0, 0.0, 0.0, 0.0]]), ("x", "y", "z", "rgb"))
    write_png(folder / "000068_camera0.png", GREY)
    return tmp_path


def test_opv2v_by_hand(opv2v):
    record = only_record("opv2v", opv2v)
    np.testing.assert_allclose(record.labels.boxes, OPV2V_BOXES, atol=1e-9)
    assert record.labels.object_ids.tolist() == [7, 8, 9]
    np.testing.assert_allclose(record.ego.points, [[4, -1, 0.5, 1], [4, 0, 2, 0]], atol=1e-6)
    np.testing.assert_allclose(record.ego.world_from_agent.translation, [10, -20, 0.5])
    assert record.ego.world_from_agent.yaw == pytest.approx(-QUARTER)
    assert record.units == {}


def test_labels_do_not_depend_on_how_a_lidar_is_tilted(opv2v):
    """Elsewhere they shrink with it (findings/opencoodx_tilted_lidar.sh). A point on its x axis goes with it."""
    file = opv2v / "2026_01_01_00_00_00" / "3" / "000068.yaml"
    file.write_text(OPV2V.replace("20.0, 2.5, 0.0, 90.0, 0.0]", "20.0, 2.5, 0.0, 90.0, -40.0]"))
    record = only_record("opv2v", opv2v)
    np.testing.assert_allclose(record.labels.boxes, OPV2V_BOXES, atol=1e-9)
    down = np.radians(40)
    np.testing.assert_allclose(record.ego.points[1, :3], [4 * np.cos(down), 0, 2 - 4 * np.sin(down)], atol=1e-6)


def test_numbers_without_a_point_are_numbers(opv2v):
    """YAML 1.1 takes 25e-1 for a text."""
    file = opv2v / "2026_01_01_00_00_00" / "3" / "000068.yaml"
    file.write_text(OPV2V.replace("20.0, 2.5, 0.0", "20.0, 25e-1, 0.0"))
    np.testing.assert_allclose(only_record("opv2v", opv2v).ego.points, [[4, -1, 0.5, 1], [4, 0, 2, 0]], atol=1e-6)


def test_opv2vs_camera_by_hand(opv2v):
    """It stands 2 m ahead of the ego's middle, 1 m above the floor; f = 40 px, the picture's middle at (40, 30)."""
    camera = only_record("opv2v", opv2v).ego.camera
    ahead, left, up = [10.0, 0, 1], [10.0, 2, 1], [10.0, 0, 2]
    np.testing.assert_allclose(
        camera.project(np.array([ahead, left, up]))[0], [[40, 30], [30, 30], [40, 25]], atol=1e-9
    )


def test_opencoods_box_is_ours_where_the_centre_lies_above_the_origin():
    """The eight vertices of OpenCOOD's formula, written out as products of elementary turns, for one tilted vehicle.

    Its pose is (location + center; angle); our upright box has the same middle, sizes and heading.
    """
    location, centre, extent, (roll, yaw, pitch) = (
        [158.55, -385.75, 0.03],
        [0, 0, 0.71],
        [2.45, 1.06, 0.75],
        (0, -177.86, 0),
    )
    y, p, r = np.radians([yaw, pitch, roll])
    about_z = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(p), 0, -np.sin(p)], [0, 1, 0], [np.sin(p), 0, np.cos(p)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(r), np.sin(r)], [0, -np.sin(r), np.cos(r)]])
    signs = np.array([[a, b, c] for a in (1, -1) for b in (1, -1) for c in (1, -1)])
    vertices = (signs * extent) @ (about_z @ about_y @ about_x).T + location + centre
    ours = axes.unreal_box(axes.pose_from_unreal(location, roll, pitch, yaw), centre, extent)
    c, s = np.cos(ours[6]), np.sin(ours[6])
    turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    theirs = vertices * [1, -1, 1]
    inside = np.abs((theirs - ours[:3]) @ turned) / (ours[3:6] / 2)
    np.testing.assert_allclose(inside, 1.0, atol=1e-9)  # every vertex of theirs is one of ours
    front = theirs[:4].mean(0) - theirs.mean(0)
    assert np.arctan2(front[1], front[0]) == pytest.approx(ours[6])


@pytest.mark.parametrize(
    ("angles", "forward", "right", "up"),
    [  # roll, pitch, yaw in degrees -> the axes in Unreal's world, by CARLA's documentation
        ((0, 0, 90), [0, 1, 0], [-1, 0, 0], [0, 0, 1]),
        ((0, 90, 0), [0, 0, 1], [0, 1, 0], [-1, 0, 0]),
        ((90, 0, 0), [1, 0, 0], [0, 0, -1], [0, 1, 0]),
        ((0, 30, 0), [np.sqrt(0.75), 0, 0.5], [0, 1, 0], [-0.5, 0, np.sqrt(0.75)]),
    ],
)
def test_unreals_angles_by_hand(angles, forward, right, up):
    roll, pitch, yaw = angles
    rotation = axes.pose_from_unreal([0, 0, 0], roll, pitch, yaw).rotation
    ours = np.array([forward, np.negative(right), up]) * [1, -1, 1]  # forward, left, up, with y to the left
    np.testing.assert_allclose(rotation.T, ours, atol=1e-12)


# ---------------------------------------------------------------- CARLA


def carla_pose(x, y, z, yaw=0.0, pitch=0.0):
    return {"location": {"x": x, "y": y, "z": z}, "rotation": {"pitch": pitch, "yaw": yaw, "roll": 0.0}}


def carla_actor(object_id, kind, pose, location, extent, **attributes):
    box = {name: dict(zip("xyz", values, strict=True)) for name, values in (("location", location), ("extent", extent))}
    return {"id": object_id, "type_id": kind, "attributes": attributes, "transform": pose, "bounding_box": box}


@pytest.fixture
def carla(tmp_path):
    root = tmp_path / "lot"
    camera = {"image_size_x": "80", "image_size_y": "60", "fov": "90"}
    sensors = {
        "top": {"agent": "ego", "type": "sensor.lidar.ray_cast", "attributes": {}},
        "eye": {"agent": "mast", "type": "sensor.camera.rgb", "attributes": camera},
    }
    poses = {"top": carla_pose(0, 0, 2.2), "eye": carla_pose(20, 0, 7.2, yaw=180, pitch=-30)}
    wheels = {"number_of_wheels": "4"}
    actors = [
        carla_actor(1, "vehicle.a.b", carla_pose(0, 0, 0.2), (0, 0, 0.8), (2.4, 0.95, 0.8), **wheels),
        carla_actor(2, "vehicle.c.d", carla_pose(8, 3, 0.2, yaw=45), (0.5, 0, 0.7), (2, 0.9, 0.7), **wheels),
        carla_actor(5, "walker.pedestrian.0003", carla_pose(6, -2, 1.13), (0, 0, 0), (0.1875, 0.1875, 0.93)),
        carla_actor(6, "vehicle.e.f", carla_pose(3, 3, 0), (0, 0, 0), (0.8, 0.3, 0.7), number_of_wheels="2"),
        carla_actor(7, "walker.pedestrian.0004", carla_pose(7, -2, 1), (0, 0, 0), (0, 0, 0)),
        carla_actor(8, "traffic.stop", carla_pose(9, 0, 0), (0, 0, 0), (1, 1, 1)),
    ]
    write_json(root / "scene.json", {"ego": 1, "sensors": sensors})
    write_json(root / "frames" / "30.json", {"timestamp": 1.5, "sensors": poses, "actors": actors})
    write_carla_cloud(root / "top" / "30.bin", np.array([[5.0, 2, -2, 0.25]], np.float32))
    write_png(root / "eye" / "30.png", GREY)
    return tmp_path


def test_carla_by_hand(carla):
    """Car 2's middle: (8, 3) and half a metre along its 45 degrees, that is 0.3536 on each axis; y is to the right."""
    recording = open_recording("carla", carla)
    record = recording.read("lot", "30").record
    part = 0.5 * np.sqrt(0.5)
    expected = [
        [8 + part, -3 - part, 0.7, 4.0, 1.8, 1.4, -np.pi / 4],
        [6.0, 2.0, 0.93, 0.375, 0.375, 1.86, 0.0],
    ]
    np.testing.assert_allclose(record.labels.boxes, expected, atol=1e-9)
    assert record.labels.names.tolist() == ["Car", "Pedestrian"]
    np.testing.assert_allclose(record.ego.points, [[5, -2, 0, 0.25]], atol=1e-6)
    assert recording.notes.counts == {"two-wheeler left out": 1, "Pedestrian without a size left out": 1}


@pytest.mark.parametrize("suffix", [".bin", ".npy", ".ply"])
def test_a_cloud_may_be_raw_data_or_saved_by_carla(carla, suffix):
    (carla / "lot" / "top" / "30.bin").unlink()
    write_carla_cloud(carla / "lot" / "top" / f"30{suffix}", np.array([[5, 2, -2, 0.25], [9, -3, 0, 1]], np.float32))
    points = only_record("carla", carla).ego.points
    np.testing.assert_allclose(points, [[5, -2, 0, 0.25], [9, 3, 2, 1]], atol=1e-6)


def test_the_maps_own_parked_cars_are_labelled(carla):
    """They are no actors. One 10 m ahead and 4 m to the left, turned by 90 degrees: it faces the ego's right."""
    file = carla / "lot" / "scene.json"
    content = json.loads(file.read_text())
    box = carla_pose(10, -4, 0.9, yaw=90) | {"extent": {"x": 2.2, "y": 0.9, "z": 0.7}}
    content["static_cars"] = [box, box | {"extent": {"x": 0, "y": 0, "z": 0}}]
    file.write_text(json.dumps(content))
    recording = open_recording("carla", carla)
    labels = recording.read("lot", "30").record.labels
    np.testing.assert_allclose(labels.boxes[-1], [10, 4, 0.7, 4.4, 1.8, 1.4, -QUARTER], atol=1e-9)
    assert (labels.names[-1], labels.object_ids[-1]) == ("Car", -1)
    assert recording.notes.counts["car of the map without a size left out"] == 1


def test_a_car_of_the_map_that_is_an_actor_too_is_one_car(carla):
    """The map was asked after actors were spawned: car 2 in frame 30, which has driven on by frame 31; the ego; and a
    parked car that two lists of the map hold. A parked car a floor above car 2 is another one."""
    scene, tick = carla / "lot" / "scene.json", carla / "lot" / "frames" / "30.json"
    part = 0.5 * np.sqrt(0.5)
    car = carla_pose(8 + part, 3 + part, 0.9, yaw=45) | {"extent": {"x": 2, "y": 0.9, "z": 0.7}}
    above = car | {"location": car["location"] | {"z": 4.9}}
    ego = carla_pose(0, 0, 1.0) | {"extent": {"x": 2.4, "y": 0.95, "z": 0.8}}
    parked = carla_pose(10, -4, 0.9) | {"extent": {"x": 2.2, "y": 0.9, "z": 0.7}}
    turned = parked | {"rotation": {"pitch": 0.0, "yaw": 180.0, "roll": 0.0}}
    write_json(scene, json.loads(scene.read_text()) | {"static_cars": [car, above, ego, parked, turned]})
    later = json.loads(tick.read_text()) | {"timestamp": 1.6}
    later["actors"][1]["transform"] = carla_pose(20, 3, 0.2)
    write_json(tick.with_name("31.json"), later)
    for folder, suffix in (("top", "bin"), ("eye", "png")):
        (carla / "lot" / folder / f"31.{suffix}").write_bytes((carla / "lot" / folder / f"30.{suffix}").read_bytes())
    recording = open_recording("carla", carla)
    for frame, cars in (("31", [2, -2, -4]), ("30", [2, -2, -4])):
        labels = recording.read("lot", frame).record.labels
        assert labels.object_ids[labels.names == "Car"].tolist() == cars
    assert recording.notes.counts["car of the map left out, because it is an actor"] == 2
    assert recording.notes.counts["car of the map left out, because it is listed twice"] == 1


@pytest.mark.parametrize("extent", [-2.0, 240.0, 1e30])
def test_a_size_that_no_car_has_is_refused_by_name(carla, opv2v, extent):
    """240 m is a car's half length in Unreal's centimetres, taken for metres."""
    scene, tick = carla / "lot" / "scene.json", carla / "lot" / "frames" / "30.json"
    whole, listed = tick.read_text(), json.loads(scene.read_text())
    content = json.loads(whole)
    content["actors"][1]["bounding_box"]["extent"]["x"] = extent
    write_json(tick, content)
    with pytest.raises(RecordError, match=r"30.json: actors\[1\].bounding_box: box: expected sizes in metres, from 0"):
        only_record("carla", carla)
    tick.write_text(whole)
    box = carla_pose(10, -4, 0.9) | {"extent": {"x": extent, "y": 0.9, "z": 0.7}}
    write_json(scene, listed | {"static_cars": [box]})
    with pytest.raises(RecordError, match=r"scene.json: static_cars\[0\]: box: expected sizes in metres"):
        only_record("carla", carla)
    file = opv2v / "2026_01_01_00_00_00" / "3" / "000068.yaml"
    file.write_text(OPV2V.replace("extent: [2.25,", f"extent: [{extent},"))
    with pytest.raises(RecordError, match=r"000068.yaml: vehicles.7: box: expected sizes in metres, from 0 to 60"):
        only_record("opv2v", opv2v)


def test_carlas_mast_by_hand(carla):
    """20 m ahead, facing back, 7 m up, 30 degrees down: its axis meets the floor 7 / tan(30) = 12.12 m before it.

    So the middle of the picture shows the ego's (20 - 12.12, 0, 0). f = 40 px: what lies 1 m to the left there, 14 m
    from a camera that faces the ego, stands 40 / 14 px to the right of it.
    """
    frame = only_record("carla", carla).frame()
    np.testing.assert_allclose(frame.ego_from_infra.translation, [20, 0, 0], atol=1e-9)
    assert abs(frame.ego_from_infra.yaw) == pytest.approx(np.pi)
    before = 7 / np.tan(np.radians(30))
    seen = frame.ego_from_infra.inverse().apply(np.array([[20 - before, 0, 0], [20 - before, 1, 0]]))
    np.testing.assert_allclose(frame.infra.camera.project(seen)[0], [[40, 30], [40 + 40 / 14, 30]], atol=1e-9)


# ---------------------------------------------------------------- DAIR-V2X


def dair_box(x, y, z, length, width, height):
    """World vertices of a box along +x: front left, front right, rear right, rear left; then above."""
    a, b = length / 2, width / 2
    ring = [[x + a, y + b], [x + a, y - b], [x - a, y - b], [x - a, y + b]]
    return [[*xy, z + h] for h in (0.0, height) for xy in ring]


@pytest.fixture
def dair(tmp_path):
    """Vehicle at (100, 50), facing +y, LiDAR 2 m above a road at z = 20; the roadside 30 m ahead, 6 m up, facing -y."""
    facing = {"+y": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "-y": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]}
    same = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    optical = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    sides = {
        "vehicle-side": {
            "lidar_to_novatel": {"transform": {"rotation": same, "translation": [[0], [0], [0.5]]}},
            "novatel_to_world": {"rotation": facing["+y"], "translation": [[100], [50], [21.5]]},
            "lidar_to_camera": {"rotation": optical, "translation": [[0], [0], [0]]},
        },
        "infrastructure-side": {
            "virtuallidar_to_world": {
                "rotation": facing["-y"],
                "translation": [[99], [80.5], [26]],
                "relative_error": {"delta_x": 1.0, "delta_y": -0.5},
            },
            "virtuallidar_to_camera": {"rotation": optical, "translation": [[0], [0], [0]]},
        },
    }
    for side, calibration in sides.items():
        calibration["camera_intrinsic"] = {"cam_K": [40, 0, 40, 0, 40, 30, 0, 0, 1]}
        for kind, content in calibration.items():
            write_json(tmp_path / side / "calib" / kind / "1.json", content)
        (tmp_path / side / "velodyne").mkdir()
        write_pcd(tmp_path / side / "velodyne" / "1.pcd", np.array([[10.0, 1.0, -1.0, 51.0]]))
        write_png(tmp_path / side / "image" / "1.jpg", GREY)
        entry = {f"calib_{kind}_path": f"calib/{kind}/1.json" for kind in calibration}
        entry |= {"image_path": "image/1.jpg", "pointcloud_path": "velodyne/1.pcd", "batch_id": "4"}
        write_json(tmp_path / side / "data_info.json", [entry | {"pointcloud_timestamp": "1626155123000000"}])
    labels = [
        {"type": "Car", "world_8_points": dair_box(102, 60, 20, 4, 2, 1.5)},
        {"type": "Pedestrian", "world_8_points": dair_box(101, 60, 20, 0.5, 0.5, 1.7)},
    ]
    write_json(tmp_path / "cooperative" / "label_world" / "1.json", labels)
    pair = {f"{side}_pointcloud_path": f"{side}-side/velodyne/1.pcd" for side in ("vehicle", "infrastructure")}
    pair |= {"cooperative_label_path": "cooperative/label_world/1.json", "system_error_offset": ""}
    write_json(tmp_path / "cooperative" / "data_info.json", [pair])
    return tmp_path


def test_dair_v2x_by_hand(dair):
    """The car is 10 m ahead of the vehicle and 2 m to its right, and faces +x, which is to its right: -90 degrees."""
    recording = open_recording("dair_v2x", dair)
    record = recording.read("4", "1").record
    np.testing.assert_allclose(record.labels.boxes, [[10, -2, 0.75, 4, 2, 1.5, -QUARTER]], atol=1e-9)
    np.testing.assert_allclose(record.ego.world_from_agent.translation, [100, 50, 20], atol=1e-9)
    np.testing.assert_allclose(record.ego.points, [[10, 1, 1, 0.2]], atol=1e-6)
    frame = record.frame()
    np.testing.assert_allclose(frame.ego_from_infra.apply(np.zeros(3)), [30, 0, 0], atol=1e-9)
    np.testing.assert_allclose(frame.infra.points, [[10, 1, 5, 0.2]], atol=1e-6)
    np.testing.assert_allclose(frame.ego_from_infra.apply(np.array([10.0, 1, 5])), [20, -1, 5], atol=1e-9)
    np.testing.assert_allclose(frame.ego.camera.project(np.array([10.0, 2, 2]))[0], [32, 30], atol=1e-9)
    assert dict(recording.notes.counts) == {"label of type Pedestrian left out": 1}


def test_a_camera_that_looks_another_way_than_the_lidar_is_refused(dair):
    edit(dair / "vehicle-side" / "calib" / "lidar_to_camera" / "1.json", rotation=[[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    with pytest.raises(RecordError, match=r"lidar_to_camera/1.json: .*looks 90 degrees away from the LiDAR's x axis"):
        only_record("dair_v2x", dair)


def edit(file, **changes):
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


def test_a_world_that_scales_is_refused_and_one_that_is_nearly_rigid_repaired(dair):
    file = dair / "infrastructure-side" / "calib" / "virtuallidar_to_world" / "1.json"
    edit(file, rotation=[[0, 1.1, 0], [-1, 0, 0], [0, 0, 1]])
    with pytest.raises(RecordError, match=r"virtuallidar_to_world/1.json: .*differ by up to 0.1 .*at most 0.01"):
        only_record("dair_v2x", dair)
    edit(file, rotation=[[0, 1.004, 0], [-1, 0, 0], [0, 0, 1]])
    recording = open_recording("dair_v2x", dair)
    assert recording.read("4", "1").record.frame().ego_from_infra.apply(np.zeros(3)) == pytest.approx([30, 0, 0])
    assert sorted(recording.notes.counts) == [
        "label of type Pedestrian left out",
        "virtuallidar_to_world that is no rotation, replaced by the nearest one",
    ]
    edit(file, rotation=[[0, 1, 0], [1, 0, 0], [0, 0, 1]])
    with pytest.raises(RecordError, match=r"virtuallidar_to_world/1.json: .*mirrors"):
        only_record("dair_v2x", dair)


# ---------------------------------------------------------------- calibration that shears

# virtuallidar_to_camera of frame 000009, as issue 22 of AIR-THU/DAIR-V2X quotes it; K is of that camera's kind.
SHEARED = np.array(
    [
        [-0.06380332, -0.99109149, -0.04429948],
        [-0.21028734, 0.04399769, -0.79876929],
        [0.97575115, -0.06031493, -0.17158543],
    ]
)
K = np.array([[2183.4, 0, 940.6], [0, 2329.3, 567.6], [0, 0, 1.0]])


def test_a_sheared_calibration_keeps_the_pixels_of_its_points():
    """Against K (R p + t) itself; what is lost is the skew that is told."""
    translation = np.array([1.0, 0.5, -0.3])
    points = np.random.default_rng(0).uniform([10, -8, -6], [60, 8, 0], (200, 3))
    seen = (points @ SHEARED.T + translation) @ K.T
    expected = seen[:, :2] / seen[:, 2:]
    camera, skew_px = axes.pinhole(1920, 1080, K, SHEARED, translation)
    found = camera.project(points)[0]
    np.testing.assert_allclose(found[:, 1], expected[:, 1], atol=1e-6)
    inside = (expected[:, 1] > 0) & (expected[:, 1] < 1080)
    assert 0 < np.abs(found - expected)[inside].max() <= skew_px + 1e-6 < 6
    nearest = np.linalg.svd(SHEARED)
    naive = (points @ (nearest[0] @ nearest[2]).T + translation) @ K.T
    assert np.abs(naive[:, :2] / naive[:, 2:] - expected)[inside].max() > 50  # what the nearest rotation would cost


@pytest.mark.parametrize(("row", "column", "value"), [(0, 1, 9.0), (1, 0, 9.0), (2, 0, 0.01), (2, 2, 0.5)])
def test_intrinsics_with_a_skew_or_of_another_form_are_refused(row, column, value):
    """A pin-hole of ours has no place for them: with a skew of 9 pixels they were taken without it."""
    wrong = K.copy()
    wrong[row, column] = value
    for make in (
        lambda: axes.pinhole(1920, 1080, wrong, np.eye(3), np.zeros(3)),
        lambda: axes.unreal_camera(Pose.identity(), 1920, 1080, wrong),
    ):
        with pytest.raises(GeometryError, match=r"intrinsics: expected \[fx, 0, cx\].*found \[2183.4, "):
            make()


def test_a_calibration_that_is_a_rotation_stays_as_it_is():
    rotation = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]], float)
    camera, skew_px = axes.pinhole(1920, 1080, K, rotation, np.zeros(3))
    assert skew_px == 0
    np.testing.assert_array_equal(camera.intrinsics, K)


@pytest.mark.parametrize(
    ("block", "message"),
    [(np.diag([1.0, 1, -1]), "mirrors"), (np.zeros((3, 3)), "flattens"), (2 * np.eye(3), "differ by up to 1 ")],
)
def test_what_no_repair_explains_is_refused(block, message):
    for make in (lambda: axes.pinhole(80, 60, K, block, np.zeros(3)), lambda: axes.repaired_pose(block, np.zeros(3))):
        with pytest.raises(GeometryError, match=message):
            make()


# ---------------------------------------------------------------- wrong values, one line each

OPV2V_DAMAGE = {
    "five numbers": ("lidar_pose: [10.0, ", "lidar_pose: [", r"lidar_pose: expected numbers of shape \(6,\)"),
    "no pose": ("true_ego_pos", "ego_pos", "true_ego_pos: missing"),
    "cut": ("vehicles:\n", "vehicles: [\n", "not YAML of plain values"),
    "NaN": ("[10.0, 30.0, 0.5]", "[10.0, .nan, 0.5]", r"vehicles.7.location: holds NaN"),
    "no vehicles": ("vehicles:", "cars:", "vehicles: missing"),
    "a named vehicle": ("  8: {", "  van: {", "expected a whole number as a vehicle's id, found 'van'"),
}  # fmt: skip


@pytest.mark.parametrize("name", OPV2V_DAMAGE)
def test_a_damaged_yaml_is_named_by_file_and_field(opv2v, name):
    old, new, message = OPV2V_DAMAGE[name]
    file = opv2v / "2026_01_01_00_00_00" / "3" / "000068.yaml"
    assert old in OPV2V
    file.write_text(OPV2V.replace(old, new))
    with pytest.raises(RecordError, match=rf"000068.yaml: .*{message}"):
        only_record("opv2v", opv2v)


CARLA_DAMAGE = {
    "no ego": (lambda c: c["actors"].pop(0), r"frames/30.json: actors: no actor has the ego's id 1"),
    "no wheels": (lambda c: c["actors"][1]["attributes"].clear(), r"actors\[1\].attributes.number_of_wheels: missing"),
    "no pose": (lambda c: c["sensors"].pop("eye"), r"frames/30.json: sensors.eye: missing"),
    "a word": (
        lambda c: c["actors"][1]["transform"]["rotation"].update(yaw="north"),
        r"actors\[1\].transform.rotation.yaw: expected a number, found 'north'",
    ),
}


@pytest.mark.parametrize("name", CARLA_DAMAGE)
def test_a_damaged_tick_is_named_by_file_and_field(carla, name):
    change, message = CARLA_DAMAGE[name]
    file = carla / "lot" / "frames" / "30.json"
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))
    with pytest.raises(RecordError, match=message):
        only_record("carla", carla)


@pytest.mark.parametrize("fov", ["0", "180", "200", "-90"])
def test_a_field_of_view_that_no_pin_hole_has_is_refused(carla, fov):
    """At 180 degrees the focal length is 5e-15 pixels: above 0, and every point in the middle of the picture."""
    file = carla / "lot" / "scene.json"
    content = json.loads(file.read_text())
    content["sensors"]["eye"]["attributes"]["fov"] = fov
    file.write_text(json.dumps(content))
    with pytest.raises(RecordError, match=rf"fov: expected degrees above 0 and below 180, found {fov}"):
        only_record("carla", carla)


def test_a_depth_camera_elsewhere_and_a_second_camera_are_refused(carla):
    file = carla / "lot" / "scene.json"
    content = json.loads(file.read_text())
    eye = content["sensors"]["eye"]
    content["sensors"]["second"] = eye
    file.write_text(json.dumps(content))
    with pytest.raises(RecordError, match=r"scene.json: sensors: mast has several sensor.camera.rgb \(eye, second\)"):
        open_recording("carla", carla)
    content["sensors"]["second"] = eye | {"type": "sensor.camera.depth"}
    file.write_text(json.dumps(content))
    tick = carla / "lot" / "frames" / "30.json"
    moved = json.loads(tick.read_text())
    moved["sensors"]["second"] = carla_pose(21, 0, 7.2, yaw=180, pitch=-30)
    tick.write_text(json.dumps(moved))
    write_png(carla / "lot" / "second" / "30.png", GREY)
    with pytest.raises(RecordError, match=r"sensors.second: the depth camera does not stand where eye stands"):
        only_record("carla", carla)


# ---------------------------------------------------------------- any damage at all

JUNK = (None, "", "x", -1, 1e400, [], {}, [[1]], True, "1626")


def spoil(value, rng):
    """Another value somewhere inside a JSON or YAML value, or an entry less."""
    if isinstance(value, dict | list) and value and rng.random() < 0.9:
        key = rng.choice(list(value) if isinstance(value, dict) else range(len(value)))
        if rng.random() < 0.15:
            del value[key]
        else:
            value[key] = spoil(value[key], rng)
        return value
    return rng.choice(JUNK)


@pytest.mark.parametrize("seed", range(25))
@pytest.mark.parametrize("format_name", ["opv2v", "carla", "dair"])
def test_damage_anywhere_is_a_record_error_or_does_no_harm(format_name, seed, request):
    root, rng = request.getfixturevalue(format_name), random.Random(seed)
    file = rng.choice(sorted(p for p in root.rglob("*") if p.suffix in (".json", ".yaml", ".pcd", ".jpg", ".png")))
    if file.suffix in (".json", ".yaml"):
        file.write_text(json.dumps(spoil(yaml.safe_load(file.read_text()), rng)))  # JSON is YAML, too
    else:
        file.write_bytes(file.read_bytes()[: rng.randrange(file.stat().st_size)])
    with suppress(RecordError):
        recording = open_recording("dair_v2x" if format_name == "dair" else format_name, root)
        for scene in recording.scenes:
            for frame in scene.frames:
                recording.read(scene.name, frame)
