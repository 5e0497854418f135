"""actuator.yaml: what `vpptwin identify` writes of an actuator, and a twin YAML refers to."""

from __future__ import annotations

from pathlib import Path

import yaml
from pydantic import Field, ValidationError

from vpptwin.robots.planar_drone.vehicle import (
    MotorConstants,
    NonNegative,
    RotorConstants,
    Section,
    Servo,
    Vehicle,
    describe_problem,
)
from vpptwin.system.errors import InputError
from vpptwin.system.plain import read_yaml


class DelayedServo(Servo):
    """A servo with the delay of its commands [s]."""

    delay: NonNegative = 0.0


class ActuatorFile(Section):
    """The file. What follows `servo` is for people."""

    rotor: RotorConstants
    motor: MotorConstants
    servo: DelayedServo
    intervals_90: dict[str, list[float]] = Field(default_factory=dict)
    thrust_map: dict[str, object] = Field(default_factory=dict)
    held_out: dict[str, dict[str, object]] = Field(default_factory=dict)
    notes: list[str] = Field(default_factory=list)
    provenance: dict[str, object] = Field(default_factory=dict)


def load_actuator(path: Path) -> ActuatorFile:
    """Read the file.

    Raises:
        InputError: if it is missing, is not YAML, or a number is absent or makes no sense.
    """
    try:
        return ActuatorFile.model_validate(read_yaml(path))
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
