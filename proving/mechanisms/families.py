"""The six families of rigs, each rig drawn: masses over three decades, lengths, drives, names."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from .rig import GRAVITY, Drive, Link, Rig, Vector

SWING: Vector = (0.0, -1.0, 0.0)
"""Axis of joints that turn in the vertical plane, positive from x to z."""


def spread(rng: np.random.Generator, low: float, high: float) -> float:
    """A number evenly drawn in its logarithm, three digits."""
    return float(f"{math.exp(rng.uniform(math.log(low), math.log(high))):.3g}")


def pick(rng: np.random.Generator, names: Sequence[str]) -> str:
    """One of these."""
    return str(rng.choice(np.array(names)))


def rate_drive(rng: np.random.Generator, name: str, joint: int, force: float, ratio: float = 1.0) -> Drive:
    """A drive of about that force [N, N m]: inputs of -1..1, in the force's own unit, or motor torque before a gear."""
    most = float(f"{force * rng.uniform(2.5, 5.0):.3g}")
    unit = ratio if ratio != 1.0 else (most if rng.random() < 0.5 else 1.0)
    return Drive(name, joint, unit, most / unit)


def draw_cart(rng: np.random.Generator, mass: float, settle: float | None, family: str) -> Rig:
    """A cart of that mass [kg] on a level rail; damped with a time constant `settle` [s], None for hardly."""
    travel, pace = spread(rng, 0.04, 0.8), spread(rng, 1.5, 6.0)
    typical = mass * travel * pace**2
    damping = mass / settle if settle else (0.02 * mass * pace if rng.random() < 0.4 else 0.0)
    dry = 0.05 * typical if settle is None and rng.random() < 0.25 else 0.0
    joint = pick(rng, ("slide", "rail", "carriage", "x_axis"))
    link = Link(
        joint, False, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), mass, (0.01 * mass,) * 3,
        damping=float(f"{damping:.3g}"), dry=float(f"{dry:.3g}"),
    )  # fmt: skip
    force = typical + link.damping * travel * pace
    drive = rate_drive(rng, pick(rng, ("motor", "linear_drive", "force")), 0, force)
    return Rig(family, (link,), (drive,), (travel,), pace)


def draw_carriage(rng: np.random.Generator) -> Rig:
    """A heavy carriage on a linear drive."""
    return draw_cart(rng, spread(rng, 5.0, 300.0), None, "carriage")


def draw_damped(rng: np.random.Generator) -> Rig:
    """A cart that is at rest within a fraction of a second when nothing drives it."""
    return draw_cart(rng, spread(rng, 0.3, 30.0), spread(rng, 0.04, 0.3), "damped cart")


def draw_bob(rng: np.random.Generator, mass: float, length: float) -> tuple[Vector, Vector]:
    """Centre of mass [m] on a link of that length hanging down, and its inertia about it [kg m²]."""
    com, gyration = length * rng.uniform(0.4, 0.95), length * rng.uniform(0.1, 0.3)
    across = float(f"{mass * gyration**2:.4g}")
    return (0.0, 0.0, -float(f"{com:.4g}")), (across, across, 0.1 * across)


def draw_pendulum(rng: np.random.Generator) -> Rig:
    """A pendulum that swings free: no actuator at all."""
    mass, length = spread(rng, 0.05, 20.0), spread(rng, 0.15, 1.2)
    com, inertia = draw_bob(rng, mass, length)
    about = inertia[1] + mass * com[2] ** 2
    pace = math.sqrt(mass * GRAVITY * -com[2] / about)
    damping = 0.004 * about * pace if rng.random() < 0.3 else 0.0
    link = Link(
        pick(rng, ("swing", "pivot", "pendulum")), True, SWING, (0.0, 0.0, 0.0), com, mass, inertia,
        damping=float(f"{damping:.3g}"),
    )  # fmt: skip
    return Rig("pendulum", (link,), (), (rng.uniform(0.4, 2.4),), pace)


def draw_cartpole(rng: np.random.Generator) -> Rig:
    """A cart with a pole that hangs from it, or stands on it."""
    mass, length = spread(rng, 0.2, 20.0), spread(rng, 0.2, 1.2)
    bob = mass * rng.uniform(0.1, 0.5)
    com, inertia = draw_bob(rng, bob, length)
    up = rng.random() < 0.5
    pace = math.sqrt(GRAVITY / length) * rng.uniform(0.4, 0.9)
    travel = float(length * rng.uniform(0.15, 0.4) * (0.6 if up else 1.0))
    cart = Link(
        pick(rng, ("cart", "slider", "base")), False, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0),
        float(f"{mass:.3g}"), (0.01 * mass,) * 3,
    )  # fmt: skip
    standing = (0.0, 0.0, -com[2]) if up else com
    pole = Link(pick(rng, ("pole", "rod", "hinge")), True, SWING, (0.0, 0.0, 0.0), standing, bob, inertia)
    force = (mass + bob) * max(travel * pace**2, 0.05 * GRAVITY)
    drive = rate_drive(rng, pick(rng, ("motor", "drive", "belt")), 0, 3.0 * force)
    return Rig("cart-pole", (cart, pole), (drive,), (travel, 0.1 if up else 0.5), pace)


