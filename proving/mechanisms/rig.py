"""A rig that is not ours: a chain of links with drives, its MJCF, and how one built after it differs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

GRAVITY = 9.81
JITTER = 0.005
"""Share by which a number of the rig may be off what its MJCF says, either way."""
TIMESTEP = 0.001
"""Of the MJCF [s]: every log's period is a multiple of it."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Link:
    """A body and the joint that carries it; its parent is the link before it."""

    joint: str  # name
    rotary: bool  # hinge, else slide
    axis: Vector  # of the joint, unit vector in the link's axes
    place: Vector  # of the joint in the parent's axes [m]
    com: Vector  # centre of mass [m]
    mass: float  # kg
    inertia: Vector  # about the centre of mass, along the link's axes [kg m²]
    armature: float = 0.0  # inertia of the drive reflected to the joint [kg, kg m²]
    damping: float = 0.0  # that the MJCF knows of [N s/m, N m s/rad]
    dry: float = 0.0  # likewise dry friction [N, N m]


@dataclass(frozen=True)
class Drive:
    """A motor: its name, the index of its joint, force per control input [N, N m], largest control input."""

    name: str
    joint: int
    gear: float
    limit: float


@dataclass(frozen=True)
class Rig:
    """A chain of links under gravity along -z."""

    family: str  # that it was drawn from
    links: tuple[Link, ...]  # from the ground on
    drives: tuple[Drive, ...]  # in the order of the control inputs
    travel: tuple[float, ...]  # amplitude that each joint is moved about by, (n,) [m, rad]
    pace: float  # typical angular frequency of its motion [rad/s]

    @property
    def joints(self) -> list[str]:
        """Names of the joints."""
        return [link.joint for link in self.links]

    @property
    def driven(self) -> np.ndarray:
        """Which joints have a drive, (n,) bool."""
        return np.isin(np.arange(len(self.links)), [drive.joint for drive in self.drives])

    def jitter(self, rng: np.random.Generator) -> Rig:
        """A rig built after this one, every number off by its own share."""

        def off(value: float) -> float:
            return value * (1.0 + JITTER * rng.uniform(-1.0, 1.0))

        links = tuple(
            replace(
                link, mass=off(link.mass), inertia=tuple(map(off, link.inertia)), com=tuple(map(off, link.com)),
                armature=off(link.armature), damping=off(link.damping), dry=off(link.dry),
            )
            for link in self.links
        )  # fmt: skip
        return replace(self, links=links, drives=tuple(replace(d, gear=off(d.gear)) for d in self.drives))

    def write_mjcf(self) -> str:
        """The rig as MJCF: explicit inertias, armature and what friction is known at the joints, motors with gear."""
        bodies = ""
        for i, link in enumerate(self.links):
            known = "".join(
                f' {name}="{value:.10g}"'
                for name, value in (("armature", link.armature), ("damping", link.damping), ("frictionloss", link.dry))
                if value
            )
            kind = "hinge" if link.rotary else "slide"
            bodies += (
                f'<body name="link_{i}" pos="{tell(link.place)}">\n'
                f'<joint name="{link.joint}" type="{kind}" axis="{tell(link.axis)}"{known}/>\n'
                f'<inertial pos="{tell(link.com)}" mass="{link.mass:.10g}" diaginertia="{tell(link.inertia)}"/>\n'
            )
        motors = "".join(
            f'<motor name="{d.name}" joint="{self.joints[d.joint]}" gear="{d.gear:.10g}"/>\n' for d in self.drives
        )
        return (
            f'<mujoco model="{self.family}">\n'
            '<compiler angle="radian" autolimits="true" balanceinertia="false"/>\n'
            '<default><joint solimpfriction="0.9999 0.9999 0.001 0.5 2" solreffriction="0.004 1"/></default>\n'
            f'<option timestep="{TIMESTEP:g}" gravity="0 0 {-GRAVITY:g}"/>\n'
            f"<worldbody>\n{bodies}{'</body>' * len(self.links)}\n</worldbody>\n"
            f"{f'<actuator>{chr(10)}{motors}</actuator>{chr(10)}' if motors else ''}</mujoco>\n"
        )

    def write_twin(self, model: str) -> str:
        """The twin YAML of that MJCF: topics of joints and drives."""
        joints = ", ".join(f"{joint}: /joint_states" for joint in self.joints)
        drives = ", ".join(f"{drive.name}: /actuator_command" for drive in self.drives)
        actuators = f"  actuators: {{{drives}}}\n" if drives else ""
        return f"model: {model}\nsignals:\n  joints: {{{joints}}}\n{actuators}"


def tell(vector: Vector) -> str:
    """Numbers as MJCF has them."""
    return " ".join(f"{value:.10g}" for value in vector)
