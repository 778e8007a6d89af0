"""The ``.rrd`` read back by Rerun's own reader: what it holds is the episode, in float32."""

import cv2
import numpy as np
import pytest

from pcdet_avp.closed_loop.export.formats import FORMATS, ExportSettings
from pcdet_avp.closed_loop.export.sensors import looks, sensor_ticks
from pcdet_avp.errors import OutputError

pytest.importorskip("rerun", reason="needs rerun-sdk: pip install pcdet_avp[episodes]")
chunk = pytest.importorskip("rerun.chunk", reason="needs rerun-sdk 0.41 or newer to read")
pytestmark = pytest.mark.slow
SETTINGS = ExportSettings(every=90, widest_px=96)


@pytest.fixture(scope="module")
def rows(junction, tmp_path_factory):
    """By entity: (time in ns, None where static; columns) of every row."""
    (file,) = FORMATS["rrd"].write(junction, tmp_path_factory.mktemp("rrd") / "e", SETTINGS)
    found = {}
    for part in chunk.RrdReader(file).stream().to_chunks():
        batch = part.to_record_batch()
        nanoseconds = [None] * len(batch) if part.is_static else batch.column("episode").cast("int64").to_pylist()
        values = batch.drop_columns([name for name in batch.schema.names if ":" not in name]).to_pylist()
        found.setdefault(part.entity_path, []).extend(zip(nanoseconds, values, strict=True))
    return found


def by_time(rows, path, column):
    """Times (T,) and values in order of time; rows that have not this column are left out."""
    pairs = sorted((time, row[column]) for time, row in rows[path] if row.get(column) is not None)
    return np.array([time for time, _ in pairs]) / 1e9, [value for _, value in pairs]


def test_speeds_targets_and_bytes_are_the_episodes(rows, junction):
    record = junction[0].record
    for path, expected in (
        ("/speeds/speed", record.log.speeds),
        ("/speeds/target", record.log.targets),
        ("/speeds/target_alone", record.targets_alone),
        ("/link/bytes", [sum(m.bytes for m in tick) for tick in record.messages]),
    ):
        times, values = by_time(rows, path, "Scalars:scalars")
        np.testing.assert_allclose(times, record.log.times, atol=1e-9)
        np.testing.assert_array_equal(np.ravel(values), expected)


def test_boxes_stand_where_they_stood(rows, junction):
    record = junction[0].record
    (other,) = [user for user in record.users if not user.stands]
    _, centres = by_time(rows, "/world/road_users", "Boxes3D:centers")
    _, halves = by_time(rows, "/world/road_users", "Boxes3D:half_sizes")
    np.testing.assert_array_equal(np.array(centres, np.float32)[:, 0], other.boxes()[:, :3].astype(np.float32))
    np.testing.assert_array_equal(np.array(halves, np.float32)[0, 0], (np.array(other.size) / 2).astype(np.float32))
    ((time, parked),) = rows["/world/parked"]
    assert time is None
    assert len(parked["Boxes3D:centers"]) == sum(user.stands for user in record.users)
    for name, heeded in (("heeded", True), ("ignored", False)):
        _, found = by_time(rows, f"/world/detections/fused/{name}", "Boxes3D:centers")
        expected = [0 if found is None else int((found.heeded == heeded).sum()) for found in record.found]
        assert [len(boxes) for boxes in found] == expected


def test_clouds_and_images_are_what_the_sensors_saw(rows, junction):
    driven, ticks = junction[0], sensor_ticks(junction[0], SETTINGS)
    ego, infra = looks(driven, ticks[0], SETTINGS)
    times, clouds = by_time(rows, "/world/infra_0/points", "Points3D:positions")
    np.testing.assert_allclose(times, driven.record.log.times[ticks], atol=1e-9)
    np.testing.assert_array_equal(np.array(clouds[0], np.float32), infra.points[:, :3])
    assert "/world/ego/points" not in rows  # the combination is C+CL
    _, images = by_time(rows, "/world/ego/camera", "EncodedImage:blob")
    blob = images[0][0]
    image = cv2.imdecode(np.frombuffer(bytes(blob), np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(image[..., ::-1].astype(int) - ego.image).mean() < 4  # JPEG
    _, matrices = by_time(rows, "/world/ego/camera", "Pinhole:image_from_camera")
    np.testing.assert_allclose(np.ravel(matrices[0]), ego.camera.intrinsics.T.ravel(), rtol=1e-6)  # by columns


def test_the_ego_frame_goes_where_the_ego_went(rows, junction):
    _, places = by_time(rows, "/world/ego", "Transform3D:translation")
    np.testing.assert_allclose(np.array(places)[:, 0, :2], junction[0].frames()[:, :2], atol=1e-4)


def test_a_full_disk_is_one_error_and_leaves_nothing(junction, tmp_path, full_disk):
    with full_disk(20_000), pytest.raises(OutputError, match=r"e\.rrd: cannot be written"):
        FORMATS["rrd"].write(junction, tmp_path / "e", ExportSettings(every=0))
    assert list(tmp_path.iterdir()) == []
