"""actuator.yaml: what `vpptwin identify` writes of an actuator, and a twin YAML refers to."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vpptwin.errors import InputError
from vpptwin.vehicle import NonNegative, Number, Positive, Vehicle, describe_problem


class Part(BaseModel):
    """A part of the file: unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class RotorPart(Part):
    """Keys of a vehicle's rotor that a thrust stand tells."""

    k_t: Positive
    k_t2: Number = 0.0
    k_t3: Number = 0.0
    inflow: NonNegative = 0.0
    thrust_power: Annotated[float, Field(ge=1.0, le=2.0)] = 1.0
    k_d1: NonNegative
    k_d2: NonNegative
    k_d3: NonNegative
    inertia: Positive


class MotorPart(Part):
    """Keys of a vehicle's motor that a thrust stand tells."""

    k_v: Positive
    k_q: Positive
    resistance: Positive
    no_load_current: NonNegative


class ServoPart(Part):
    """Lag and delay of a servo [s]."""

    time_constant: Positive
    delay: NonNegative = 0.0


class ActuatorFile(Part):
    """The file. What follows `servo` is for people."""

    rotor: RotorPart
    motor: MotorPart
    servo: ServoPart
    intervals_90: dict[str, list[float]] = {}
    thrust_map: dict[str, object] = {}
    speed_disturbance: list[float] = []
    held_out: dict[str, dict[str, object]] = {}
    notes: list[str] = []
    provenance: dict[str, object] = {}


def load_actuator(path: Path) -> ActuatorFile:
    """Read the file.

    Raises:
        InputError: if it is missing, is not YAML, or a number is absent or makes no sense.
    """
    try:
        return ActuatorFile.model_validate(yaml.safe_load(path.read_text()))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        found, expected = f"{path}: {reason}", "an actuator YAML"
        raise InputError(found, expected, "write one with `vpptwin identify BENCH.mcap --out actuator.yaml`") from error
    except ValidationError as error:
        found, expected = describe_problem(error)
        raise InputError(f"{path}: {found}", expected, "write it anew with `vpptwin identify`") from error


def equip(vehicle: Vehicle, actuator: ActuatorFile) -> Vehicle:
    """The vehicle with the actuator's numbers in place of its own; its delay is the effect `command.delay`'s."""
    rotor = vehicle.rotor.model_copy(update=actuator.rotor.model_dump())
    motor = vehicle.motor.model_copy(update=actuator.motor.model_dump())
    servo = vehicle.servo.model_copy(update={"time_constant": actuator.servo.time_constant})
    return vehicle.model_copy(update={"rotor": rotor, "motor": motor, "servo": servo})
