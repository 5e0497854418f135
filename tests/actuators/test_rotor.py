"""A rotor by hand: thrust, drag torque and pitch for a thrust; motor and governor, and the speed they hold."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vpptwin.actuators.blade import compute_drag_torque, compute_thrust, max_thrust, pitch_for_thrust
from vpptwin.actuators.motor import accelerate_rotor, compute_current, hold_speed, step_speed
from vpptwin.actuators.servo import step_lag
from vpptwin.robots.planar_drone.vehicle import Motor, Propeller, Vehicle, load_vehicle

DT = 0.001
NOMINAL = load_vehicle()


@pytest.mark.parametrize(
    ("speed", "pitch", "expected"),
    [
        (400.0, 0.1, 2.0),  # 0.05 * 400 * 0.1
        (500.0, 0.2, 5.0),  # 0.05 * 500 * 0.2
        (500.0, -0.04, -1.0),  # negative pitch pulls down
        (0.0, 0.2, 0.0),
    ],
)
def test_thrust_by_hand(rotor: Propeller, speed: float, pitch: float, expected: float) -> None:
    """Thrust is k_T ω α with its sign (paper Eq. 4)."""
    assert compute_thrust(rotor, speed, pitch) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("speed", "pitch", "expected"),
    [
        (400.0, 0.0, 0.016),  # 1e-7 * 400²
        (400.0, 0.1, 0.0264),  # 0.016 + 4e-6 * 400² * 0.1² = 0.0064, + 1e-4 * 400 * 0.1 = 0.004
        (400.0, -0.1, 0.0264),  # drag does not know the sign of the pitch
        (500.0, 0.2, 0.075),  # 0.025 + 0.04 + 0.01
    ],
)
def test_drag_torque_by_hand(rotor: Propeller, speed: float, pitch: float, expected: float) -> None:
    """Drag torque is k_D1 ω² + k_D2 ω² α² + k_D3 ω |α| (paper Eq. 5)."""
    assert compute_drag_torque(rotor, speed, pitch) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("thrust", "expected"),
    [
        (2.0, 0.08),  # 2 / 25
        (-4.0, -0.16),
        (7.0, 0.2),  # beyond 5 N the blade sits on its stop
        (-7.0, -0.2),
    ],
)
def test_pitch_for_thrust_by_hand(rotor: Propeller, thrust: float, expected: float) -> None:
    """The pitch for a thrust is thrust / (k_T ω), within the stops."""
    assert pitch_for_thrust(rotor, thrust) == pytest.approx(expected, rel=1e-14)


def test_max_thrust_by_hand(rotor: Propeller) -> None:
    """At its stop and governed speed a rotor gives 0.05 * 500 * 0.2 = 5 N."""
    assert max_thrust(rotor) == pytest.approx(5.0, rel=1e-14)


@given(st.floats(-1.0, 1.0))
def test_pitch_inverts_thrust(share: float) -> None:
    """At the governed speed the blade gives the thrust that was asked for, anywhere within its range."""
    wanted = share * max_thrust(NOMINAL.rotor)
    given_thrust = compute_thrust(NOMINAL.rotor, NOMINAL.rotor.speed, pitch_for_thrust(NOMINAL.rotor, wanted))
    np.testing.assert_allclose(given_thrust, wanted, rtol=1e-14, atol=1e-15)


@given(st.floats(0.0, 600.0), st.floats(-0.21, 0.21))
def test_drag_only_brakes(speed: float, pitch: float) -> None:
    """Drag torque never drives a turning rotor, and is the same at opposite pitch."""
    drag = compute_drag_torque(NOMINAL.rotor, speed, pitch)
    assert drag >= 0.0
    assert drag == compute_drag_torque(NOMINAL.rotor, speed, -pitch)


def spin(vehicle: Vehicle, speed: float, pitch_commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Governor, servo and motor from a start speed [rad/s]; returns speed [rad/s] and throttle of every step, (n,)."""
    now, integral, blade = speed, 0.0, pitch_commands[0]
    speeds, throttles = [], []
    for command in pitch_commands:
        throttle, integral = hold_speed(vehicle.motor, vehicle.rotor, now, command, integral, DT)
        blade, _ = step_lag(blade, command, vehicle.servo.time_constant, DT)
        now = step_speed(vehicle.motor, vehicle.rotor, now, blade, throttle * vehicle.motor.battery, 1.0, DT)
        speeds.append(now)
        throttles.append(throttle)
    return np.array(speeds), np.array(throttles)


def test_current_by_hand(motor: Motor) -> None:
    """(12 V - 500/100 V) / 0.1 Ω = 70 A; at 5 V none flows (paper Eq. 7)."""
    current = compute_current(motor, np.array([12.0, 5.0]), np.array([500.0, 500.0]))
    np.testing.assert_allclose(current, [70.0, 0.0], atol=1e-12)


def test_speed_step_by_hand(motor: Motor, rotor: Propeller) -> None:
    """At 400 rad/s and pitch 0.1, 5 V speed a rotor up by 1.715 rad/s in 1 ms (paper Eq. 6)."""
    # (5 - 4)/0.1 = 10 A give (10 - 0.5)/100 = 0.095 N m against 0.0264 N m of drag: 0.0686/4e-5 = 1715 rad/s².
    assert accelerate_rotor(motor, rotor, 400.0, 0.1, 5.0, 1.0) == pytest.approx(1715.0, rel=1e-12)


