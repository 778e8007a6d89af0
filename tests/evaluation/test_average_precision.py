"""AP against hand-drawn cases and against a slow reference that follows the prose of the metric word by word."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from pcdet_avp.evaluation.average_precision import (
    COLUMNS,
    ap_table,
    average_precision,
    best_f1_score,
    recall_by_distance,
    score_curve,
    thresholds,
)
from pcdet_avp.evaluation.inputs import Detections, GroundTruth, Region
from pcdet_avp.evaluation.matching import match, pair_up
from pcdet_avp.structures.boxes import bev_corners
from pcdet_avp.structures.rotated_iou import bev_iou

EVERYWHERE = Region.full_range()
EASY, HARD, INVISIBLE = 0, 1, 2


def cars(*xy, size=(4.0, 2.0, 1.5)) -> np.ndarray:
    return np.array([[x, y, 0.75, *size, 0.0] for x, y in xy], dtype=float).reshape(-1, 7)


def frame(truth=(), difficulty=None, found=(), scores=(), frame_id="s/0"):
    """One frame of cars at truth = [(x, y), ...] with detections of the true size at found = [(x, y), ...]."""
    difficulty = np.array([EASY] * len(truth) if difficulty is None else difficulty, dtype=int)
    return (
        GroundTruth(frame_id, cars(*truth), np.array(["Car"] * len(truth), dtype=str), difficulty),
        Detections(frame_id, cars(*found), np.array(["Car"] * len(found), dtype=str), np.array(scores, dtype=float)),
    )


def ap(frames, column="overall", region=EVERYWHERE, min_overlap=0.7, overlap=None) -> float:
    kind = {} if overlap is None else {"overlap": overlap}
    pairs = pair_up([g for g, _ in frames], [d for _, d in frames], "Car", **kind)
    return average_precision(score_curve(match(pairs, region, COLUMNS.index(column), min_overlap)))


FAR = (100.0, 0.0)


class TestDrawnCases:
    def test_all_found_and_nothing_else_is_100(self):
        assert ap([frame([(10, 0), (20, 0)], found=[(10, 0), (20, 0)], scores=[0.9, 0.8])]) == 100.0

    def test_hand_number_over_40_recall_positions(self):
        """True, false, true over two objects: precision 1 to recall 1/2 (20 positions), then 2/3 (20 positions)."""
        frames = [frame([(10, 0), (20, 0)], found=[(10, 0), FAR, (20, 0)], scores=[0.9, 0.8, 0.7])]
        assert ap(frames) == pytest.approx(100 * (20 * 1 + 20 * 2 / 3) / 40)

    def test_recall_of_one_third_reaches_13_positions(self):
        """1/3 = 13.33 / 40: positions 1/40 to 13/40 have precision 1, the others 0."""
        assert ap([frame([(10, 0), (20, 0), (30, 0)], found=[(10, 0)], scores=[0.5])]) == 100 * 13 / 40

    def test_recall_of_exactly_a_position_counts_it(self):
        """39 of 40 objects: recall 0.975 is the 39th position itself, whatever 39 / 40 is in floating point."""
        truth = [(10.0 * i, 0) for i in range(40)]
        assert ap([frame(truth, found=truth[:39], scores=[0.5] * 39)]) == 97.5

    def test_a_false_detection_below_all_true_ones_costs_nothing(self):
        assert ap([frame([(10, 0)], found=[(10, 0), FAR], scores=[0.9, 0.1])]) == 100.0

    def test_an_overlap_that_equals_the_threshold_is_no_hit(self):
        """Half of a car's length off: the shared third of the union is 6 / 18, the very number 1 / 3."""
        frames = [frame([(10, 0)], found=[(12, 0)], scores=[0.5])]
        assert ap(frames, min_overlap=1 / 3) == 0.0
        assert ap(frames, min_overlap=np.nextafter(1 / 3, 0)) == 100.0

    def test_tied_scores_enter_together(self):
        """One true and one false at the same score: no threshold separates them, so precision is 1/2."""
        for found in ([(10, 0), FAR], [FAR, (10, 0)]):
            assert ap([frame([(10, 0)], found=found, scores=[0.5, 0.5])]) == 50.0

    def test_among_tied_scores_the_better_overlap_chooses_first(self):
        """A detection at 10.4 fits both objects (10 better), one at 9.9 only the first: both are found in any order."""
        for found in ([(10.4, 0), (9.9, 0)], [(9.9, 0), (10.4, 0)]):
            assert ap([frame([(10, 0), (11.0, 0)], found=found, scores=[0.5, 0.5])]) == 100.0

    def test_second_hit_is_false(self):
        frames = [frame([(10, 0), (20, 0)], found=[(10, 0), (10.1, 0), (20, 0)], scores=[0.9, 0.8, 0.7])]
        assert ap(frames) == pytest.approx(100 * (20 * 1 + 20 * 2 / 3) / 40)

    def test_all_false_is_zero(self):
        assert ap([frame([(10, 0)], found=[FAR, (60, 0)], scores=[0.9, 0.8])]) == 0.0

    def test_no_detections_is_zero_and_no_objects_is_undefined(self):
        assert ap([frame([(10, 0)])]) == 0.0
        assert np.isnan(ap([frame(found=[FAR], scores=[0.9])]))
        assert np.isnan(ap([frame()]))
        assert np.isnan(ap([]))

    def test_objects_of_a_frame_without_detections_are_missed(self):
        assert ap([frame([(10, 0)], found=[(10, 0)], scores=[0.9]), frame([(10, 0)])]) == 50.0

    def test_detections_of_a_frame_without_objects_are_false(self):
        """The false one scores highest: precision 1/2 everywhere."""
        assert ap([frame([(10, 0)], found=[(10, 0)], scores=[0.8]), frame(found=[(10, 0)], scores=[0.9])]) == 50.0

    def test_detections_compete_over_the_whole_set_not_per_frame(self):
        """Two frames, each right about one of two claims; sorted together: true, false, false, true. OpenCOOD hangs
        frame behind frame instead (findings/opencoodx_frame_order.sh)."""
        one = frame([(10, 0)], found=[(10, 0), FAR], scores=[0.9, 0.8])
        two = frame([(10, 0)], found=[FAR, (10, 0)], scores=[0.7, 0.6])
        assert ap([one, two]) == pytest.approx(100 * (20 * 1 + 20 * 2 / 4) / 40)

    def test_overlap_must_exceed_the_threshold(self):
        """Moved by a third of its length a box shares 1/2 of the union; by more, less."""
        shifted = frame([(10, 0)], found=[(10 + 4 / 3, 0)], scores=[0.9])
        assert ap([shifted], min_overlap=0.49) == 100.0
        assert ap([shifted], min_overlap=0.51) == 0.0

    def test_bev_overlap_ignores_height(self):
        truth, found = frame([(10, 0)], found=[(10, 0)], scores=[0.9])
        found.boxes[:, 2] += 5.0
        assert ap([(truth, found)]) == 0.0
        assert ap([(truth, found)], overlap=bev_iou) == 100.0


