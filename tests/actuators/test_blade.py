"""Propeller: thrust, drag torque and the pitch for a thrust, against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vpptwin.actuators.blade import compute_drag_torque, compute_thrust, max_thrust, pitch_for_thrust
from vpptwin.robots.planar_drone.vehicle import Rotor, load_vehicle

NOMINAL = load_vehicle().rotor


@pytest.mark.parametrize(
    ("speed", "pitch", "expected"),
    [
        (400.0, 0.1, 2.0),  # 0.05 * 400 * 0.1
        (500.0, 0.2, 5.0),  # 0.05 * 500 * 0.2
        (500.0, -0.04, -1.0),  # negative pitch pulls down
        (0.0, 0.2, 0.0),
    ],
)
def test_thrust_by_hand(rotor: Rotor, speed: float, pitch: float, expected: float) -> None:
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
def test_drag_torque_by_hand(rotor: Rotor, speed: float, pitch: float, expected: float) -> None:
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
def test_pitch_for_thrust_by_hand(rotor: Rotor, thrust: float, expected: float) -> None:
    """The pitch for a thrust is thrust / (k_T ω), within the stops."""
    assert pitch_for_thrust(rotor, thrust) == pytest.approx(expected, rel=1e-14)


def test_max_thrust_by_hand(rotor: Rotor) -> None:
    """At its stop and governed speed a rotor gives 0.05 * 500 * 0.2 = 5 N."""
    assert max_thrust(rotor) == pytest.approx(5.0, rel=1e-14)


@given(st.floats(-1.0, 1.0))
def test_pitch_inverts_thrust(share: float) -> None:
    """At the governed speed the blade gives the thrust that was asked for, anywhere within its range."""
    wanted = share * max_thrust(NOMINAL)
    given_thrust = compute_thrust(NOMINAL, NOMINAL.speed, pitch_for_thrust(NOMINAL, wanted))
    np.testing.assert_allclose(given_thrust, wanted, rtol=1e-14, atol=1e-15)


@given(st.floats(0.0, 600.0), st.floats(-0.21, 0.21))
def test_drag_only_brakes(speed: float, pitch: float) -> None:
    """Drag torque never drives a turning rotor, and is the same at opposite pitch."""
    drag = compute_drag_torque(NOMINAL, speed, pitch)
    assert drag >= 0.0
    assert drag == compute_drag_torque(NOMINAL, speed, -pitch)