def draw_double_pendulum(rng: np.random.Generator) -> Rig:
    """Two links hanging from each other, motors at both pivots whose rotors' inertia counts."""
    mass, length = spread(rng, 0.1, 10.0), spread(rng, 0.15, 0.8)
    share, ratio = rng.uniform(0.3, 1.0), rng.uniform(0.6, 1.2)
    lower, below = mass * share, float(f"{length * ratio:.3g}")
    links, names = [], pick(rng, ("shoulder elbow", "joint1 joint2", "upper lower")).split()
    for name, m, reach, place in ((names[0], mass, length, 0.0), (names[1], lower, below, -length)):
        com, inertia = draw_bob(rng, m, reach)
        armature = float(f"{(inertia[1] + m * com[2] ** 2) * rng.uniform(0.05, 0.6):.3g}")
        links.append(Link(name, True, SWING, (0.0, 0.0, place), com, float(f"{m:.4g}"), inertia, armature))
    weights = ((mass + lower) * length * GRAVITY, lower * below * GRAVITY)
    gears = (1.0, 1.0) if rng.random() < 0.6 else (rng.integers(4, 20), rng.integers(4, 20))
    drives = tuple(
        rate_drive(rng, f"motor_{n}", i, w, float(g)) for i, (n, w, g) in enumerate(zip(names, weights, gears))
    )
    pace = math.sqrt(GRAVITY / (length + below)) * rng.uniform(0.4, 1.2)
    return Rig("double pendulum", tuple(links), drives, (rng.uniform(0.4, 1.4), rng.uniform(0.4, 1.2)), pace)


def draw_arm(rng: np.random.Generator) -> Rig:
    """Six joints: yaw, shoulder, elbow, and a wrist of three; reach 0.25 to 1.3 m, its mass going with that."""
    reach = spread(rng, 0.25, 1.3)
    mass = 9.0 * reach**2.2 * rng.uniform(0.6, 1.6)
    axes: tuple[Vector, ...] = (
        (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0),
    )  # fmt: skip
    lengths = reach * np.array([0.18, 0.44, 0.38, 0.10, 0.09, 0.07]) * rng.uniform(0.9, 1.1, 6)
    masses = mass * np.array([1.0, 0.9, 0.5, 0.2, 0.18, 0.1]) * rng.uniform(0.8, 1.2, 6)
    along = (2, 0, 0, 0, 0, 0)  # the base points up, everything else forward
    form = pick(rng, ("joint_{}", "j{}", "axis{}"))
    links, place = [], (0.0, 0.0, 0.0)
    ahead = np.cumsum(masses[::-1])[::-1]
    for i in range(6):
        end = np.zeros(3)
        end[along[i]] = lengths[i]
        com = 0.5 * end + lengths[i] * rng.uniform(-0.06, 0.06, 3)
        across, thick = masses[i] * lengths[i] ** 2 * 0.09, masses[i] * lengths[i] ** 2 * 0.03
        inertia = tuple(float(f"{thick if k == along[i] else across:.4g}") for k in range(3))
        carried = ahead[i] * (0.6 * lengths[i:].sum()) ** 2
        links.append(
            Link(
                form.format(i + 1), True, axes[i], place, tuple(float(f"{c:.4g}") for c in com),
                float(f"{masses[i]:.4g}"), inertia, float(f"{carried * rng.uniform(0.15, 0.7):.3g}"),
            )
        )  # fmt: skip
        place = tuple(float(f"{e:.4g}") for e in end)
    ratio = float(rng.integers(30, 160)) if rng.random() < 0.4 else 1.0
    drives = tuple(
        Drive(f"torque_{i + 1}", i, ratio, 5.0 * ahead[i] * GRAVITY * lengths[i:].sum() / ratio) for i in range(6)
    )
    return Rig("arm", tuple(links), drives, tuple(rng.uniform(0.3, 0.9, 6)), spread(rng, 1.2, 3.0))


FAMILIES: dict[str, Callable[[np.random.Generator], Rig]] = {
    "carriage": draw_carriage,
    "damped cart": draw_damped,
    "pendulum": draw_pendulum,
    "cart-pole": draw_cartpole,
    "double pendulum": draw_double_pendulum,
    "arm": draw_arm,
}
