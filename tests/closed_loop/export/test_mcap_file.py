"""The MCAP read back by another library, mcap with protobuf's own classes: values of the episode, not just a file."""

import json

import cv2
import numpy as np
import pytest

from pcdet_avp.closed_loop.export.formats import FORMATS, ExportSettings
from pcdet_avp.closed_loop.export.sensors import looks, sensor_ticks
from pcdet_avp.errors import OutputError

pytest.importorskip("foxglove", reason="needs foxglove-sdk: pip install pcdet_avp[episodes]")
reader = pytest.importorskip("mcap.reader", reason="needs mcap: pip install pcdet_avp[episodes]")
decoder = pytest.importorskip("mcap_protobuf.decoder", reason="needs mcap-protobuf-support")
SETTINGS = ExportSettings(every=60, widest_px=96)


@pytest.fixture(scope="module")
def file(junction, tmp_path_factory):
    """Without images and clouds, which are rendered."""
    (written,) = FORMATS["mcap"].write(junction, tmp_path_factory.mktemp("mcap") / "e", ExportSettings(every=0))
    return written


@pytest.fixture(scope="module")
def messages(file):
    return by_topic(file)


@pytest.fixture(scope="module")
def seen(junction, tmp_path_factory):
    """With images and clouds."""
    (written,) = FORMATS["mcap"].write(junction, tmp_path_factory.mktemp("seen") / "e", SETTINGS)
    return by_topic(written)


def by_topic(file):
    """(log time in ns, message) of every topic."""
    found, factory = {}, decoder.DecoderFactory()
    with file.open("rb") as stream:
        opened = reader.make_reader(stream, decoder_factories=[factory])
        for schema, channel, message in opened.iter_messages():
            as_text = channel.message_encoding == "json"
            value = json.loads(message.data) if as_text else factory.decoder_for("protobuf", schema)(message.data)
            found.setdefault(channel.topic, []).append((message.log_time, value))
    return found


def position(pose):
    return pose.position.x, pose.position.y, pose.position.z


def yaw(orientation):
    return 2 * np.arctan2(orientation.z, orientation.w)


def test_times_are_the_episodes_and_not_the_wall_clocks(messages, junction):
    times = junction[0].record.log.times
    assert [time for time, _ in messages["/state"]] == np.round(1e9 * times).astype(int).tolist()
    stamps = [m.entities[0].timestamp for _, m in messages["/truth"]]
    assert [stamp.ToNanoseconds() for stamp in stamps] == [time for time, _ in messages["/state"]]


def test_speeds_targets_and_bytes_are_the_episodes(messages, junction):
    record, states = junction[0].record, [state for _, state in messages["/state"]]
    for name, values in (
        ("speed_mps", record.log.speeds),
        ("target_mps", record.log.targets),
        ("target_alone_mps", record.targets_alone),
        ("message_bytes", [sum(m.bytes for m in tick) for tick in record.messages]),
    ):
        np.testing.assert_array_equal([state[name] for state in states], values)


def test_road_users_stand_where_they_stood(messages, junction):
    record = junction[0].record
    (other,) = [user for user in record.users if not user.stands]
    for tick in (0, 100, len(record.ego) - 1):
        ego, user = messages["/truth"][tick][1].entities
        assert (ego.id, user.id) == ("ego", str(other.object_id))
        (cube,) = user.cubes
        np.testing.assert_allclose(position(cube.pose), other.boxes()[tick, :3])
        np.testing.assert_allclose((cube.size.x, cube.size.y, cube.size.z), other.size)
        assert np.cos(yaw(cube.pose.orientation) - other.poses[tick, 2]) == pytest.approx(1.0)
        np.testing.assert_allclose(position(ego.cubes[0].pose)[:2], record.ego[tick, :2])
    parked = [entity for entity in messages["/garage"][0][1].entities if entity.id.isdigit()]
    assert len(parked) == sum(user.stands for user in record.users)


def test_both_lists_of_detections_are_there(messages, junction):
    record = junction[0].record
    for topic, looked in (("/detections/fused", record.found), ("/detections/alone", record.alone)):
        counts = [len(update.entities) for _, update in messages[topic]]
        assert counts == [0 if found is None else len(found.boxes) for found in looked]
    tick = next(tick for tick, found in enumerate(record.found) if found is not None and found.heeded.any())
    entities = messages["/detections/fused"][tick][1].entities
    heeded = [e for e in entities if {p.key: p.value for p in e.metadata}["heeded"] == "True"]
    assert len(heeded) == record.found[tick].heeded.sum() == 1
    np.testing.assert_allclose(
        position(heeded[0].lines[0].pose), record.found[tick].boxes[record.found[tick].heeded][0, :3]
    )


@pytest.mark.slow
def test_clouds_and_images_are_what_the_sensors_saw(seen, junction):
    driven, ticks = junction[0], sensor_ticks(junction[0], SETTINGS)
    assert [time for time, _ in seen["/infra_0/points"]] == [round(1e9 * driven.record.log.times[t]) for t in ticks]
    ego, infra = looks(driven, ticks[1], SETTINGS)
    assert ego.points is None  # the combination is C+CL
    cloud = seen["/infra_0/points"][1][1]
    read = np.frombuffer(cloud.data, "<f4").reshape(-1, cloud.point_stride // 4)
    np.testing.assert_array_equal(read, infra.points)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "intensity"]
    image = cv2.imdecode(np.frombuffer(seen["/ego/camera/image"][1][1].data, np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(image[..., ::-1].astype(int) - ego.image).mean() < 4  # JPEG
    np.testing.assert_allclose(seen["/ego/camera/calibration"][1][1].K, ego.camera.intrinsics.ravel())


@pytest.mark.slow
def test_transforms_lead_from_the_camera_to_the_world(seen, junction):
    driven, found = junction[0], {}
    for _, message in seen["/tf"]:
        for transform in message.transforms:
            found.setdefault((transform.parent_frame_id, transform.child_frame_id), []).append(transform)
    assert {("world", "ego"), ("ego", "ego_camera"), ("world", "infra_0"), ("infra_0", "infra_0_camera")} == set(found)
    last, pose = found["world", "ego"][-1], driven.frames()[-1]
    np.testing.assert_allclose((last.translation.x, last.translation.y), pose[:2])
    mast = found["world", "infra_0"][0]
    assert abs(yaw(mast.rotation)) == pytest.approx(np.pi)


def test_the_same_episode_gives_the_same_bytes(file, junction, tmp_path):
    (again,) = FORMATS["mcap"].write(junction, tmp_path / "e", ExportSettings(every=0))
    assert again.read_bytes() == file.read_bytes()


def test_a_full_disk_is_one_error_and_leaves_nothing(file, junction, tmp_path, full_disk):
    with full_disk(file.stat().st_size - 100), pytest.raises(OutputError, match=r"e\.mcap: cannot be written"):
        FORMATS["mcap"].write(junction, tmp_path / "e", ExportSettings(every=0))
    assert list(tmp_path.iterdir()) == []