class TestDifficulties:
    def test_columns_are_cumulative(self):
        """Only the easy one of three is found: 1/1, then 1/2, then 1/3 of the objects."""
        frames = [frame([(10, 0), (20, 0), (30, 0)], [EASY, HARD, INVISIBLE], found=[(10, 0)], scores=[0.9])]
        assert [ap(frames, column) for column in COLUMNS] == [100.0, 50.0, 100 * 13 / 40]

    def test_finding_an_ignored_object_neither_helps_nor_hurts(self):
        with_it = frame([(10, 0), (20, 0)], [EASY, INVISIBLE], found=[(20, 0), (10, 0)], scores=[0.9, 0.8])
        assert ap([with_it], "easy") == 100.0

    def test_missing_an_ignored_object_does_not_hurt(self):
        assert ap([frame([(10, 0), (20, 0)], [EASY, HARD], found=[(10, 0)], scores=[0.9])], "easy") == 100.0

    def test_second_hit_on_an_ignored_object_is_false(self):
        frames = [frame([(10, 0), (20, 0)], [EASY, HARD], found=[(20, 0), (20.1, 0), (10, 0)], scores=[0.9, 0.8, 0.7])]
        assert ap(frames, "easy") == 50.0

    def test_a_counted_object_is_preferred_to_a_better_overlapping_ignored_one(self):
        """At threshold 0.01 the detection lies nearer to the ignored object and still takes the counted one."""
        frames = [frame([(10, 0), (12, 0)], [EASY, HARD], found=[(11.5, 0)], scores=[0.9])]
        assert ap(frames, "easy", min_overlap=0.01) == 100.0


