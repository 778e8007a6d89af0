"""Detections survive the disk, and a damaged file is one error."""

import numpy as np
import pytest

from pcdet_avp.errors import EvaluationError, OutputError
from pcdet_avp.evaluation.detections_file import read_detections, write_detections, write_texts
from pcdet_avp.evaluation.inputs import Detections

BOX = [10.25, -2.5, 0.75, 4.5, 1.75, 1.5, 0.125]


@pytest.fixture
def found():
    """Three frames; the middle one is empty."""
    boxes = np.array([BOX, BOX, BOX]) + np.arange(3)[:, None]
    first = Detections("0007/001", boxes, np.array(["Car", "Pedestrian", "Car"]), np.array([0.5, 0.25, 0.125]))
    empty = Detections("0007/002", np.zeros((0, 7)), np.zeros(0, str), np.zeros(0))
    return [first, empty, Detections("0008/000", boxes[:1], np.array(["Pedestrian"]), np.array([1.0]))]


def test_what_was_written_is_read(found, tmp_path):
    write_detections(tmp_path / "new" / "a.npz", found)
    back = read_detections(tmp_path / "new" / "a.npz")
    assert [d.frame_id for d in back] == [d.frame_id for d in found]
    for ours, theirs in zip(back, found, strict=True):
        assert np.array_equal(ours.boxes, theirs.boxes)  # the numbers above are exact in float32
        assert ours.names.tolist() == theirs.names.tolist()
        assert np.array_equal(ours.scores, theirs.scores)


def test_nothing_at_all_is_a_file_too(tmp_path):
    write_detections(tmp_path / "a.npz", [])
    assert read_detections(tmp_path / "a.npz") == []


def test_no_code_can_hide_in_a_file(found, tmp_path):
    np.savez(tmp_path / "a.npz", **{key: np.array([{}]) for key in ("frame_id", "frame", "boxes_lidar")})
    with pytest.raises(EvaluationError, match=r"a\.npz: not a file of detections"):
        read_detections(tmp_path / "a.npz")


@pytest.mark.parametrize("share", [0.0, 0.5, 0.95])
def test_a_truncated_file_is_named(found, tmp_path, share):
    path = tmp_path / "a.npz"
    write_detections(path, found)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(EvaluationError, match=r"a\.npz: not a file of detections"):
        read_detections(path)


def test_a_place_that_cannot_be_is_named(found, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file/a\.npz: cannot be written"):
        write_detections(tmp_path / "file" / "a.npz", found)
    with pytest.raises(OutputError, match=r"file/0007_001\.txt: cannot be written"):
        write_texts(tmp_path / "file", found)


def test_texts_have_a_line_per_box(found, tmp_path):
    write_texts(tmp_path, found)
    assert (tmp_path / "0007_001.txt").read_text().splitlines()[0] == (
        "Car 0.5000 10.2500 -2.5000 0.7500 4.5000 1.7500 1.5000 0.1250"
    )
    assert (tmp_path / "0007_002.txt").read_text() == ""
