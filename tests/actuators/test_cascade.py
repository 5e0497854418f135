"""Gyro filter, rate PD and allocation, against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vpptwin.actuators.blade import max_thrust
from vpptwin.actuators.cascade import allocate, compute_torque, filter_gyro
from vpptwin.robots.planar_drone.vehicle import Vehicle, load_vehicle

NOMINAL = load_vehicle()


def test_gyro_filter_by_hand(vehicle: Vehicle) -> None:
    """From 0, a rate of 1 passes as 0.4, 0.4 + 0.4 * 0.6 = 0.64, 0.64 + 0.4 * 0.36 = 0.784."""
    filtered, seen = 0.0, []
    for _ in range(3):
        filtered = filter_gyro(vehicle, filtered, 1.0)
        seen.append(filtered)
    assert seen == pytest.approx([0.4, 0.64, 0.784], rel=1e-14)


def test_torque_by_hand(vehicle: Vehicle) -> None:
    """Rates 0.9 then 1.0 in 1 ms towards 2 rad/s: 0.12 * (2 - 1) - 0.0003 * 0.1/0.001 = 0.12 - 0.03 = 0.09 N m."""
    assert compute_torque(vehicle, 2.0, 1.0, 0.9, dt=0.001) == pytest.approx(0.09, rel=1e-12)


@pytest.mark.parametrize(
    ("thrust", "torque", "expected"),
    [
        pytest.param(4.0, 0.0, (2.0, 2.0), id="thrust is shared"),
        pytest.param(0.0, 0.5, (-1.0, 1.0), id="positive torque lifts the right arm"),  # 0.5 / (2 * 0.25) = 1 N each
        pytest.param(4.0, 0.5, (1.0, 3.0), id="both"),
        pytest.param(-4.0, 0.5, (-3.0, -1.0), id="inverted"),
        pytest.param(20.0, 0.0, (5.0, 5.0), id="thrust saturates"),
        pytest.param(10.0, 1.0, (1.0, 5.0), id="thrust gives way to rate"),  # half difference 2, so the mean is 3
        pytest.param(-10.0, 1.0, (-5.0, -1.0), id="thrust gives way when inverted"),
        pytest.param(4.0, 2.0, (-3.0, 5.0), id="thrust gives way in part"),  # half difference 4, so the mean is 1
        pytest.param(10.0, 5.0, (-5.0, 5.0), id="all for rate"),  # asks for 10 N each way
        pytest.param(10.0, -5.0, (5.0, -5.0), id="all for the other rate"),
    ],
)
def test_allocation_by_hand(vehicle: Vehicle, thrust: float, torque: float, expected: tuple[float, float]) -> None:
    """f_1,2 = f/2 ∓ τ/(2 l) within ±5 N, thrust giving way to torque."""
    np.testing.assert_allclose(allocate(vehicle, thrust, torque), expected, rtol=1e-14, atol=1e-14)


@given(st.floats(-30.0, 30.0), st.floats(-3.0, 3.0))
def test_rate_control_wins(thrust: float, torque: float) -> None:
    """Torque is met up to what the rotors can give at all, thrust as far as the room that is left allows."""
    limit, length = max_thrust(NOMINAL.rotor), NOMINAL.airframe.half_length
    first, second = allocate(NOMINAL, thrust, torque)
    assert max(abs(first), abs(second)) <= limit * (1 + 1e-15)
    possible = float(np.clip(torque, -2 * limit * length, 2 * limit * length))
    assert (second - first) * length == pytest.approx(possible, abs=1e-14)
    room = 2 * (limit - abs(possible) / (2 * length))
    assert first + second == pytest.approx(float(np.clip(thrust, -room, room)), abs=1e-13)
