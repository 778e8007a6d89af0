"""Overlap of rotated boxes against shapely, against hand-drawn pairs, and by its invariants."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.boxes import bev_corners, transform_boxes
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.rotated_iou import bev_intersection, bev_iou, iou_3d


def random_boxes(rng: np.random.Generator, n: int, spread: float = 3.0) -> np.ndarray:
    sizes = np.exp(rng.uniform(np.log(0.05), np.log(6.0), (n, 3)))
    return np.column_stack([rng.uniform(-spread, spread, (n, 3)), sizes, rng.uniform(-7, 7, n)])


def box(x=0.0, y=0.0, z=0.0, dx=4.0, dy=2.0, dz=1.5, heading=0.0) -> np.ndarray:
    return np.array([[x, y, z, dx, dy, dz, heading]])


def turned(ahead: float, left: float) -> np.ndarray:
    """A box with a heading of 45 degrees, moved along its own axes (m). With the headings' sign lost, 6 and 4 m2 swap
    (findings/lyft_box_yaw.sh)."""
    return box(x=(ahead - left) / np.sqrt(2), y=(ahead + left) / np.sqrt(2), heading=np.pi / 4)


seeds = st.integers(0, 2**32 - 1)


def test_ten_thousand_random_pairs_agree_with_shapely():
    rng = np.random.default_rng(0)
    a, b = random_boxes(rng, 100, spread=2.0), random_boxes(rng, 100, spread=2.0)
    footprints_a, footprints_b = shapely.polygons(bev_corners(a)), shapely.polygons(bev_corners(b))
    shared = shapely.area(shapely.intersection(footprints_a[:, None], footprints_b[None, :]))
    union = shapely.area(shapely.union(footprints_a[:, None], footprints_b[None, :]))
    assert 0.2 < (shared > 0).mean() < 0.9  # the draw holds both kinds of pair
    np.testing.assert_allclose(bev_intersection(a, b), shared, rtol=0, atol=1e-9)
    np.testing.assert_allclose(bev_iou(a, b), shared / union, rtol=0, atol=1e-9)


def test_3d_iou_agrees_with_shapely_times_the_shared_height():
    rng = np.random.default_rng(1)
    a, b = random_boxes(rng, 40, spread=1.5), random_boxes(rng, 40, spread=1.5)
    for i, j in np.ndindex(40, 40):
        area = shapely.Polygon(bev_corners(a[i : i + 1])[0]).intersection(shapely.Polygon(bev_corners(b[j : j + 1])[0]))
        top = min(a[i, 2] + a[i, 5] / 2, b[j, 2] + b[j, 5] / 2)
        bottom = max(a[i, 2] - a[i, 5] / 2, b[j, 2] - b[j, 5] / 2)
        shared = area.area * max(top - bottom, 0)
        expected = shared / (a[i, 3:6].prod() + b[j, 3:6].prod() - shared)
        assert iou_3d(a[i : i + 1], b[j : j + 1])[0, 0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        pytest.param(box(), box(), 8.0, id="identical"),
        pytest.param(box(), box(heading=np.pi), 8.0, id="the same box seen from its rear"),
        pytest.param(box(), box(heading=np.pi / 2), 4.0, id="a cross shares the 2 x 2 middle"),
        pytest.param(box(), box(x=4.0), 0.0, id="touching at a side"),
        pytest.param(box(), box(x=4.0, y=2.0), 0.0, id="touching at a corner"),
        pytest.param(box(), box(x=2.0), 4.0, id="half a length apart"),
        pytest.param(turned(0.0, 0.0), turned(1.0, 0.0), 6.0, id="at 45 degrees, 1 m ahead"),
        pytest.param(turned(0.0, 0.0), turned(0.0, 1.0), 4.0, id="at 45 degrees, 1 m to the left"),
        pytest.param(box(), box(dx=1.0, dy=0.5, heading=0.3), 0.5, id="contained"),
        pytest.param(box(dx=2.0), box(dx=2.0, heading=np.pi / 4), 8 * (np.sqrt(2) - 1), id="squares make an octagon"),
        pytest.param(box(x=1e4, y=-1e4), box(x=1e4 + 3.99, y=-1e4), 0.02, id="a centimetre far from the origin"),
        pytest.param(box(dx=1e-6, dy=1e-6), box(heading=0.2), 1e-12, id="a micrometre box inside a car"),
        pytest.param(box(dx=60.0, dy=1e-3), box(heading=np.pi / 2), 2e-3, id="a hair across a car"),
    ],
)
def test_drawn_pairs(a, b, expected):
    assert bev_intersection(a, b)[0, 0] == pytest.approx(expected, rel=1e-9, abs=1e-18)
    assert bev_intersection(b, a)[0, 0] == pytest.approx(expected, rel=1e-9, abs=1e-18)


def test_boxes_above_each_other_share_a_footprint_and_no_volume():
    assert bev_iou(box(z=0.0), box(z=1.5))[0, 0] == 1.0
    assert iou_3d(box(z=0.0), box(z=1.5))[0, 0] == 0.0
    assert iou_3d(box(z=0.0), box(z=0.75))[0, 0] == pytest.approx(1 / 3)


def test_cars_in_line_share_the_same_at_any_heading():
    """Sides that lie along each other leave nothing but rounding to divide by (findings/bbox_iou_3d.sh)."""
    for heading in np.radians(np.arange(360.0)):
        for ahead in (0.5, 1.0):
            other = box(x=ahead * np.cos(heading), y=ahead * np.sin(heading), heading=heading)
            assert bev_iou(box(heading=heading), other)[0, 0] == pytest.approx((4 - ahead) / (4 + ahead), abs=1e-9)


def test_heights_are_shared_about_the_middles():
    """0 to 1.5 m and 0.5 to 1.5 m; a bus of 4 m and a car on the deck at 2.8 m."""
    assert iou_3d(box(z=0.75), box(z=1.0, dz=1.0))[0, 0] == pytest.approx(1.0 / 1.5)
    assert iou_3d(box(z=2.0, dz=4.0), box(z=3.55))[0, 0] == pytest.approx(1.2 / 4.3)


@given(seeds, st.floats(1e-3, 1e3))
def test_a_box_overlaps_itself_entirely_at_any_size(seed, scale):
    boxes = random_boxes(np.random.default_rng(seed), 5)
    boxes[:, :6] *= scale
    np.testing.assert_allclose(np.diag(bev_iou(boxes, boxes)), 1.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.diag(iou_3d(boxes, boxes)), 1.0, rtol=0, atol=1e-12)


@given(seeds)
def test_overlap_is_symmetric_and_in_range(seed):
    rng = np.random.default_rng(seed)
    a, b = random_boxes(rng, 8), random_boxes(rng, 8)
    for iou in (bev_iou, iou_3d):
        values = iou(a, b)
        np.testing.assert_allclose(values, iou(b, a).T, rtol=0, atol=1e-12)
        assert (values >= 0).all()
        assert (values <= 1).all()
    assert (iou_3d(a, b)[bev_iou(a, b) == 0] == 0).all()


@given(seeds)
def test_moving_both_boxes_together_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    a, b = random_boxes(rng, 6), random_boxes(rng, 6)
    motion = Pose.from_xyz_yaw(*rng.uniform(-40, 40, 3), yaw=rng.uniform(-np.pi, np.pi))
    moved = iou_3d(transform_boxes(motion, a), transform_boxes(motion, b))
    np.testing.assert_allclose(moved, iou_3d(a, b), rtol=0, atol=1e-10)


@given(seeds, st.sampled_from([0.0, 1e-17, 1e-16, 1e-15, 1e-12, 1e-9]), st.sampled_from([0.0, np.pi / 2, np.pi, 0.3]))
def test_nearly_identical_boxes_stay_next_to_one(seed, nudge, turn):
    """Almost parallel sides and almost coincident corners are where clipping algorithms break."""
    rng = np.random.default_rng(seed)
    a = random_boxes(rng, 1)
    a[0, 3:5] = 2.0  # square, so that quarter turns give the same footprint
    b = a.copy()
    b[0, [0, 1, 6]] += nudge * rng.choice([-1, 0, 1], 3)
    b[0, 6] += turn
    expected = 1.0 if turn != 0.3 else None
    value = bev_iou(a, b)[0, 0]
    if expected is None:
        expected = bev_iou(box(dx=2.0), box(dx=2.0, heading=0.3))[0, 0]
    assert value == pytest.approx(expected, abs=1e-7)


def test_no_boxes_give_empty_matrices():
    none = np.zeros((0, 7))
    assert iou_3d(none, box()).shape == (0, 1)
    assert bev_iou(box(), none).shape == (1, 0)


@pytest.mark.parametrize(
    ("bad", "message"),
    [(np.zeros((2, 6)), "shape"), (box(x=np.nan), "NaN"), (box(dx=0.0), "positive"), (box(dy=-1.0), "positive")],
)
def test_bad_boxes_are_refused_by_name(bad, message):
    with pytest.raises(GeometryError, match=message):
        bev_iou(box(), bad)
