"""Registration against errors that were put in: a garage of segments, drawn on two grids by hand."""

import numpy as np
import pytest
from garage_of_lines import GRID, POOLING, TRUTH, drawn, seen, walls

from pcdet_avp.errors import ConfigError
from pcdet_avp.registration import Registrar, RegistrationSettings, SteadyCorrection
from pcdet_avp.registration.registrar import NONE, Correction, Received
from pcdet_avp.registration.search import COARSE_DEG, COARSE_M, FEW, MANY, lookups
from pcdet_avp.structures.pose import Pose

ON = RegistrationSettings(enabled=True)
# The vehicle's error, in its own frame: metres, degrees.
ERRORS = [(0.0, 0.0, 0.0), (0.5, -0.3, 2.0), (-0.8, 0.6, -3.0), (1.3, 1.0, 7.0), (0.2, 0.3, -1.5)]


@pytest.fixture(scope="module")
def own():
    bev_map = drawn(walls(), GRID.cell_m, 3, 0.3)
    return {"ego_lidar": (bev_map, np.ones(bev_map.shape[1:], bool))}


@pytest.fixture(scope="module")
def values():
    return drawn(seen(walls(), TRUTH.inverse()), POOLING * GRID.cell_m, 3, 0.05)


def error_of(x, y, degrees):
    return Pose.from_xyz_yaw(x, y, yaw=np.radians(degrees))


def left(correction, error):
    """What is left of an error: metres at 20 m ahead of the vehicle, where it matters, and degrees."""
    rest = correction.true_from_believed @ error
    return np.linalg.norm(rest.apply(np.array([20.0, 0, 0])) - [20.0, 0, 0]), abs(np.degrees(rest.yaw))


@pytest.mark.parametrize("error", ERRORS)
def test_a_known_error_is_found(own, values, error):
    error = error_of(*error)
    correction = Registrar(GRID, ON)(own, [Received(values, error @ TRUTH)])
    metres, degrees = left(correction, error)
    assert metres < 0.2
    assert degrees < 0.5


# Masts beside the vehicle that look across, behind it that look the same way, and ahead that look back: x, y, yaw.
@pytest.mark.parametrize("place", [(22.0, -24.0, 90.0), (-3.0, 1.0, 5.0), (40.0, 2.0, 180.0)])
def test_how_the_mast_is_turned_does_not_matter(own, place):
    """Elsewhere a guess that is turned by a right angle leads astray (findings/point_cloud_registration_turned.sh)."""
    truth, error = error_of(*place), error_of(0.5, -0.3, 2.0)
    values = drawn(seen(walls(), truth.inverse()), POOLING * GRID.cell_m, 3, 0.05)
    correction = Registrar(GRID, ON)(own, [Received(values, error @ truth)])
    metres, degrees = left(correction, error)
    assert metres < 0.3  # 0.64 before; from across the walls run unlike the edges that are asked for
    assert degrees < 0.5


def test_a_small_error_is_left_or_made_smaller(own, values):
    error = error_of(0.2, 0.1, -0.5)
    correction = Registrar(GRID, ON)(own, [Received(values, error @ TRUTH)])
    metres, degrees = left(correction, error)
    assert metres < 0.22
    assert degrees <= 0.5 + 1e-9


@pytest.mark.parametrize("error", ERRORS[1:4])
def test_sides_that_face_only_one_of_both_do_not_mislead(own, error):
    """Pillars, 0.8 m thick: the vehicle sees their near sides (x), the mast the far ones. Matching those would shift
    everything by the thickness."""
    pillars = np.arange(4.0, 40.0, 3.0)
    sides = np.array([(x, y) for x in pillars for y in np.arange(5.0, 6.2, 0.05)])
    bev_map = drawn(np.concatenate([walls(), sides]), GRID.cell_m, 3, 0.3)
    far = drawn(seen(np.concatenate([walls(), sides + [0.8, 0]]), TRUTH.inverse()), POOLING * GRID.cell_m, 3, 0.05)
    error = error_of(*error)
    correction = Registrar(GRID, ON)({"ego_lidar": (bev_map, own["ego_lidar"][1])}, [Received(far, error @ TRUTH)])
    metres, degrees = left(correction, error)
    assert metres < 0.25
    assert degrees < 0.5


def test_without_an_error_nothing_is_corrected(own, values):
    correction = Registrar(GRID, ON)(own, [Received(values, TRUTH)])
    assert not correction.accepted
    np.testing.assert_array_equal(correction.true_from_believed.matrix, np.eye(4))
    assert 0 <= correction.gain < ON.min_gain


def test_maps_without_overlap_correct_nothing(own, values):
    """Elsewhere that is the smallest of all errors (findings/small_gicp_no_overlap.sh)."""
    assert Registrar(GRID, ON)(own, [Received(values, Pose.from_xyz_yaw(-60.0, 0.0, yaw=np.pi))]) is NONE


def test_nothing_on_one_side_corrects_nothing(own, values):
    registrar = Registrar(GRID, ON)
    assert registrar({}, [Received(values, TRUTH)]) is NONE
    assert registrar(own, []) is NONE
    assert registrar(own, [Received(np.zeros_like(values), TRUTH)]) is NONE
    blank = {"ego_lidar": (np.zeros_like(own["ego_lidar"][0]), own["ego_lidar"][1])}
    assert not registrar(blank, [Received(values, error_of(0.5, 0, 2) @ TRUTH)]).accepted
    unseen = {"ego_lidar": (own["ego_lidar"][0], np.zeros_like(own["ego_lidar"][1]))}
    assert not registrar(unseen, [Received(values, error_of(0.5, 0, 2) @ TRUTH)]).accepted


