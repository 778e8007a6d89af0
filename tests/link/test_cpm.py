"""Values as ETSI's dictionary codes them, worked out by hand, and what is left of a box."""

import numpy as np
import pytest

from pcdet_avp.errors import PacketError
from pcdet_avp.link import cpm
from pcdet_avp.link.cpm import OBJECT, dequantise, quantise

BOX = [12.34, -5.678, 0.8, 4.52, 1.9, 1.55, np.radians(90.0)]


def coded(box, **changes):
    """One object with some of a box's numbers replaced: x, y, z, dx, dy, dz, heading."""
    names = ["x", "y", "z", "dx", "dy", "dz", "heading"]
    values = [changes.get(name, value) for name, value in zip(names, box, strict=True)]
    return quantise(np.array([values]), ["Car"], np.array([0.9]))[0]


def random_boxes(rng, n):
    sizes = rng.uniform(0.2, 25, (n, 3))
    return np.column_stack([rng.uniform(-1300, 1300, (n, 3)), sizes, rng.uniform(-9, 9, n)])


def test_a_car_by_hand():
    """12.34 m is code 1234; -5.678 m lies between -568 and -567; 1.55 m between 15 and 16."""
    one = quantise(np.array([BOX]), ["Car"], np.array([0.904]), np.array([[1.234, -0.5]]), [7], -0.0213)[0]
    assert one["position"].tolist() == [1234, -567, 80]
    assert one["size"].tolist() == [46, 19, 16]
    assert one["yaw"] == 900
    assert one["velocity"].tolist() == [124, -50]
    assert (one["id"], one["delta_time"], one["confidence"]) == (7, -21, 90)
    assert cpm.CLASSES[cpm.CLASS_NAMES[one["kind"]]] == ("vehicleSubClass", 5)


@pytest.mark.parametrize(
    ("degrees", "code"),
    [(0.0, 0), (0.04, 1), (-0.04, 0), (-0.1, 3599), (359.95, 0), (359.85, 3599), (-90, 2700), (720.1, 1)],
)
def test_angles_by_hand(degrees, code):
    assert coded(BOX, heading=np.radians(degrees))["yaw"] == code


def test_steps_are_intervals_that_the_code_closes_from_above():
    """A code n holds the values above n - 1 steps, up to n steps: 4.5 m is 45, a hair more is 46."""
    assert coded(BOX, dx=4.5)["size"][0] == 45
    assert coded(BOX, dx=4.501)["size"][0] == 46
    assert coded(BOX, x=0.07)["position"][0] == 7  # 0.07 / 0.01 is a hair above 7
    assert coded(BOX, dz=float(np.float32(1.6)))["size"][2] == 16  # and so is 1.6 in float32
    assert coded(BOX, x=-0.07)["position"][0] == -7


def test_nothing_is_off_by_more_than_half_a_step_and_nothing_on_average():
    rng = np.random.default_rng(1)
    boxes, scores = random_boxes(rng, 200), rng.random(200)
    speeds, times = rng.uniform(-160, 160, (200, 2)), rng.uniform(-2, 2, 200)
    names = rng.choice(cpm.CLASS_NAMES, 200).tolist()
    got = dequantise(quantise(boxes, names, scores, speeds, delta_times_s=times))
    assert got.names == names
    assert got.placed.all()
    turn = (got.boxes[:, 6] - boxes[:, 6] + np.pi) % (2 * np.pi) - np.pi
    errors = [
        (got.boxes[:, :3] - boxes[:, :3], 0.01),
        (got.boxes[:, 3:6] - boxes[:, 3:6], 0.1),
        (turn, np.radians(0.1)),
        (got.velocities - speeds, 0.01),
        (got.delta_times_s - times, 0.001),
    ]
    for error, step in errors:
        assert np.abs(error).max() <= step * (0.5 + cpm.SLACK)
        assert abs(error.mean()) < 0.1 * step  # 200 uniform errors: standard deviation of their mean 0.02 steps
    assert np.abs(got.scores - scores)[scores > 0.005].max() <= 0.005 + 1e-9


def test_what_was_received_is_sent_on_unchanged():
    rng = np.random.default_rng(2)
    speeds = rng.uniform(-9, 9, (100, 2))
    speeds[:2] = [200, -200], [np.nan, 0]  # out of range stays out of range, and does not become unknown
    sent = quantise(random_boxes(rng, 100), ["Car"] * 100, rng.uniform(0.01, 1, 100), speeds)
    got = dequantise(sent)
    np.testing.assert_array_equal(quantise(*got[:3], got.velocities, got.ids, got.delta_times_s), sent)


