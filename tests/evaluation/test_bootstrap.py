"""The paired bootstrap: real gains are seen, chance is not taken for one."""

import numpy as np
import pytest

from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation import (
    Detections,
    GroundTruth,
    Region,
    bootstrap_gain,
)
from pcdet_avp.structures.frame import Labels

REGIONS = (Region.camera_fov(apex_x_m=0.5), Region.full_range())


def test_bootstrap_sees_a_real_gain_and_none_between_equals(make_set):
    rng = np.random.default_rng(1)
    truths, poor = make_set(rng, frames=60, found=0.5)
    good = [Detections(g.frame_id, g.boxes, g.names, np.ones(len(g.names))) for g in truths]
    settings = {"name": "Car", "min_overlap": 0.5, "region": REGIONS[1], "draws": 200}
    gain = bootstrap_gain(truths, poor, good, **settings, rng=np.random.default_rng(2))
    assert 20 < gain.low < gain.points < gain.high < 80
    assert gain.scenes == 20
    same = bootstrap_gain(truths, poor, poor, **settings, rng=np.random.default_rng(2))
    assert (same.points, same.low, same.high) == (0.0, 0.0, 0.0)


def test_bootstrap_interval_covers_the_difference_of_two_equal_detectors(make_set):
    """Two detectors that each miss a random half differ by chance alone: zero lies in nearly every 95 % interval."""
    covered = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        truths, _ = make_set(rng, frames=40, per_scene=2)
        pair = [
            [Detections(g.frame_id, g.boxes, g.names, np.ones(7)).select(rng.random(7) < 0.5) for g in truths]
            for _ in range(2)
        ]
        gain = bootstrap_gain(truths, *pair, name="Car", min_overlap=0.5, region=REGIONS[1], rng=rng, draws=200)
        covered += gain.low <= 0 <= gain.high
    assert covered >= 25  # 28.5 expected; fewer than 25 has probability 1 %


def test_the_interval_is_that_of_a_coin_thrown_forty_times():
    """40 scenes of one car each, found in 20 of them: a draw's AP is 100 / 40 times a binomial number (40, 1/2), whose
    2.5 and 97.5 % points are 14 and 26 (and 15 and 25 those of a 90 % interval)."""
    box = np.array([[10.0, 0.0, 0.8, 4.5, 1.9, 1.6, 0.0]])
    truths = [GroundTruth(f"{i}/0", box, np.array(["Car"]), np.array([0])) for i in range(40)]
    found = [Detections(f"{i}/0", box, np.array(["Car"]), np.ones(1)) for i in range(40)]
    nothing = [d.select(np.zeros(1, bool)) for d in found]
    half = [f if i % 2 else n for i, (f, n) in enumerate(zip(found, nothing, strict=True))]
    settings = {"name": "Car", "min_overlap": 0.7, "region": REGIONS[1], "draws": 4000}
    gain = bootstrap_gain(truths, nothing, half, **settings, rng=np.random.default_rng(0))
    assert (gain.low, gain.points, gain.high) == pytest.approx((35.0, 50.0, 65.0))


def test_bootstrap_without_objects_says_so():
    truth = GroundTruth.from_labels("a/1", Labels.empty())
    none = Detections("a/1", np.zeros((0, 7)), np.zeros(0, str), np.zeros(0))
    rng = np.random.default_rng(0)
    with pytest.raises(EvaluationError, match="no Car"):
        bootstrap_gain([truth], [none], [none], name="Car", min_overlap=0.7, region=REGIONS[0], rng=rng)
