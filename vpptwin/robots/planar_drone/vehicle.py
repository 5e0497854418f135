"""The nominal numbers of a vehicle on its rig, read from YAML and validated. SI units throughout."""

from __future__ import annotations

from pathlib import Path
from textwrap import shorten
from typing import Annotated

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from vpptwin.system.errors import InputError
from vpptwin.system.plain import read_yaml
from vpptwin.system.resources import find_model_file

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0.0)]
Rate = Annotated[Positive, Field(le=1e5)]
NonNegative = Annotated[Number, Field(ge=0.0)]


def check_order(travel: tuple[float, float]) -> tuple[float, float]:
    """Refuse a range whose end does not lie beyond its start."""
    if travel[0] >= travel[1]:
        raise ValueError("the lowest position, then the highest")
    return travel


Travel = Annotated[tuple[Number, Number], AfterValidator(check_order)]


class Section(BaseModel):
    """A section of the vehicle file: immutable, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Airframe(Section):
    """The craft itself: mass [kg], half_length hinge to rotor axis [m], inertia about the hinge [kg m^2]."""

    mass: Positive
    half_length: Positive
    inertia: Positive


class RailRig(Section):
    """The slide rail: masses [kg], rail_height, bearing_spacing and travel [m]."""

    carriage_mass: NonNegative
    slider_mass: NonNegative
    rail_height: Number
    bearing_spacing: Positive
    travel_x: Travel
    travel_z: Travel


class RotorConstants(Section):
    """What a thrust stand tells of a propeller: thrust and drag constants, inertia [kg m^2].

    k_t [N s/rad^2], k_d1 [N m s^2], k_d2 [N m s^2/rad^2], k_d3 [N m s/rad].

    Thrust is k_t ω α, or what `vpptwin identify` finds: T = ω (ω/speed)^(thrust_power - 1) s(α) with
    s = α (k_t + k_t2 |α| + k_t3 α²) [k_t2 N s/rad^3, k_t3 N s/rad^4], or, if `inflow` [(N s/rad)^(1/2)] is not zero,
    blade elements with inflow: s = ±x², x² + inflow x = k_t |α|.
    """

    k_t: Positive
    k_t2: Number = 0.0
    k_t3: Number = 0.0
    inflow: NonNegative = 0.0
    thrust_power: Annotated[float, Field(ge=1.0, le=2.0)] = 1.0
    k_d1: NonNegative
    k_d2: NonNegative
    k_d3: NonNegative
    inertia: Positive


class Propeller(RotorConstants):
    """Propeller: its constants, governed speed [rad/s], pitch_max [rad]."""

    speed: Positive
    pitch_max: Positive


class MotorConstants(Section):
    """What a thrust stand tells of a motor: k_v [rad/s/V], k_q [A/(N m)], resistance [ohm], no_load_current [A]."""

    k_v: Positive
    k_q: Positive
    resistance: Positive
    no_load_current: NonNegative


class Motor(MotorConstants):
    """Motor: its constants, battery [V]."""

    battery: Positive


class Servo(Section):
    """Pitch servo: time_constant [s] of the first-order lag."""

    time_constant: Positive


class Control(Section):
    """Loops: rates [Hz], thrust_max [N], rate_max [rad/s], gains of the rate PD, gyro_filter per inner step.

    rate_kp [N m s/rad], rate_kd [N m s^2/rad].
    """

    policy_rate: Rate
    inner_rate: Rate
    thrust_max: Positive
    rate_max: Positive
    rate_kp: NonNegative
    rate_kd: NonNegative
    gyro_filter: Annotated[float, Field(gt=0.0, le=1.0)]


class MocapSensor(Section):
    """Motion capture: rate [Hz], position_std [m], angle_std [rad]."""

    rate: Rate
    position_std: Positive
    angle_std: Positive


class ImuSensor(Section):
    """IMU at the hinge: rate [Hz], gyro_std [rad/s], accel_std [m/s^2]."""

    rate: Rate
    gyro_std: Positive
    accel_std: Positive


class RotorSensor(Section):
    """Rotor telemetry: rate [Hz], speed_std [rad/s], current_std [A]."""

    rate: Rate
    speed_std: Positive
    current_std: Positive


class Sensors(Section):
    """Noise and rate of every sensor."""

    mocap: MocapSensor
    imu: ImuSensor
    rotor: RotorSensor


class Vehicle(Section):
    """All nominal numbers of one vehicle; the believed values that control and scaling may use."""

    gravity: Positive
    airframe: Airframe
    rig: RailRig
    rotor: Propeller
    motor: Motor
    servo: Servo
    control: Control
    sensors: Sensors


def load_vehicle(path: Path | str | None = None) -> Vehicle:
    """Read a vehicle file.

    Args:
        path: a YAML file; None for the shipped nominal vehicle.

    Raises:
        InputError: if the file is missing, is not YAML, or a number is absent, unknown or out of range.
    """
    file = find_model_file("vehicle.yaml") if path is None else Path(path)
    try:
        return Vehicle.model_validate(read_yaml(file))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"{file}: {error}", "a vehicle YAML", "see models/vehicle.yaml for an example") from error
    except ValidationError as error:
        found, expected = describe_problem(error)
        raise InputError(f"{file}: {found}", expected, "see models/vehicle.yaml for every key") from error


def describe_problem(error: ValidationError) -> tuple[str, str]:
    """What the first problem is, the key first, and what was expected there."""
    first = error.errors()[0]
    key = ".".join(map(str, first["loc"]))
    if not key:  # some other file, whose content is nobody's business
        return "no YAML mapping", "keys and values"
    if first["type"] == "missing":
        return f"{key} is missing", "a value for it"
    if first["type"] == "extra_forbidden":
        return f"{key} is unknown", "only keys of a vehicle"
    expected = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    return f"{key} = {shorten(repr(first['input']), 60)}", expected


def strengthen_rotor(rotor: Propeller, factor: float) -> Propeller:
    """The rotor with so many times the thrust at every pitch."""
    wider = rotor.inflow * factor**0.5
    changed = {"k_t": rotor.k_t * factor, "k_t2": rotor.k_t2 * factor, "k_t3": rotor.k_t3 * factor, "inflow": wider}
    return rotor.model_copy(update=changed)


def weigh(vehicle: Vehicle) -> float:
    """What the rotors carry, craft and slider [N]."""
    return (vehicle.airframe.mass + vehicle.rig.slider_mass) * vehicle.gravity


def strengthen(vehicle: Vehicle, thrust_to_weight: float, commanded: float | None = None) -> Vehicle:
    """A vehicle whose rotors, and what is believed of them, give this thrust-to-weight ratio.

    As much is commanded at most, unless `commanded`, over the weight too, says otherwise.
    """
    weight = weigh(vehicle)
    rotor = strengthen_rotor(vehicle.rotor, thrust_to_weight * weight / vehicle.control.thrust_max)
    control = vehicle.control.model_copy(update={"thrust_max": (commanded or thrust_to_weight) * weight})
    return vehicle.model_copy(update={"rotor": rotor, "control": control})
