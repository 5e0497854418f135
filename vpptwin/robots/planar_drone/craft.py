"""The planar drone with two variable-pitch propellers, on its rail rig or free."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial, reduce
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

import mujoco
import numpy as np

from vpptwin.effects import Effect
from vpptwin.robots.planar_drone.effects.catalogue import CATALOGUE
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.losses import take_out_losses
from vpptwin.twin.robot.model import compile_model, missing_parts
from vpptwin.twin.robot.robot import Disturbance, Loads, Robot

CRAFT_JOINTS = ("rail_x", "rail_z", "pitch")
"""Joints of the drone in the order of its generalized coordinates x, z, θ."""
PITCH = 2
GUST = 0.01
"""Force that nobody modelled, as a share of the drone's weight."""
GUST_TIME = 0.3
"""Time over which gusts stay alike [s]."""
START_HEIGHT = 1.0
"""At which it hovers unless somebody says [m]."""


@dataclass(frozen=True)
class PlanarDrone(Robot):
    """Our drone: a rig whose numbers come from a vehicle file.

    Attributes:
        rotorcraft: those numbers.
    """

    rotorcraft: Vehicle | None = None  # type: ignore[misc]  # every drone has one
    window: float = 0.3  # it falls over within a second
    shortest_window: ClassVar[float] = 0.3
    warm_up: ClassVar[float] = 0.15
    shortest_log: ClassVar[float] = 5.0
    controllers: ClassVar[tuple[str, ...]] = ("map", "adaptive")
    step: ClassVar[str] = "step_drone"
    attitude: ClassVar[int | None] = PITCH
    followed: ClassVar[str] = "craft"
    pictures: ClassVar[str] = "effects"
    hooks: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "read_signals": "vpptwin.robots.planar_drone.topics:read_drone",
            "propose": "vpptwin.robots.planar_drone.experiment:propose",
            "list_topics": "vpptwin.robots.planar_drone.report:list_drone",
            "advise_library": "vpptwin.robots.planar_drone.report:advise_drone",
            "suggest_training": "vpptwin.robots.planar_drone.report:suggest_flip",
            "find_positions": "vpptwin.robots.planar_drone.display.overlay:read_pose",
            "make_overlay": "vpptwin.robots.planar_drone.display.overlay:overlay_craft",
            "tell_robot": "vpptwin.robots.planar_drone.display.panels:tell_craft",
            "regress_drag": "vpptwin.robots.planar_drone.thrust_stand.drag:regress_drag",
            "find_triggers": "vpptwin.robots.planar_drone.display.panels:find_flips",
        }
    )

    @staticmethod
    def assemble(name: str, path: Path, vehicle: Vehicle) -> PlanarDrone:
        """A drone from its MJCF and its numbers.

        Raises:
            InputError: if the MJCF is none of a drone, or none that a twin can step.
        """
        model = compile_model(path, partial(apply_vehicle, vehicle), check_craft)
        return PlanarDrone(name, model, rotorcraft=vehicle)

    @property
    def adapt(self) -> Callable[[mujoco.MjSpec, Path], None]:
        """The vehicle's numbers go into the MJCF."""
        return partial(apply_vehicle, self.vehicle)

    @property
    def numbers(self) -> np.ndarray:
        """The believed vehicle as a record."""
        from vpptwin.actuators.numbers import record_vehicle  # which brings numba

        return record_vehicle(self.vehicle)

    @property
    def servo_lag(self) -> float:
        """Of the pitch servos [s]."""
        return self.vehicle.servo.time_constant

    @property
    def rotor_speed(self) -> float:
        """At which the governor holds them [rad/s]."""
        return self.vehicle.rotor.speed

    @property
    def start_pose(self) -> np.ndarray:
        """Hovering height above the origin, (nq,) m, rad."""
        pose = np.array(self.model.qpos0)
        pose[1] = START_HEIGHT
        return pose

    @cached_property
    def disturbance(self) -> Disturbance:
        """Gusts; proving/drone shows how flights without an effect look."""
        airframe = self.vehicle.airframe
        std = GUST * (airframe.mass * self.vehicle.gravity) * np.array([1.0, 1.0, airframe.half_length])
        return Disturbance(std, GUST_TIME, known=True)

    def scale(self, loads: Loads) -> PlanarDrone:
        """Its scales are known."""
        return self

    @property
    def limits(self) -> dict[str, tuple[int, float]]:
        """The pitch stops."""
        return {f"blade pitch {i + 1}": (i, self.vehicle.rotor.pitch_max) for i in range(self.model.nu)}

    @property
    def body(self) -> int:
        """The craft."""
        return int(self.model.body("craft").id)

    @property
    def carriage(self) -> int:
        """The rail's carriage; the free craft has none."""
        return mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, "carriage")

    def list_effects(self) -> tuple[Effect, ...]:
        """The catalogue, less what this model lacks parts for."""
        return tuple(e.bind(self.nominal) for e in CATALOGUE if not missing_parts(self.model, e))

    def nominal(self, key: str) -> float:
        """The vehicle's number at a dotted key, e.g. `servo.time_constant`; KeyError where there is none."""
        try:
            value: object = reduce(getattr, key.split("."), self.vehicle)
        except AttributeError as error:
            raise KeyError(key) from error
        if not isinstance(value, float):
            raise KeyError(key)
        return value

    def weigh_commands(self, effect: Effect, dof: int) -> tuple[np.ndarray, str]:
        """Both rotors lift, their difference turns."""
        if dof == PITCH:
            return np.array([-1.0, 1.0]), "difference of blade pitch commands [rad]"
        return np.array([0.5, 0.5]), "mean blade pitch command [rad]"