class TestRegions:
    fov = Region.camera_fov(apex_x_m=2.0)

    def test_the_wedge_starts_at_the_camera(self):
        inside = self.fov.contains(np.array([[10.0, 7.9], [10.0, 8.1], [2.5, 0.0], [1.9, 0.0], [-5.0, 0.0]]))
        assert inside.tolist() == [True, False, True, False, False]

    def test_objects_outside_are_ignored_and_may_be_found(self):
        frames = [frame([(10, 0), (10, 20)], found=[(10, 20), (10, 0)], scores=[0.9, 0.8])]
        assert ap(frames, region=self.fov) == 100.0
        assert ap([frame([(10, 0), (10, 20)], found=[(10, 0)], scores=[0.8])], region=self.fov) == 100.0

    def test_false_detections_outside_are_dropped_and_inside_are_not(self):
        assert ap([frame([(10, 0)], found=[(10, 20), (10, 0)], scores=[0.9, 0.8])], region=self.fov) == 100.0
        assert ap([frame([(10, 0)], found=[(20, 0), (10, 0)], scores=[0.9, 0.8])], region=self.fov) == 50.0

    def test_a_detection_outside_may_take_an_object_just_inside(self):
        frames = [frame([(10, 7.9)], found=[(10, 8.1)], scores=[0.9])]
        assert ap(frames, region=self.fov) == 100.0


def naive_ap(frames, column, region, min_overlap) -> float:
    """The seven steps of the module's docstring, once per score threshold, with shapely's overlaps."""
    hardest, levels = COLUMNS.index(column), sorted({s for _, d in frames for s in d.scores})
    outcomes = [naive_outcome(frames, level, hardest, region, min_overlap) for level in levels]
    wanted = sum(naive_counts(g, i, hardest, region) for g, _ in frames for i in range(len(g.boxes)))
    total = 0.0
    for k in range(1, 41):
        total += max((t / (t + f) for t, f in outcomes if t and t * 40 >= k * wanted), default=0.0)
    return 100 * total / 40 if wanted else float("nan")


def naive_counts(truth, i, hardest, region) -> bool:
    return bool(region.contains(truth.boxes[i : i + 1])[0]) and truth.difficulty[i] <= hardest


def naive_outcome(frames, level, hardest, region, min_overlap) -> tuple[int, int]:
    """True and false detections among those that score ``level`` or more."""
    true = false = 0
    for truth, found in frames:
        best = [max((naive_iou(b, t) for t in truth.boxes), default=0.0) for b in found.boxes]
        order = sorted(range(len(best)), key=lambda i: (-found.scores[i], -best[i]))
        free = set(range(len(truth.boxes)))
        for i in (i for i in order if found.scores[i] >= level):
            hits = [t for t in free if naive_iou(found.boxes[i], truth.boxes[t]) > min_overlap]
            ranked = sorted(
                hits,
                key=lambda t, i=i: (
                    not naive_counts(truth, t, hardest, region),
                    -naive_iou(found.boxes[i], truth.boxes[t]),
                ),
            )
            if ranked:
                free.remove(ranked[0])
                true += naive_counts(truth, ranked[0], hardest, region)
            else:
                false += bool(region.contains(found.boxes[i : i + 1])[0])
    return true, false


def naive_iou(a, b) -> float:
    p, q = (shapely.Polygon(bev_corners(x[None])[0]) for x in (a, b))
    height = max(0.0, min(a[2] + a[5] / 2, b[2] + b[5] / 2) - max(a[2] - a[5] / 2, b[2] - b[5] / 2))
    shared = p.intersection(q).area * height
    return shared / (a[3:6].prod() + b[3:6].prod() - shared)


def random_frames(rng: np.random.Generator):
    """A few crowded frames: overlapping objects, good and bad detections, many ties, some empty frames."""
    return [random_frame(rng, i) for i in range(rng.integers(1, 5))]


