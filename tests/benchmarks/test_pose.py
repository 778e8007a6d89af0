"""benchmarks/pose.py: the errors that are put in, and what is said to be left of them."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pcdet_avp.bandwidth.late_fusion import Boxes
from pcdet_avp.errors import ConfigError
from pcdet_avp.registration import Correction
from pcdet_avp.structures.pose import Pose


@pytest.fixture(scope="module")
def pose(load_benchmark):
    return load_benchmark("pose")


@pytest.mark.parametrize("text", ["0.5:2", "0:0,1", "0:0,a:b", "0:0,-1:2", ""])
def test_sizes_that_are_none_are_refused(pose, text):
    with pytest.raises(ConfigError, match="--errors: expected"):
        pose.parse_sizes(text)


def test_errors_of_all_sizes_have_one_direction_and_their_standard_deviations(pose):
    _, small, large = pose.parse_sizes("0:0,0.25:1,0.5:2")
    motions = []
    for number in range(400):
        a, b = (size.drawn(f"{number}/0", 0) for size in (small, large))
        np.testing.assert_allclose(b.translation, 2 * a.translation)
        assert b.yaw == pytest.approx(2 * a.yaw)
        motions.append([*b.translation[:2], np.degrees(b.yaw)])
    np.testing.assert_allclose(np.std(motions, 0), [0.5, 0.5, 2.0], rtol=0.12)


def test_what_is_left_is_the_correction_behind_the_error(pose):
    error = Pose.from_xyz_yaw(0.3, 0.4, yaw=np.radians(3))
    nothing = pose.judged({"corrections": [Correction(Pose.identity())]}, error)
    assert (nothing["left_m"], nothing["left_deg"]) == (pytest.approx(0.5), pytest.approx(3.0))
    perfect = pose.judged({"corrections": [Correction(error.inverse(), True, 0.5)]}, error)
    assert (perfect["left_m"], perfect["left_deg"]) == (pytest.approx(0, abs=1e-9), pytest.approx(0, abs=1e-9))


def test_the_share_of_a_loss_that_is_left(pose):
    def points(value):
        return {"points": value, "low": value - 1, "high": value + 1}

    one = {"ap": {"without": 50.0, "with": 80.0}, "without": points(-40.0), "with": points(-10.0), "gain": points(30.0)}
    assert pose.class_cells(one) == ["50.0 (-40.0)", "80.0 (-10.0)", "+30.0 [+29.0, +31.0]", "25 %"]
    assert pose.class_cells({**one, "gain": None}) == ["-"] * 4


def test_a_frame_s_results_are_kept_and_read_again(pose, tmp_path, monkeypatch):
    asked = []

    def runner(batch):
        asked.append(batch)
        boxes = Boxes(torch.ones(1, 7), torch.tensor([0.5]), torch.ones(1, dtype=torch.int64))
        return {("C+CL", f"{size.label}, {side}"): boxes for size in args.sizes for side in pose.SIDES}, [{"size": 1}]

    class Dataset(dict):
        frame_ids = ("0000/000",)

    monkeypatch.setattr(pose, "collate", lambda samples: samples)
    monkeypatch.setattr(pose, "load_batch", lambda batch, device: batch)
    args = SimpleNamespace(combos="C+CL", sizes=pose.parse_sizes("0:0,0.5:2"))
    for _ in range(2):
        [(found, notes)] = pose.results(args, runner, Dataset({(0, pose.ALL): "sample"}), [0], tmp_path)
    assert asked == [["sample"]]
    assert notes == [{"size": 1}]
    assert [boxes.scores.item() for boxes in found.found.values()] == 4 * [0.5]
