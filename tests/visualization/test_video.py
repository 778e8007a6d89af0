"""Videos and pictures as files."""

import cv2
import numpy as np
import pytest

from pcdet_avp.errors import ConfigError, OutputError
from pcdet_avp.visualization import video
from pcdet_avp.visualization.video import write_picture, write_video

COLORS = [(200, 30, 30), (30, 200, 30), (30, 30, 200)]


def frames():
    return (np.full((64, 96, 3), color, np.uint8) for color in COLORS)


def read(file):
    capture, images = cv2.VideoCapture(str(file)), []
    while (got := capture.read())[0]:
        images.append(got[1][..., ::-1])
    return images


@pytest.mark.parametrize("codec", video.CODECS)
def test_every_codec_brings_the_colours_back_in_order(codec, tmp_path, monkeypatch):
    monkeypatch.setattr(video, "CODECS", [codec])
    images = read(write_video(tmp_path / "new" / "a.mp4", frames(), 20))
    assert [int(image.mean((0, 1)).argmax()) for image in images] == [0, 1, 2]
    np.testing.assert_allclose([image.mean((0, 1)) for image in images], COLORS, atol=12)


def test_an_unknown_codec_gives_way_to_the_next(tmp_path, monkeypatch):
    monkeypatch.setattr(video, "CODECS", [("none", ".mp4"), ("MJPG", ".avi")])
    assert write_video(tmp_path / "a.mp4", frames(), 20) == tmp_path / "a.avi"
    assert len(read(tmp_path / "a.avi")) == 3


def test_an_interrupted_video_is_none(tmp_path):
    def broken():
        yield from frames()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(tmp_path / "a.mp4", broken(), 20)
    assert not list(tmp_path.iterdir())


def test_a_video_that_cannot_be_moved_into_place_is_one_clear_error(tmp_path):
    (tmp_path / "a.mp4").mkdir()
    (tmp_path / "a.mp4" / "file").touch()
    with pytest.raises(OutputError, match=r"a\.mp4: cannot be written"):
        write_video(tmp_path / "a.mp4", frames(), 20)
    assert [file.name for file in tmp_path.iterdir()] == ["a.mp4"]


def test_no_picture_is_no_video(tmp_path):
    with pytest.raises(OutputError, match="at least one picture"):
        write_video(tmp_path / "a.mp4", [], 20)


def test_a_picture_comes_back(tmp_path):
    image = next(frames())
    write_picture(tmp_path / "new" / "a.png", image)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "new" / "a.png"))[..., ::-1], image)


@pytest.mark.parametrize("name", ["a.gif", "a", "a.mp4.txt"])
def test_a_name_that_is_no_videos_is_refused(name, tmp_path):
    with pytest.raises(ConfigError, match=rf"{name}: expected a video's name, \*.mp4 or \*.avi"):
        write_video(tmp_path / name, frames(), 20)
    assert not list(tmp_path.iterdir())


def test_a_video_has_the_container_that_its_name_says(tmp_path):
    assert write_video(tmp_path / "a.avi", frames(), 20) == tmp_path / "a.avi"
    assert (tmp_path / "a.avi").read_bytes()[8:12] == b"AVI "
