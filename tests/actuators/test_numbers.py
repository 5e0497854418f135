"""Numbers, arrays of numbers and records: the functions of this package take either and say the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from vpptwin.actuators import blade, controller, motor, servo
from vpptwin.actuators.numbers import record_vehicle
from vpptwin.robots.planar_drone.vehicle import load_vehicle

VEHICLE = load_vehicle()
ROTOR, MOTOR, DT = VEHICLE.rotor, VEHICLE.motor, 0.001
COUNT = 50
Draw = Callable[[float, float], Any]
CALLS: dict[str, Callable[[Draw], Any]] = {
    "compute_thrust": lambda draw: blade.compute_thrust(ROTOR, draw(0, 600), draw(-0.2, 0.2)),
    "compute_drag_torque": lambda draw: blade.compute_drag_torque(ROTOR, draw(0, 600), draw(-0.2, 0.2)),
    "pitch_for_thrust": lambda draw: blade.pitch_for_thrust(ROTOR, draw(-9, 9)),
    "filter_gyro": lambda draw: controller.filter_gyro(VEHICLE, draw(-9, 9), draw(-9, 9)),
    "compute_torque": lambda draw: controller.compute_torque(VEHICLE, draw(-9, 9), draw(-9, 9), draw(-9, 9), DT),
    "allocate": lambda draw: controller.allocate(VEHICLE, draw(-20, 20), draw(-2, 2)),
    "compute_current": lambda draw: motor.compute_current(MOTOR, draw(0, 12), draw(0, 600)),
    "step_speed": lambda draw: motor.step_speed(
        MOTOR, ROTOR, draw(0, 600), draw(-0.2, 0.2), draw(0, 12), draw(0.5, 2), DT
    ),
    "hold_speed": lambda draw: motor.hold_speed(MOTOR, ROTOR, draw(0, 900), draw(-0.2, 0.2), draw(-9, 9), DT),
    "step_lag": lambda draw: servo.step_lag(draw(-1, 1), draw(-1, 1), draw(0, 0.1), DT),
    "limit_rate": lambda draw: servo.limit_rate(draw(-1, 1), draw(-1, 1), draw(-1, 1), draw(0, 1e3), DT),
    "take_up_play": lambda draw: servo.take_up_play(draw(-1, 1), draw(-1, 1), draw(0, 0.1)),
}


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
def test_arrays_equal_numbers_one_by_one(call: Callable[[Draw], Any]) -> None:
    """Called with arrays a function returns for each element what it returns for that element alone."""
    # numpy's exp on arrays and on numbers may differ in the last bit.
    rounding = 4 * np.finfo(float).eps

    def draw_one(i: int) -> Draw:
        rng = np.random.default_rng(1)
        return lambda low, high: float(rng.uniform(low, high, COUNT)[i])

    def as_rows(result: Any) -> np.ndarray:  # noqa: ANN401
        return np.stack(result) if isinstance(result, tuple) else np.asarray(result)[None]

    rng = np.random.default_rng(1)
    together = as_rows(call(lambda low, high: rng.uniform(low, high, COUNT)))
    alone = np.stack([as_rows(call(draw_one(i))) for i in range(COUNT)], axis=-1)
    np.testing.assert_allclose(together, alone, rtol=rounding, atol=1e-18)


def test_record_holds_every_number() -> None:
    """The vehicle's record has each single number of the validated vehicle under the same name."""
    record, found = record_vehicle(VEHICLE)[0], 0

    def compare(section: BaseModel, numbers: Any) -> None:  # noqa: ANN401
        nonlocal found
        for name in type(section).model_fields:
            value = getattr(section, name)
            if isinstance(value, BaseModel):
                compare(value, numbers[name])
            elif isinstance(value, float):
                assert numbers[name] == value, name
                found += 1

    compare(VEHICLE, record)
    assert found > 30
    assert record.rotor.k_t == VEHICLE.rotor.k_t
