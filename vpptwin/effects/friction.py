"""Dry friction of any joint: sliding friction, breakaway, load, direction, a tight spot, bristles that give.

Each law but `lugre` raises or scales the level that the joint can muster against its motion;
`vpptwin.twin.stepping.friction` makes it stick. A new law goes here: a function, its `JointLaw`, and its name in
`catalogue.GENERIC_JOINT`. Read first: Armstrong-Hélouvry, Dupont and Canudas de Wit, Automatica 30 (1994).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vpptwin.effects.base import Motion, Stage, State
from vpptwin.effects.joint import JointLaw, JointScale
from vpptwin.effects.parameter import Parameter, Prior

BREAKAWAY = 0.25
"""Share of its friction by which a well-built joint's breakaway exceeds it."""
STIFFEST = 4.0
"""Bristles stiffer than the inertia over so many squared steps count as that: a swing on them takes 12 steps."""
ELASTIC = 0.9
"""Share of the friction up to which bristles bend and do not slip."""
TINY = 1e-300
"""Stands for a deflection of zero, which would divide by zero [m, rad]."""
GIVE, GIVE_ROTARY = 5e-4, 1e-2
"""Deflection of the bristles under the typical force of a joint [m], [rad]."""


def apply_coulomb(level: float, motion: Motion, /, force: float) -> float:
    """Dry friction -F sgn(v), the same at any speed [N, N m] (Coulomb)."""
    return level + force


coulomb = JointLaw(
    "coulomb", "dry friction {where}", "-{force} sgn(v)", Stage.FRICTION, apply_coulomb,
    lambda place: (
        place.parameter("torque" if place.rotary else "force", place.effort, 0.0, 2.0, Prior("halfnormal", 0.0, 0.3)),
    ),
    ("viscous", "stiction", "load", "tight_spot"), dissipative=True,
)  # fmt: skip


def apply_stiction(level: float, motion: Motion, /, force: float, velocity: float) -> float:
    """Breakaway exceeds sliding friction by `force` [N, N m], which fades out around `velocity` [m/s, rad/s]."""
    # F_c + (F_s - F_c) exp(-(v/v_s)²): Stribeck's curve as Armstrong-Hélouvry and others (1994) have it.
    ratio = motion.velocity / velocity
    return level + force * np.exp(-ratio * ratio)


def list_stiction(place: JointScale) -> tuple[Parameter, ...]:
    """Breakaway beyond sliding friction, and the speed at which it is over."""
    typical = 0.2 if place.rotary else 0.05
    force = place.parameter("force", place.effort, 0.0, 2.0, Prior("halfnormal", 0.0, 0.1))
    return (
        replace(force, tolerance=BREAKAWAY * force.tolerance),
        Parameter(name="velocity", unit=f"{place.length}/s", off=typical, low=0.1 * typical / place.room,
                  high=10.0 * typical * place.room, prior=Prior("normal", typical, 0.2 * typical), size=0.4 * typical,
                  tolerance=10.0 * typical, source="assumption: breakaway is over at a slow creep"),
    )  # fmt: skip


stiction = JointLaw(
    "stiction", "breakaway friction {where}", "-(F_c + force exp(-(v/velocity)²)) sgn(v)", Stage.FRICTION,
    apply_stiction, list_stiction, ("coulomb",), dissipative=True,
)  # fmt: skip


def apply_load(level: float, motion: Motion, /, mu: float) -> float:
    """Gears, or guides, rub by a share of the force that goes through them [N, N m]: mu |N|."""
    return level + mu * np.abs(motion.load)


load = JointLaw(
    "load", "gear friction {where} that grows with the load", "-mu |actuators' force| sgn(v)",
    Stage.FRICTION, apply_load,
    lambda place: (
        Parameter(name="mu", unit="", off=0.0, low=0.0, high=0.9, prior=Prior("halfnormal", 0.0, 0.1), size=0.05,
                  tolerance=0.005, source="assumption: gears lose 5 to 30 %"),
    ),
    ("coulomb", "fade"), only="driven", dissipative=True, follows="command",
)  # fmt: skip


def apply_asymmetry(level: float, motion: Motion, /, fraction: float) -> float:
    """All dry friction of the joint is stronger in one direction than in the other, F (1 + fraction sgn(v))."""
    return level * (1.0 + fraction * motion.direction)


