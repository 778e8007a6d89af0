"""tools/demo.py as a user meets it."""

import cv2
import numpy as np
import pytest

from pcdet_avp.datasets.avp.manifest import read_manifest
from pcdet_avp.datasets.avp.record import read_frame
from pcdet_avp.errors import ConfigError, RecordError
from pcdet_avp.evaluation.detections_file import read_detections


@pytest.fixture
def demo(call, trained, tmp_path):
    def run(*arguments):
        call(tmp_path, "demo", "--ckpt", trained / "ckpt" / "checkpoint_epoch_2.pth", "--out", tmp_path, *arguments)

    return run


def test_a_frame_as_a_picture(demo, tiny_data, tmp_path):
    frame_id = read_manifest(tiny_data).frame_ids("test")[0]
    demo("--frame", frame_id)
    picture = cv2.imread(str(tmp_path / f"{frame_id.replace('/', '_')}.png"))
    assert picture.shape[1] == 1600
    assert picture.std() > 10


def test_a_split_as_a_video(demo, tmp_path):
    demo("--split", "train", "--frames", 2)
    video = cv2.VideoCapture(str(tmp_path / "train.mp4"))
    frames = []
    while (read := video.read())[0]:
        frames.append(read[1])
    assert len(frames) == 2
    assert frames[0].std() > 10
    assert abs(frames[0].astype(int) - frames[1]).mean() > 1


def test_an_unknown_frame_is_named(demo):
    with pytest.raises(ConfigError, match="--frame 9/9: not in split 'test', which holds"):
        demo("--frame", "9/9")


def test_a_folder_of_clouds_gives_pictures_and_detections(demo, tiny_data, tmp_path):
    """The vehicle's own cloud, as if a user had recorded it with a LiDAR at 1.9 m."""
    frame_id = read_manifest(tiny_data).frame_ids("test")[0]
    points = read_frame(tiny_data, frame_id, ["ego_lidar"]).ego.points - np.float32([0, 0, 1.9, 0])
    clouds = tmp_path / "clouds"
    clouds.mkdir()
    points.tofile(clouds / "first.bin")
    np.save(clouds / "second.npy", points)
    demo("--data_path", clouds)
    first = cv2.imread(str(tmp_path / "first.png"))
    assert first.std() > 10
    assert (tmp_path / "second.png").exists()
    found = read_detections(tmp_path / "detections.npz")
    assert [d.frame_id for d in found] == ["first", "second"]
    assert np.array_equal(found[0].boxes, found[1].boxes)
    demo("--data_path", clouds / "first.bin", "--lidar_height_m", 6)
    assert (cv2.imread(str(tmp_path / "first.png")) != first).any()


def test_one_bad_cloud_costs_no_other_and_is_counted(demo, tiny_data, tmp_path, capsys):
    frame_id = read_manifest(tiny_data).frame_ids("test")[0]
    points = read_frame(tiny_data, frame_id, ["ego_lidar"]).ego.points - np.float32([0, 0, 1.9, 0])
    clouds = tmp_path / "clouds"
    clouds.mkdir()
    points.tofile(clouds / "same.bin")
    np.save(clouds / "same.npy", points)
    (clouds / "broken.npy").write_bytes(b"none")
    with pytest.raises(RecordError, match="1 of 3 clouds were skipped"):
        demo("--data_path", clouds)
    assert "broken.npy: not a point cloud" in capsys.readouterr().err
    assert {file.name for file in tmp_path.glob("*.png")} == {"same.bin.png", "same.npy.png"}
    found = read_detections(tmp_path / "detections.npz")
    assert [d.frame_id for d in found] == ["same.bin", "same.npy"]
    assert np.array_equal(found[0].boxes, found[1].boxes)


def test_nothing_is_written_where_no_cloud_can_be_read(demo, tmp_path):
    clouds = tmp_path / "clouds"
    clouds.mkdir()
    (clouds / "broken.npy").write_bytes(b"none")
    with pytest.raises(RecordError, match="none of 1 clouds could be read"):
        demo("--data_path", clouds)
    assert not (tmp_path / "detections.npz").exists()