def check_craft(model: mujoco.MjModel, path: Path) -> None:
    """Check that the drone's joints come first, in the order of its coordinates, and that it has two rotors."""
    joints = tuple(model.joint(i).name for i in range(model.njnt))
    if joints[:3] != CRAFT_JOINTS:
        raise InputError(f"{path}: joints {', '.join(joints)}", "first rail_x, rail_z, pitch", "put them in this order")
    if model.nu != 2:
        raise InputError(f"{path}: {model.nu} actuators", "two, the thrusts of rotors 1 and 2", "see rail_rig.xml")


def apply_vehicle(vehicle: Vehicle, spec: mujoco.MjSpec, path: Path) -> None:
    """Write the vehicle's numbers into the specification of vpp_planar.xml, rail_rig.xml or a model like them.

    Its own friction, damping and air are taken out: those of a twin are effects.
    """
    joints = {joint.name: joint for joint in spec.joints}
    bodies = {body.name: body for body in spec.bodies}
    missing = [f"joint {name}" for name in CRAFT_JOINTS if name not in joints]
    if missing or "craft" not in bodies:
        found = missing[0] if missing else "body craft"
        raise InputError(
            f"{path}: no {found}", "joints rail_x, rail_z and pitch and a body craft", "leave out `vehicle`"
        )
    take_out_losses(spec, CRAFT_JOINTS)
    spec.option.gravity = [0.0, 0.0, -vehicle.gravity]
    spec.option.timestep = 1.0 / vehicle.control.inner_rate
    craft = bodies["craft"]
    craft.mass = vehicle.airframe.mass
    craft.inertia = [vehicle.airframe.inertia] * 3  # it turns about y alone; any inertia then makes a possible body
    for site in spec.sites:
        if site.name in ("rotor_1", "rotor_2"):
            side = -1.0 if site.name == "rotor_1" else 1.0
            site.pos = [side * vehicle.airframe.half_length, site.pos[1], site.pos[2]]
    if "carriage" in bodies and "slider" in bodies:
        bodies["carriage"].mass = vehicle.rig.carriage_mass
        bodies["slider"].mass = vehicle.rig.slider_mass
        joints["rail_x"].range = list(vehicle.rig.travel_x)
        joints["rail_z"].range = list(vehicle.rig.travel_z)