@pytest.mark.parametrize(
    ("change", "field", "at", "code", "value"),
    [
        ({"x": 1310.7}, "position", 0, 131_070, 1310.695),
        ({"x": 1310.701}, "position", 0, 131_071, np.inf),
        ({"x": 1e9}, "position", 0, 131_071, np.inf),
        ({"y": -1310.71}, "position", 1, -131_071, -1310.715),
        ({"y": -1310.72}, "position", 1, -131_072, -np.inf),
        ({"dz": 25.4}, "size", 2, 254, 25.35),
        ({"dz": 25.41}, "size", 2, 255, np.inf),
        ({"dy": 0.01}, "size", 1, 1, 0.05),
    ],
)
def test_beyond_the_range_the_dictionarys_own_code_is_sent(change, field, at, code, value):
    one = coded(BOX, **change)
    assert one[field][at] == code
    got = dequantise(one[None])
    column = at + (3 if field == "size" else 0)
    assert got.boxes[0, column] == pytest.approx(value)
    assert got.placed[0] == np.isfinite(value)


def test_a_speed_beyond_the_range_or_unknown():
    speeds = np.array([[163.82, -163.83], [np.nan, 0.0]])
    objects = quantise(np.array([BOX, BOX]), ["Car", "Car"], np.array([0.5, 0.5]), speeds)
    assert objects["velocity"].tolist() == [[16382, -16383], [16383, 0]]
    got = dequantise(objects).velocities
    assert got[0].tolist() == [np.inf, -np.inf]
    assert np.isnan(got[1, 0])
    assert (quantise(np.array([BOX]), ["Car"], np.array([0.5]))["velocity"] == 16383).all()


def test_codes_for_unavailable_read_back_as_nan():
    one = np.zeros(1, OBJECT)
    one["size"], one["yaw"], one["confidence"], one["velocity"] = [256, 20, 20], 3601, 101, 16383
    got = dequantise(one)
    assert np.isnan(got.boxes[0, [3, 6]]).all()
    assert np.isnan(got.scores[0])
    assert np.isnan(got.velocities).all()
    assert not got.placed[0]


@pytest.mark.parametrize(("score", "percent"), [(0.0, 1), (0.004, 1), (0.016, 2), (0.5, 50), (1.0, 100)])
def test_confidence_in_percent_is_never_none(score, percent):
    assert quantise(np.array([BOX]), ["Pedestrian"], np.array([score]))["confidence"] == percent


def test_an_empty_message_has_no_objects():
    got = dequantise(quantise(np.empty((0, 7)), [], np.empty(0)))
    assert got.boxes.shape == (0, 7)
    assert got.names == []


@pytest.mark.parametrize(
    ("box", "name", "score", "message"),
    [
        ([np.nan, *BOX[1:]], "Car", 0.5, "object 0: expected finite numbers"),
        ([*BOX[:6], np.inf], "Car", 0.5, "object 0: expected finite numbers"),
        ([*BOX[:3], 0.0, *BOX[4:]], "Car", 0.5, "sizes above 0 m"),
        (BOX, "Tram", 0.5, "expected a class of Car, Pedestrian, Cyclist, found Tram"),
        (BOX, "Car", 1.2, "score from 0 to 1, found 1.2"),
        (BOX, "Car", np.nan, "score from 0 to 1"),
        (BOX[:6], "Car", 0.5, r"expected boxes \(n, 7\)"),
    ],
)
def test_what_cannot_be_coded_is_refused(box, name, score, message):
    with pytest.raises(PacketError, match=message):
        quantise(np.array([box]), [name], np.array([score]))


def test_too_many_objects_and_foreign_ids_and_times_are_refused():
    many = np.tile(BOX, (256, 1))
    with pytest.raises(PacketError, match="at most 255 objects in a message, found 256"):
        quantise(many, ["Car"] * 256, np.full(256, 0.5))
    for ids in ([70_000], [-1], [0.5], [1, 2]):
        with pytest.raises(PacketError, match="ids"):
            quantise(np.array([BOX]), ["Car"], np.array([0.5]), ids=np.array(ids))
    with pytest.raises(PacketError, match="velocities of shape"):
        quantise(np.array([BOX]), ["Car"], np.array([0.5]), np.zeros((1, 3)))
    for times in (np.nan, [np.nan], [0.1, 0.2], [[0.1]]):
        with pytest.raises(PacketError, match="expected a time of measurement, or 1, in seconds"):
            quantise(np.array([BOX]), ["Car"], np.array([0.5]), delta_times_s=times)


@pytest.mark.parametrize(
    ("constant", "wrong"),
    [("POSITION_STEP_M", 1.0), ("SIZE_STEP_M", 0.01), ("YAW_STEP_DEG", np.degrees(0.1)), ("VELOCITY_STEP_MPS", 0.1)],
)
def test_the_hand_made_codes_notice_a_wrong_unit(monkeypatch, constant, wrong):
    """Metres instead of centimetres, centimetres instead of decimetres, tenths of a radian instead of a degree."""
    test_a_car_by_hand()
    monkeypatch.setattr(cpm, constant, wrong)
    with pytest.raises(AssertionError):
        test_a_car_by_hand()


def test_the_round_trip_notices_degrees_taken_for_radians(monkeypatch):
    monkeypatch.setattr(cpm.np, "degrees", lambda angle: angle)
    with pytest.raises(AssertionError):
        test_nothing_is_off_by_more_than_half_a_step_and_nothing_on_average()
