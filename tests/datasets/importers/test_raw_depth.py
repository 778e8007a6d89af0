"""CARLA's raw depth pictures: the low byte is red. Whatever else a file holds is refused instead of being decoded."""

import cv2
import numpy as np
import pytest

from pcdet_avp.datasets.importers.recording import read_raw_depth
from pcdet_avp.errors import RecordError


def write(file, red, green, blue, alpha=None):
    channels = [blue, green, red] + ([] if alpha is None else [alpha])
    cv2.imwrite(str(file), np.stack(channels, -1).astype(np.uint8))
    return file


@pytest.mark.parametrize("alpha", [None, 255])
def test_metres_by_hand(tmp_path, alpha):
    """Of 16,777,215 steps to 1000 m: 1; 256; 65,536; all."""
    red, green, blue = np.array([[1, 0, 0, 255]]), np.array([[0, 1, 0, 255]]), np.array([[0, 0, 1, 255]])
    file = write(tmp_path / "a.png", red, green, blue, None if alpha is None else np.full((1, 4), alpha))
    expected = [[1000 / 16777215, 256000 / 16777215, 65536000 / 16777215, 1000.0]]
    np.testing.assert_allclose(read_raw_depth(file), expected, rtol=1e-6)


def test_sky_alone_is_white_and_far(tmp_path):
    white = np.full((2, 3), 255)
    assert read_raw_depth(write(tmp_path / "a.png", white, white, white)).tolist() == [[1000.0] * 3] * 2


def test_what_is_not_raw_or_not_whole_is_refused(tmp_path):
    rows, columns = np.indices((60, 80))
    raw = write(tmp_path / "a.png", rows, columns, rows * 0)
    raw.write_bytes(raw.read_bytes()[:-40])  # decoders fill the rest and say nothing
    with pytest.raises(RecordError, match=r"a\.png: truncated PNG"):
        read_raw_depth(raw)
    grey = write(tmp_path / "grey.png", rows, rows, rows)
    with pytest.raises(RecordError, match=r"grey\.png: grey throughout: save depth raw"):
        read_raw_depth(grey)
    write(tmp_path / "b.jpg", rows, columns, rows * 0).rename(tmp_path / "b.png")
    with pytest.raises(RecordError, match=r"b\.png: a depth picture must be a PNG"):
        read_raw_depth(tmp_path / "b.png")