@pytest.mark.parametrize("side", ["own", "received"])
def test_broken_numbers_correct_nothing(own, values, side):
    """They are told of where boxes are made of them."""
    bev_map, valid = own["ego_lidar"]
    maps = {"own": bev_map.copy(), "received": values.copy()}
    maps[side][:, 20:60] = np.nan
    received = [Received(maps["received"], error_of(0.5, 0, 2) @ TRUTH)]
    assert not Registrar(GRID, ON)({"ego_lidar": (maps["own"], valid)}, received).accepted


def test_the_gate_refuses_what_gains_too_little(own, values):
    strict = RegistrationSettings(enabled=True, min_gain=1.0)
    received, free = [Received(values, error_of(0.5, -0.3, 2.0) @ TRUTH)], RegistrationSettings(enabled=True)
    refused, taken = Registrar(GRID, strict)(own, received), Registrar(GRID, free)(own, received)
    assert taken.accepted
    assert not refused.accepted
    assert refused.gain == taken.gain > ON.min_gain
    np.testing.assert_array_equal(refused.true_from_believed.matrix, np.eye(4))


def test_the_scale_of_the_features_changes_nothing(own, values):
    bev_map, valid = own["ego_lidar"]
    error = error_of(0.5, -0.3, 2.0)
    first = Registrar(GRID, ON)(own, [Received(values, error @ TRUTH)])
    second = Registrar(GRID, ON)({"ego_lidar": (8 * bev_map, valid)}, [Received(0.5 * values, error @ TRUTH)])
    np.testing.assert_array_equal(first.true_from_believed.matrix, second.true_from_believed.matrix)


def test_two_units_agree_on_one_error(own, values):
    """The vehicle errs about itself, so every unit's map is off by the same motion; each has half of the scene."""
    half, other = values.copy(), values.copy()
    half[:, ::2], other[:, 1::2] = 0, 0
    error = error_of(0.5, -0.3, 2.0)
    correction = Registrar(GRID, ON)(own, [Received(half, error @ TRUTH), Received(other, error @ TRUTH)])
    metres, degrees = left(correction, error)
    assert metres < 0.25
    assert degrees < 0.5


def test_the_cost_is_bounded_whatever_the_maps_hold():
    """Counted by hand for the default window: 9 x 9 x 21 motions of 250 points in their nearest cells, then 27 motions
    of 4 neighbours around 3 hills, twice with few points and twice around the best with many."""
    steps = np.array([COARSE_M, COARSE_M, np.radians(COARSE_DEG)])
    by_hand = 9 * 9 * 21 * 250 + 27 * 4 * (3 * FEW + 3 * FEW + MANY + MANY) + 8 * MANY
    assert lookups(ON.stds, steps) == by_hand < 1_000_000


def test_at_most_so_many_points_are_used(own):
    everywhere = np.random.default_rng(0).random((2, GRID.height // POOLING, GRID.width // POOLING)).astype(np.float32)
    assert len(Registrar(GRID, ON).points([Received(everywhere, TRUTH)], np.eye(2, dtype=np.float32)).x) == MANY


def moved(x, y, degrees):
    return Correction(error_of(x, y, degrees), True)


def test_over_time_one_wrong_correction_does_no_harm():
    steady = SteadyCorrection(frames=3)
    steady(moved(0.5, 0.1, 2.0))
    steady(moved(0.6, 0.2, 2.2))
    pose = steady(moved(-2.0, 3.0, -15.0))
    assert (pose.translation[0], pose.translation[1]) == (0.5, 0.2)
    assert np.degrees(pose.yaw) == pytest.approx(2.0)


def test_over_time_refused_corrections_leave_the_last_ones_standing():
    steady = SteadyCorrection(frames=2)
    np.testing.assert_array_equal(steady(NONE).matrix, np.eye(4))
    steady(moved(0.5, 0.0, 0.0))
    assert steady(NONE).translation[0] == 0.5
    steady(moved(0.7, 0.0, 0.0))
    assert steady(moved(0.7, 0.0, 0.0)).translation[0] == 0.7  # the first one has left


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("POSITION_STD_M", 0.0),
        ("POSITION_STD_M", 5.0),
        ("YAW_STD_DEG", float("nan")),
        ("MIN_GAIN", 1.5),
        ("FRAMES", 0),
        ("FRAMES", 2.5),
        ("ENABLED", "yes"),
        ("WINDOW", 3),
    ],
)
def test_wrong_settings_name_key_and_value(key, value):
    with pytest.raises(ConfigError, match=rf"REGISTRATION.*{key}.*{value}" if key != "WINDOW" else "WINDOW"):
        RegistrationSettings.from_config({"REGISTRATION": {key: value}})


def test_a_configuration_without_the_section_registers_nothing():
    assert not RegistrationSettings.from_config({}).enabled
    assert RegistrationSettings.from_config({"REGISTRATION": {"ENABLED": True, "FRAMES": 3}}).frames == 3
