"""Effects on a body that nothing holds: errors of its mass, centre of mass and inertia, the air that drags or blows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vpptwin.effects.base import ApplyFunction, Body, Effect, Stage
from vpptwin.effects.constants import Change, Constants, Site, add
from vpptwin.effects.parameter import Parameter, Prior

AXES = ("x", "y", "z")
WEIGHT = 9.81
"""By which a force tells how much mass it carries [m/s²]."""
MASSES = 10.0
"""Factor at most on bounds of masses before a log: models tell these better than forces."""
BODY_SHOWS = ("/pose", "/imu")
"""Signals in which they show: a body's pose and its IMU."""


@dataclass(frozen=True)
class FreeBody:
    """A body that effects are made for.

    Attributes:
        name: in the MJCF.
        mass: kg.
        inertia: about its principal axes, kg m².
        size: a radius of gyration [m].
        force, torque: that typically drive, accelerate or weigh on it [N], [N m].
        speed: that it typically reaches [m/s].
        shift: of its centre of mass that would show [m]; 0 for a share of its size.
        room: factor on bounds, as `JointScale` has it.
    """

    name: str
    mass: float
    inertia: tuple[float, ...]
    size: float
    force: float
    torque: float
    speed: float
    shift: float = 0.0
    room: float = 1.0


add_mass = add(("body_mass", "body"))
"""m + mass [kg]."""


def move_centre(axes: str) -> Change:
    """C + offset along each of some of the body's axes [m]; the inertia about its origin grows by m c² (Steiner)."""
    return add(*(("body_ipos", "body", AXES.index(axis)) for axis in axes))


def apply_inertia(constants: Constants, site: Site, /, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> None:
    """Inertia about the principal axes times these; of three that no body can have the largest is cut to the sum."""
    # I_x ≤ I_y + I_z, and so for each: no mass distribution has other principal moments (Wensing and others 2018).
    moments = constants["body_inertia"][:, site.body] * np.stack([x, y, z], axis=1)
    constants["body_inertia"][:, site.body] = np.minimum(moments, moments.sum(axis=1, keepdims=True) - moments)


def apply_wind(body: Body, /, x: float, y: float, z: float) -> tuple[float, float, float, float, float, float]:
    """A steady force in the world's axes [N]."""
    return x, y, z, 0.0, 0.0, 0.0


def apply_drag(body: Body, /, along: float, across: float) -> tuple[float, float, float, float, float, float]:
    """Drag linear in the velocity, `across` along the body's x and y, `along` its z [N s/m], as of rotors in plane."""
    w, i, j, k = body.w, body.i, body.j, body.k
    up_x, up_y, up_z = 2.0 * (i * k + w * j), 2.0 * (j * k - w * i), 1.0 - 2.0 * (i * i + j * j)
    climb = body.v_x * up_x + body.v_y * up_y + body.v_z * up_z
    more = (across - along) * climb
    return (
        more * up_x - across * body.v_x, more * up_y - across * body.v_y, more * up_z - across * body.v_z,
        0.0, 0.0, 0.0,
    )  # fmt: skip


def apply_twist(body: Body, /, x: float, y: float, z: float) -> tuple[float, float, float, float, float, float]:
    """A steady torque about the body's axes [N m]."""
    return 0.0, 0.0, 0.0, x, y, z


def effects_for_body(body: FreeBody) -> tuple[Effect, ...]:
    """The effects of one free body, `NAME.mass` and so on."""
    name, source = body.name, "assumption: shares of what the model, or the log, has"

    def have(
        kind: str, summary: str, equation: str, parameters: tuple[Parameter, ...], alike: tuple[str, ...], follows: str,
        apply: ApplyFunction, writes: tuple[str, ...] = (),
    ) -> Effect:  # fmt: skip
        stage = Stage.CONSTANT if writes or isinstance(apply, Change) else Stage.FORCE
        return Effect(
            f"{name}.{kind}", f"{summary} {name}", equation, parameters, stage, apply, BODY_SHOWS,
            tuple(f"{name}.{other}" for other in alike), writes, name, dissipative=kind == "drag", follows=follows,
        )  # fmt: skip

    def along_axes(unit: str, off: float, span: float, size: float) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(name=axis, unit=unit, off=off, low=off - span, high=off + span, size=size, tolerance=0.05 * size,
                      prior=Prior("normal", off, 2.0 * size), source=source)
            for axis in AXES
        )  # fmt: skip

    mass = Parameter(
        name="mass", unit="kg", off=0.0, low=-0.8 * body.mass, size=0.05 * body.mass,
        high=4.0 * max(body.mass, body.force / WEIGHT) * min(body.room, MASSES),
        tolerance=0.0025 * body.mass, prior=Prior("normal", 0.0, 0.1 * body.mass), source=source,
    )  # fmt: skip
    moments = tuple(
        Parameter(name=axis, unit="", off=1.0, low=0.2, high=5.0, size=0.1, tolerance=0.05,
                  prior=Prior("normal", 1.0, 0.2), source=source)
        for axis in AXES
    )  # fmt: skip
    damping, windy, twisted = body.force / body.speed, *(2.0 * body.room * each for each in (body.force, body.torque))
    drag = tuple(
        Parameter(name=way, unit="N s/m", off=0.0, low=0.0, high=2.0 * damping * body.room, size=0.02 * damping,
                  tolerance=0.001 * damping, prior=Prior("halfnormal", 0.0, 0.05 * damping), source=source)
        for way in ("along", "across")
    )  # fmt: skip
    return (
        have("mass", "a wrong mass of", "m + mass", (mass,), ("wind",), "command", add_mass),
        have("com", "a wrong centre of mass of", "c + (x, y, z)",
            along_axes("m", 0.0, body.size, body.shift or 0.05 * body.size), ("twist",), "position",
            move_centre("xyz")),
        have("inertia", "a wrong inertia of", "I times (x, y, z)", moments, (), "command", apply_inertia,
            ("body_inertia",)),
        have("drag", "drag of the air on", "-(along v_z + across v_xy) in its axes", drag, ("wind",), "velocity",
            apply_drag),
        have("wind", "a steady force on", "+(x, y, z) in the world's axes",
            along_axes("N", 0.0, windy, 0.02 * body.force), ("mass", "drag"), "position", apply_wind),
        have("twist", "a steady torque on", "+(x, y, z) about its axes",
            along_axes("N m", 0.0, twisted, 0.02 * body.torque), ("com",), "position", apply_twist),
    )  # fmt: skip