asymmetry = JointLaw(
    "asymmetry", "dry friction {where} that depends on the direction", "F × (1 + fraction sgn(v))", Stage.FRICTION,
    apply_asymmetry,
    lambda place: (
        Parameter(name="fraction", unit="", off=0.0, low=-0.9, high=0.9, prior=Prior("normal", 0.0, 0.05), size=0.1,
                  tolerance=0.02, source="assumption: wipers and seals, some 5 % to either side"),
    ),
    modifies=("coulomb",),
)  # fmt: skip
"""It follows the joint's other dry friction, which it scales."""


def apply_tight_spot(level: float, motion: Motion, /, force: float, place: float, width: float) -> float:
    """More dry friction [N, N m] around a place [m, rad], force exp(-((q - place)/width)²)."""
    ratio = (motion.position - place) / width
    return level + force * np.exp(-ratio * ratio)


def list_tight_spot(place: JointScale) -> tuple[Parameter, ...]:
    """Strength of a tight spot, anywhere that the joint gets to, and its width."""
    reach, at, room = place.reach, place.middle, place.room
    return (
        place.parameter("force", place.effort, 0.0, 5.0, Prior("halfnormal", 0.0, 0.1)),
        Parameter(name="place", unit=place.length, off=at, low=at - 2.0 * reach * room, high=at + 2.0 * reach * room,
                  prior=Prior("normal", at, 0.5 * reach), size=0.05 * reach, tolerance=2.0 * reach,
                  source="assumption: anywhere, most likely halfway along"),
        Parameter(name="width", unit=place.length, off=0.1 * reach, low=0.02 * reach / room, high=0.5 * reach * room,
                  prior=Prior("normal", 0.1 * reach, 0.02 * reach), size=0.03 * reach, tolerance=0.5 * reach,
                  source="assumption: a tenth of half the travel"),
    )  # fmt: skip


tight_spot = JointLaw(
    "tight_spot", "a tight spot {where}", "-force exp(-((q - place)/width)²) sgn(v)", Stage.FRICTION, apply_tight_spot,
    list_tight_spot, ("coulomb",), dissipative=True, follows="position", placed=True,
)  # fmt: skip


def apply_lugre(
    motion: Motion, forward: float, backward: float, /, deflection: float, dt: float, compliance: float
) -> tuple[float, float]:
    """Bristles that bend, and slip as they approach what the joint can muster, F(v): z/c + σ v [N, N m].

    ż = v up to 0.9 F c, from there v (1 - (z - 0.9 F c)/(0.1 F c)), exact at constant v: LuGre's law (Canudas
    de Wit, Olsson, Åström and Lischinsky, IEEE TAC 40, 1995) with an elastic range (Dupont, Hayward, Armstrong and
    Altpeter, IEEE TAC 47, 2002), without which bristles creep under any load that trembles. Until they slip they are
    damped, critically for the inertia M on them: σ = 2 √(M/c). If they were as they slip, a load that friction itself
    changes would rattle. Damping raises no force above F, so that a joint reverses without a jolt.
    """
    soft = np.maximum(compliance, STIFFEST * dt * dt / motion.inertia)
    most = soft * ((motion.velocity > 0.0) * forward + (motion.velocity < 0.0) * backward)
    sense, way = np.sign(motion.velocity), np.abs(motion.velocity) * dt
    freely = np.minimum(np.maximum(ELASTIC * most - sense * deflection, 0.0), way)
    slipping = np.expm1((freely - way) / np.maximum((1.0 - ELASTIC) * most, TINY))
    bent = deflection + sense * (freely + (sense * deflection + freely - most) * slipping)
    held = bent / soft
    wanted = held + 2.0 * np.sqrt(motion.inertia / soft) * sense * freely / dt
    return -np.minimum(np.maximum(wanted, np.minimum(held, -backward)), np.maximum(held, forward)), bent


def list_lugre(place: JointScale) -> tuple[Parameter, ...]:
    """How far bristles bend by a force."""
    size = (GIVE_ROTARY if place.rotary else GIVE) / place.scale
    return (
        Parameter(name="compliance", unit="rad/(N m)" if place.rotary else "m/N", off=0.0, low=0.0,
                  high=10.0 * size * place.room, prior=Prior("halfnormal", 0.0, 0.5 * size), size=size,
                  tolerance=0.1 * size, source="assumption: gives 0.5 mm (10 mrad) under the typical force"),
    )  # fmt: skip


lugre = JointLaw(
    "lugre", "presliding compliance {where}",
    "-(z/compliance + σ v), dz/dt = v up to 0.9 F compliance, from there ever less and σ = 0", Stage.SLIP, apply_lugre,
    list_lugre, modifies=("coulomb", "stiction"), states=(State("deflection", "{length}"),),
)  # fmt: skip
"""Without dry friction to act on it does nothing."""
