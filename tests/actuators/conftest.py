"""A vehicle with round numbers, so that expected values can be worked out by hand."""

from __future__ import annotations

import pytest

from vpptwin.robots.planar_drone.vehicle import Motor, Propeller, Vehicle, load_vehicle


@pytest.fixture
def rotor() -> Propeller:
    """Thrust is 25 N/rad at the governed speed, so at most 5 N."""
    return Propeller(speed=500.0, k_t=0.05, k_d1=1e-7, k_d2=4e-6, k_d3=1e-4, inertia=4e-5, pitch_max=0.2)


@pytest.fixture
def motor() -> Motor:
    """At 12 V and 500 rad/s it draws (12 - 500/100)/0.1 = 70 A."""
    return Motor(k_v=100.0, k_q=100.0, resistance=0.1, no_load_current=0.5, battery=12.0)


@pytest.fixture
def vehicle(rotor: Propeller, motor: Motor) -> Vehicle:
    """The nominal vehicle with these rotors and arms of 0.25 m, so that 1 N m asks for a difference of 2 N."""
    nominal = load_vehicle()
    airframe = nominal.airframe.model_copy(update={"half_length": 0.25})
    control = nominal.control.model_copy(update={"rate_kp": 0.12, "rate_kd": 0.0003, "gyro_filter": 0.4})
    return nominal.model_copy(update={"rotor": rotor, "motor": motor, "airframe": airframe, "control": control})