def test_drag_gain_by_hand(motor: Motor, rotor: Propeller) -> None:
    """At 1.5 times the drag, the same 5 V speed it up by (0.095 - 1.5 * 0.0264)/4e-5 = 1385 rad/s²."""
    assert accelerate_rotor(motor, rotor, 400.0, 0.1, 5.0, 1.5) == pytest.approx(1385.0, rel=1e-12)


def test_rotor_does_not_turn_backwards(motor: Motor, rotor: Propeller) -> None:
    """Without voltage a slow rotor stops and stays there."""
    assert step_speed(motor, rotor, 0.01, 0.0, 0.0, 1.0, DT) == 0.0
    assert step_speed(motor, rotor, 0.0, 0.0, 0.0, 1.0, DT) == 0.0


def test_feed_forward_holds_the_speed_exactly(motor: Motor, rotor: Propeller) -> None:
    """At governed speed and steady pitch the feed-forward alone balances drag: 5 + 0.1 (0.5 + 100 * 0.075) = 5.8 V."""
    throttle, integral = hold_speed(motor, rotor, 500.0, 0.2, 0.0, DT)
    assert throttle * motor.battery == pytest.approx(5.8, rel=1e-14)
    assert integral == 0.0
    assert step_speed(motor, rotor, 500.0, 0.2, throttle * motor.battery, 1.0, DT) == pytest.approx(500.0, rel=1e-13)


@pytest.mark.parametrize("period", [0.01, 0.1, 0.5])
def test_governor_holds_4500_rpm(period: float) -> None:
    """Through full pitch steps (0, top stop, bottom stop, 0, ...), fast or slow, speed stays within 2 % of 4500 rpm."""
    stop, steps = NOMINAL.rotor.pitch_max, round(period / DT)
    pitch = np.tile(np.repeat([0.0, stop, -stop, 0.0, -stop], steps), 4)
    speed, throttle = spin(NOMINAL, NOMINAL.rotor.speed, pitch)
    assert NOMINAL.rotor.speed == pytest.approx(4500 * 2 * np.pi / 60, rel=1e-6)
    np.testing.assert_allclose(speed, NOMINAL.rotor.speed, rtol=0.02)
    assert throttle.min() > 0.0
    assert throttle.max() < 1.0


def test_governor_removes_a_steady_error() -> None:
    """With 10 % more drag than believed the feed-forward is wrong, and the integral brings the speed back."""
    gain, speed, integral, pitch, worst = 1.1, NOMINAL.rotor.speed, 0.0, 0.1, 0.0
    for _ in range(4000):
        throttle, integral = hold_speed(NOMINAL.motor, NOMINAL.rotor, speed, pitch, integral, DT)
        speed = step_speed(NOMINAL.motor, NOMINAL.rotor, speed, pitch, throttle * NOMINAL.motor.battery, gain, DT)
        worst = max(worst, abs(speed / NOMINAL.rotor.speed - 1))
    drag = (gain - 1.0) * compute_drag_torque(NOMINAL.rotor, speed, pitch)
    lacking = NOMINAL.motor.resistance * NOMINAL.motor.k_q * drag  # V that the feed-forward is short of
    assert 1e-4 < worst <= lacking / 0.05 / NOMINAL.rotor.speed  # proportional feedback alone would stop there
    assert speed == pytest.approx(NOMINAL.rotor.speed, rel=1e-6)


@pytest.mark.parametrize(("start", "saturated_at"), [(0.0, 1.0), (800.0, 0.0)])
def test_governor_does_not_wind_up(start: float, saturated_at: float) -> None:
    """Far from the target the throttle saturates for tens of ms; once there the speed overshoots by less than 1 %."""
    # Had the integral grown meanwhile, by 20 ms * 200 rad/s or more, it would push by 2 V: 5 % at this feedback.
    speed, throttle = spin(NOMINAL, start, np.full(1500, 0.1))
    error = (speed / NOMINAL.rotor.speed - 1) * (1 if start < NOMINAL.rotor.speed else -1)
    assert np.count_nonzero(throttle == saturated_at) > 10
    assert error.max() < 0.01
    assert abs(error[-1]) < 0.001
    assert ((throttle >= 0.0) & (throttle <= 1.0)).all()


def test_integral_holds_while_saturated(motor: Motor, rotor: Propeller) -> None:
    """A saturated rotor keeps its integral; beside it one that is 1 rad/s slow gains 1 rad/s * 1 ms."""
    throttle, integral = hold_speed(motor, rotor, 0.0, 0.0, 0.3, DT)
    assert (throttle, integral) == (1.0, 0.3)
    _, integral = hold_speed(motor, rotor, 499.0, 0.0, 0.3, DT)
    assert integral == pytest.approx(0.301, rel=1e-14)


def test_speed_step_is_of_second_order(motor: Motor, rotor: Propeller) -> None:
    """Half the step leaves a quarter of the error after 20 ms of spinning up, against a thousandth of the step."""

    def spin(dt: float) -> float:
        speed = 400.0
        for _ in range(round(0.02 / dt)):
            speed = float(step_speed(motor, rotor, speed, 0.1, 6.0, 1.0, dt))
        return speed

    exact = spin(1e-6)
    assert (spin(1e-3) - exact) / (spin(5e-4) - exact) == pytest.approx(4.0, rel=0.05)
