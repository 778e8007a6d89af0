"""The ego's dynamics against an ODE solver, against closed forms, and by what a car cannot do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.dynamics import LongitudinalModel, LongitudinalState, drive

speeds = st.floats(0, 12)
lags = st.sampled_from([0.1, 0.2, 0.3, 0.5])


def solved(state, target, duration, model):
    """The same motion by an adaptive solver: limits on jerk and acceleration, until the car stands."""

    low, high, steepest = -model.max_deceleration_mps2, model.max_acceleration_mps2, model.max_jerk_mps3

    def derivative(_, y):
        _, v, a = y
        jerk = min(max((model.gain_per_s * (target - v) - a) / model.lag_s, -steepest), steepest)
        held = (a <= low and jerk < 0) or (a >= high and jerk > 0)
        return v, min(max(a, low), high), 0.0 if held else jerk

    def stands(_, y):
        return y[1]

    stands.terminal, stands.direction = True, -1
    y0 = [state.position, state.speed, state.acceleration]
    return solve_ivp(derivative, (0, duration), y0, events=stands, max_step=0.01, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("lag", [0.1, 0.2, 0.3, 0.5])
@pytest.mark.parametrize(("speed", "target"), [(10.0, 0.0), (3.0, 0.0), (0.0, 8.0), (6.0, 3.0), (12.0, 11.0)])
def test_agrees_with_an_adaptive_solver(speed, target, lag):
    model, start = LongitudinalModel(lag_s=lag), LongitudinalState(0.0, speed)
    reference = solved(start, target, 3.0, model)
    until = reference.t[-1]
    ours = drive(start, target, 3.0, model)
    at_end = np.array([np.interp(until, ours.times, v) for v in (ours.positions, ours.speeds)])
    assert at_end == pytest.approx(reference.y[:2, -1], abs=2e-3)
    inner = np.interp(reference.t[::50], ours.times, ours.positions)
    assert inner == pytest.approx(reference.y[0, ::50], abs=1e-3)


def test_small_changes_of_speed_follow_the_closed_form():
    """Within the limits the loop is v'' tau + v' + k v = k v*; with tau 0.1 and k 2 the roots are real."""
    ours = drive(LongitudinalState(0.0, 5.0), 5.2, 2.0)
    slow, fast = np.roots([0.1, 1.0, 2.0])[::-1]
    gap = -0.2 * (fast * np.exp(slow * ours.times) - slow * np.exp(fast * ours.times)) / (fast - slow)
    np.testing.assert_allclose(ours.speeds, 5.2 + gap, atol=1e-6)


def test_emergency_stop_from_10_mps_by_hand():
    """Jerk 20 down to -10.5 takes 0.525 s; then constant deceleration until a* = -2 v is weaker, at v = 5.25 m/s."""
    ours = drive(LongitudinalState(0.0, 10.0), 0.0, 6.0)
    i = np.searchsorted(ours.times, 0.525)
    assert ours.accelerations[i] == pytest.approx(-10.5, abs=0.05)
    assert ours.speeds[i] == pytest.approx(10 - 20 * 0.525**2 / 2, abs=0.02)
    assert ours.positions[i] == pytest.approx(10 * 0.525 - 20 * 0.525**3 / 6, abs=0.02)
    held = ours.times[ours.accelerations < -10.499]
    assert held[-1] - held[0] == pytest.approx((10 - 20 * 0.525**2 / 2 - 5.25) / 10.5, abs=0.02)


@given(speeds, speeds, st.floats(-10, 3), lags)
def test_limits_hold_at_every_moment(speed, target, acceleration, lag):
    ours = drive(LongitudinalState(0.0, speed, acceleration), target, 2.0, LongitudinalModel(lag_s=lag))
    assert ours.accelerations.min() >= -10.5
    assert ours.accelerations.max() <= 3.0
    moving = (ours.speeds[1:] > 0) & (ours.speeds[:-1] > 0)
    assert np.abs(np.diff(ours.accelerations)[moving]).max(initial=0) <= 20 * 0.001 + 1e-9
    assert ours.speeds.min() >= 0
    assert np.diff(ours.positions).min() >= 0


@given(speeds, speeds, lags)
def test_the_result_does_not_depend_on_the_tick(speed, target, lag):
    model, start = LongitudinalModel(lag_s=lag), LongitudinalState(3.0, speed)
    whole = drive(start, target, 1.0, model).end
    for tick in (0.05, 0.1, 0.025):
        state = start
        for _ in range(round(1.0 / tick)):
            state = drive(state, target, tick, model).end
        assert vars(state) == pytest.approx(vars(whole), abs=1e-9)


def test_a_standing_car_stays_until_it_is_asked_to_go_and_goes_at_once():
    stopped = drive(LongitudinalState(0.0, 2.0), 0.0, 8.0).end
    assert stopped.speed < 1e-3
    assert drive(LongitudinalState(7.0, 0.0, -4.0), 0.0, 1.0).end == LongitudinalState(7.0, 0.0, 0.0)
    assert drive(LongitudinalState(7.0, 0.0, -4.0), 5.0, 0.5).end.speed > 0.3


def test_braking_with_a_long_lag_overshoots_to_a_standstill_and_not_backwards():
    ours = drive(LongitudinalState(0.0, 6.0), 0.0, 5.0, LongitudinalModel(lag_s=0.5))
    assert ours.speeds.min() == 0.0
    assert ours.end.speed == 0.0


def test_the_papers_printed_law_never_brakes():
    """a* = k v* is not negative for any target speed, so the car only ever gets faster; with the feedback it stops."""
    literal = LongitudinalModel(literal_law=True)
    for target in (0.0, 1.0, 5.0):
        assert drive(LongitudinalState(0.0, 5.0), target, 3.0, literal).accelerations.min() >= 0
    assert drive(LongitudinalState(0.0, 5.0), 0.0, 3.0, literal).end.speed == pytest.approx(5.0)
    assert drive(LongitudinalState(0.0, 5.0), 0.0, 3.0).end.speed < 0.1


def test_a_drive_of_no_time_changes_nothing():
    state = LongitudinalState(1.0, 2.0, 0.5)
    assert drive(state, 9.0, 0.0).end == state


@pytest.mark.parametrize("change", [{"lag_s": 0.0}, {"max_jerk_mps3": -1.0}, {"gain_per_s": np.nan}, {"step_s": 0.0}])
def test_impossible_constants_are_refused(change):
    with pytest.raises(ConfigError, match=f"dynamics: {next(iter(change))}"):
        LongitudinalModel(**change)
