"""The believed vehicle as a record that compiled code reads with the same names as the validated one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.extending import overload
from pydantic import BaseModel

from vpptwin.robots.planar_drone.vehicle import Control, Motor, Propeller, Vehicle

Number = Any
"""A number or an array of numbers: the functions of this package take either."""
RotorNumbers = Propeller | Any
MotorNumbers = Motor | Any
ControlNumbers = Control | Any
VehicleNumbers = Vehicle | Any
"""A section of the vehicle, or the record of it."""


def choose(condition: Number, first: Number, second: Number) -> Number:
    """`first` where the condition holds, else `second`: np.where, for which compiled code would allocate an array."""
    return np.where(condition, first, second)


@overload(choose, strict=False)
def compile_choice(condition: Number, first: Number, second: Number) -> Callable[..., Number]:
    """What `choose` of numbers compiles to."""
    return lambda condition, first, second: first if condition else second


def describe_section(section: type[BaseModel]) -> list[tuple[str, Any]]:
    """The numbers of a section as a numpy dtype, sections within included; anything else is left out."""
    fields: list[tuple[str, Any]] = []
    for name, info in section.model_fields.items():
        kind = info.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            fields.append((name, describe_section(kind)))
        elif kind is float:
            fields.append((name, np.float64))
    return fields


def fill_record(record: np.void, section: BaseModel) -> None:
    """Copy the numbers of a section into a record of its dtype."""
    for name in record.dtype.names or ():
        value = getattr(section, name)
        if isinstance(value, BaseModel):
            fill_record(record[name], value)
        else:
            record[name] = value


def vehicle_dtype() -> np.dtype:
    """The dtype of a vehicle's record."""
    return np.dtype(describe_section(Vehicle))


def record_vehicle(vehicle: Vehicle) -> np.ndarray:
    """All single numbers of a vehicle, (1,) records: `record_vehicle(v)[0].rotor.k_t` is `v.rotor.k_t`."""
    records = np.zeros(1, vehicle_dtype()).view(np.recarray)
    fill_record(records[0], vehicle)
    return records