def random_frame(rng, i):
    n, false = rng.integers(0, 5), rng.integers(0, 3)
    truth = np.column_stack([rng.uniform(5, 25, n), rng.uniform(-15, 15, n), np.full(n, 0.75)])
    truth = np.column_stack([truth, np.tile([4.0, 2.0, 1.5], (n, 1)), rng.uniform(-3, 3, n)])
    near = np.concatenate([truth[rng.random(n) < 0.8], truth[rng.random(n) < 0.4]])
    near = near + rng.normal(0, 0.3, near.shape) * [1, 1, 0.3, 0.1, 0.1, 0.1, 0.3]
    far = np.column_stack([rng.uniform(5, 25, false), rng.uniform(-15, 15, false), np.full(false, 1.0)])
    far = np.column_stack([far, np.tile([4.0, 2.0, 1.5, 0.0], (false, 1))])
    boxes = rng.permutation(np.concatenate([near, far]))
    scores = rng.choice([0.2, 0.4, 0.6, rng.random()], len(boxes))
    return (
        GroundTruth(f"s/{i}", truth, np.array(["Car"] * n, dtype=str), rng.integers(0, 3, n)),
        Detections(f"s/{i}", boxes, np.array(["Car"] * len(boxes), dtype=str), scores),
    )


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.5, 0.7]), st.booleans())
def test_agrees_with_the_naive_reference(seed, min_overlap, wedge):
    frames = random_frames(np.random.default_rng(seed))
    region = Region.camera_fov(apex_x_m=2.0) if wedge else EVERYWHERE
    for column in COLUMNS:
        expected = naive_ap(frames, column, region, min_overlap)
        assert ap(frames, column, region, min_overlap) == pytest.approx(expected, abs=1e-9, nan_ok=True)


@given(st.integers(0, 2**32 - 1))
def test_the_order_of_frames_and_detections_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    frames = random_frames(rng)
    shuffled = [(g, d.select(rng.permutation(len(d.boxes)))) for g, d in frames]
    assert ap(shuffled[::-1], min_overlap=0.5) == pytest.approx(ap(frames, min_overlap=0.5), abs=1e-9, nan_ok=True)


def test_frame_weights_repeat_frames():
    frames = random_frames(np.random.default_rng(3))
    weights = np.array([3, 1, 0, 2])[: len(frames)]
    repeated = [f for f, w in zip(frames, weights, strict=True) for _ in range(w)]
    pairs = pair_up([g for g, _ in frames], [d for _, d in frames], "Car")
    weighted = average_precision(score_curve(match(pairs, EVERYWHERE, 2, 0.5), weights))
    assert weighted == pytest.approx(ap(repeated, min_overlap=0.5))


def test_ap_table_holds_each_column_and_threshold_under_its_label():
    frames = [frame([(10, 0), (20, 0)], [EASY, HARD], found=[(10, 0), (21.5, 0)], scores=[0.9, 0.8])]
    pairs = pair_up([g for g, _ in frames], [d for _, d in frames], "Car")
    assert ap_table(pairs, EVERYWHERE, thresholds("Car")) == {
        "easy": {"0.7": 100.0, "0.5": 100.0, "0.01": 100.0},
        "hard": {"0.7": 50.0, "0.5": 50.0, "0.01": 100.0},
        "overall": {"0.7": 50.0, "0.5": 50.0, "0.01": 100.0},
    }


def test_best_f1_keeps_the_true_and_drops_the_false():
    frames = [frame([(10, 0), (20, 0)], found=[(10, 0), (20, 0), FAR], scores=[0.9, 0.6, 0.4])]
    pairs = pair_up([g for g, _ in frames], [d for _, d in frames], "Car")
    assert best_f1_score(score_curve(match(pairs, EVERYWHERE, 2, 0.7))) == 0.6


def test_recall_by_distance_counts_what_stands_in_each_ring():
    frames = [frame([(5, 0), (15, 0), (0, 18)], found=[(5, 0), (0, 18)], scores=[0.9, 0.2])]
    pairs = pair_up([g for g, _ in frames], [d for _, d in frames], "Car")
    edges = np.array([0, 10, 20, 30])
    np.testing.assert_array_equal(recall_by_distance(pairs, EVERYWHERE, 0.7, edges), [1.0, 0.5, np.nan])
    np.testing.assert_array_equal(recall_by_distance(pairs, EVERYWHERE, 0.7, edges, min_score=0.5), [1.0, 0.0, np.nan])
