"""What gives: dry friction whose bristles bend before they slip, and an elastic mode on a joint."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Effect, Motion, Stage, State
from vpptwin.effects.joint import JOINT_SHOWS, Place
from vpptwin.effects.parameter import Parameter, Prior

STIFFEST = 4.0
"""Bristles stiffer than the inertia over so many squared steps count as that: a swing on them takes 12 steps."""
ELASTIC = 0.9
"""Share of the friction up to which bristles bend and do not slip."""
TINY = 1e-300
"""Stands for a deflection of zero, which would divide by zero [m, rad]."""
GIVE, GIVE_ROTARY = 5e-4, 1e-2
"""Deflection of the bristles under the typical force of a joint [m], [rad]."""


def apply_lugre(
    motion: Motion, forward: float, backward: float, /, deflection: float, dt: float, compliance: float
) -> tuple[float, float]:
    """Bristles that bend, and slip as they approach what the joint can muster, F(v): z/c + σ v [N, N m].

    ż = v up to 0.9 F c, from there v (1 - (z - 0.9 F c)/(0.1 F c)), exact at constant v: LuGre's law with an elastic
    range (Dupont and others), without which bristles creep under any load that trembles. Until they slip they are
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


def apply_elastic(
    motion: Motion, /, position: float, velocity: float, dt: float, share: float, frequency: float, zeta: float
) -> tuple[float, float, float]:
    """A mass on a spring and a damper that the joint drags along [N, N m]; stepped as the engine steps the joint."""
    rate = 2.0 * np.pi * frequency
    pull = rate * (rate * (motion.position - position) + 2.0 * zeta * (motion.velocity - velocity))
    faster = velocity + dt * pull
    return -share * motion.inertia * pull, position + dt * faster, faster


def lugre(
    place: Place, look_alikes: tuple[str, ...] = (), modifies: tuple[str, ...] = ("coulomb", "stiction"),
    needs: tuple[str, ...] = (),
) -> Effect:  # fmt: skip
    """Dry friction of a joint that gives before it slips (the LuGre model). Without such friction it does nothing."""
    length, unit, give = ("rad", "N m", GIVE_ROTARY) if place.rotary else ("m", "N", GIVE)
    size = give / place.scale
    parameter = Parameter(
        name="compliance", unit=f"{length}/({unit})" if place.rotary else f"{length}/{unit}", off=0.0, low=0.0,
        high=10.0 * size * place.room, prior=Prior("halfnormal", 0.0, 0.5 * size), size=size, tolerance=0.1 * size,
        source="assumption: gives 0.5 mm (10 mrad) under the typical force",
    )  # fmt: skip
    return Effect(
        id=f"{place.joint}.lugre",
        summary=f"dry friction {place.where} that gives before it slips",
        equation="-(z/compliance + σ v), dz/dt = v up to 0.9 F compliance, from there ever less and σ = 0",
        parameters=(parameter,), stage=Stage.SLIP, apply=apply_lugre, shows=JOINT_SHOWS, look_alikes=look_alikes,
        target=place.joint, needs=needs, modifies=tuple(f"{place.joint}.{kind}" for kind in modifies),
        states=(State("deflection", length),),
    )  # fmt: skip


def elastic(place: Place, look_alikes: tuple[str, ...] = (), needs: tuple[str, ...] = ()) -> Effect:
    """An elastic mode on a slider: a share of what it carries, besides that, on a spring and a damper."""
    return Effect(
        id=f"{place.joint}.elastic",
        summary=f"an elastic mode {place.where}",
        equation="share M (ω² (s - q) + 2 zeta ω d(s - q)/dt), ω = 2π frequency",
        parameters=(
            Parameter(
                name="share", unit="", off=0.0, low=0.0, high=0.5, prior=Prior("halfnormal", 0.0, 0.05), size=0.05,
                tolerance=0.005, source="assumption: some 5 % of what it carries",
            ),
            Parameter(
                name="frequency", unit="Hz", off=8.0, low=2.0, high=40.0, prior=Prior("normal", 8.0, 2.0), size=0.5,
                tolerance=40.0, source="assumption: a frame of profiles and boards, 4 to 12 Hz",
            ),
            Parameter(
                name="zeta", unit="", off=0.03, low=0.0, high=0.3, prior=Prior("normal", 0.03, 0.01), size=0.02,
                tolerance=0.3, source="assumption: bolted metal, 1 to 5 % of critical",
            ),
        ),
        stage=Stage.FORCE,
        apply=apply_elastic,
        shows=JOINT_SHOWS,
        look_alikes=look_alikes,
        target=place.joint,
        needs=needs,
        follows="command",
        states=(State("position", "m", "position"), State("velocity", "m/s", "velocity")),
    )  # fmt: skip
