"""Kinds of errors on a row of equal cars, worked out by hand: along a car of 4 m, two boxes d apart have IoU
(4 - d) / (4 + d)."""

import numpy as np

from pcdet_avp.evaluation.error_kinds import FALSE_KINDS, OBJECT_KINDS, false_kinds, object_kinds
from pcdet_avp.evaluation.inputs import Detections, GroundTruth, Region
from pcdet_avp.evaluation.matching import match, pair_up

EVERYWHERE = Region.full_range()


def car(x, y=0.0):
    return [x, y, 0.8, 4.0, 2.0, 1.6, 0.0]


def frame(frame_id, truths, found):
    boxes, scores = [box for box, _ in found], [score for _, score in found]
    truth = GroundTruth(frame_id, np.reshape(truths, (-1, 7)), np.full(len(truths), "Car"), np.zeros(len(truths), int))
    names = np.full(len(found), "Car")
    return truth, Detections(frame_id, np.reshape(np.array(boxes, float), (-1, 7)), names, np.array(scores, float))


def pairs_of(*frames):
    truths, found = zip(*frames, strict=True)
    return pair_up(truths, found, "Car")


def named(kinds, table):
    return [table[kind] if kind >= 0 else None for kind in kinds]


def test_every_kind_of_a_miss_and_of_a_false_detection():
    truths = [car(x) for x in (10.0, 20.0, 30.0, 40.0, 50.0)]
    found = [
        (car(10.5), 0.9),  # IoU 3.5 / 4.5 = 0.78
        (car(10.2), 0.8),  # a second box on it
        (car(20.2), 0.2),  # IoU 0.90, but under the score
        (car(31.0), 0.7),  # IoU 3 / 5 = 0.6
        (car(10.0, 30.0), 0.6),  # nothing there
        (car(70.0), 0.1),  # neither, as its score is too low
    ]
    pairs = pairs_of(frame("a/0", truths, found))
    seen = np.array([True, True, True, True, False])
    kinds = object_kinds(pairs, EVERYWHERE, 2, 0.7, 0.5, seen)
    assert named(kinds, OBJECT_KINDS) == [
        "found", "score too low", "misplaced", "not found", "seen by no sensor"
    ]  # fmt: skip
    false = false_kinds(pairs, EVERYWHERE, 2, 0.7, 0.5)
    assert sorted(named(false, FALSE_KINDS)) == ["misplaced", "nothing there", "second box"]


def test_a_neighbours_own_box_does_not_touch():
    truths = [car(10.0), car(13.9)]  # the boxes overlap by 0.1 m, as those of cars that are parked too close may
    pairs = pairs_of(frame("a/0", truths, [(car(10.1), 0.9)]))  # 0.2 m into the neighbour's: IoU 0.2 / 7.8 = 0.026
    kinds = object_kinds(pairs, EVERYWHERE, 2, 0.7, 0.5, np.ones(2, bool))
    assert named(kinds, OBJECT_KINDS) == ["found", "not found"]


def test_frames_are_kept_apart_and_uncounted_objects_left_out():
    region = Region.camera_fov(0.0)
    frames = [
        frame("a/0", [car(10.0)], []),
        frame("a/1", [], [(car(10.0), 0.9)]),
        frame("a/2", [car(-10.0), car(10.0)], [(car(10.0), 0.9), (car(11.0), 0.8)]),
    ]
    pairs = pairs_of(*frames)
    kinds = object_kinds(pairs, region, 2, 0.7, 0.5, np.ones(3, bool))
    assert named(kinds, OBJECT_KINDS) == ["not found", None, "found"]
    assert named(false_kinds(pairs, region, 2, 0.7, 0.5), FALSE_KINDS) == ["nothing there", "misplaced"]


def test_kinds_add_up_to_what_ap_counts():
    rng = np.random.default_rng(3)
    frames = []
    for number in range(20):
        truths = [car(x, y) for x, y in rng.uniform(0, 40, (6, 2))]
        found = [
            (car(*(np.array(t[:2]) + rng.normal(0, 0.6, 2))), score)
            for t, score in zip(truths, rng.random(6), strict=True)
        ]
        frames.append(frame(f"a/{number}", truths, found))
    pairs, seen = pairs_of(*frames), rng.random(120) < 0.5
    matches = match(pairs, EVERYWHERE, 2, 0.7)
    kinds, false = object_kinds(pairs, EVERYWHERE, 2, 0.7, 0.4, seen), false_kinds(pairs, EVERYWHERE, 2, 0.7, 0.4)
    counted = matches.scores >= 0.4
    assert (kinds == 0).sum() == (matches.outcome[counted] == 1).sum() > 0
    assert len(kinds) == matches.counted.sum() == 120
    assert len(false) == (matches.outcome[counted] == 0).sum() > 0
