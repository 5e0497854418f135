"""Where along a joint an effect acts: looked for by inverse dynamics along the logs, before anything is fitted.

A tight spot may be anywhere, cogging of any pitch: tried one after the other in the twin, places on every joint would
take longer than all the rest. The force that motion lacks at each position costs nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.effects import Effect, Parameter, Stage
from vpptwin.effects.base import Motion
from vpptwin.estimation.dynamics import Forces, measure_forces
from vpptwin.twin.robot.manifold import chart
from vpptwin.twin.spec import TwinSpec

FINEST, WIDTHS = 240, 3
"""Places, or pitches, that are tried at most; widths."""
PHASES = 6
WILD = 4.0
"""Missing forces beyond so many times their median size are cut: an acceleration is a difference of noisy ones."""
CHOSEN = 2
"""Places that go on, which are not next to each other."""


def find_places(bench: Bench, effects: Sequence[Effect]) -> dict[str, list[dict[str, float]]]:
    """Effect → parameters with which it makes up most of the force that is missing, the best place first."""
    if not effects or not bench.flights:
        return {}
    forces = measure_forces(bench.spec, bench.flights)
    return {effect.id: look_along(bench.spec, forces, effect) for effect in effects}


def look_along(spec: TwinSpec, forces: Forces, effect: Effect) -> list[dict[str, float]]:
    """The best places of one effect on a joint, and how strong it would be there."""
    strength, *shapes = effect.parameters
    dof = spec.robot.locate(effect).dof
    left, known = explain(spec, forces, dof)
    columns: Any = (
        chart(spec.model, forces.pose)[:, dof], forces.velocity[:, dof], np.sign(forces.velocity[:, dof]),
        forces.actuator[:, dof], 0.0, 1.0,
    )  # fmt: skip
    moves = Motion(*columns)
    tried = np.array(list(product(*(list_values(shape) for shape in shapes))))
    made = np.array([make_force(effect, moves, strength.size, shape) for shape in tried])
    made -= made @ known @ known.T  # what the rest of the joint's laws can do as well
    size = np.maximum((made**2).sum(axis=1), 1e-300)
    along = made @ left
    gain = np.where((along > 0.0) & (size > 1e-9 * len(left) * strength.size**2), along**2 / size, 0.0)
    found: list[dict[str, float]] = []
    for i in np.argsort(-gain):
        if gain[i] <= 0.0 or len(found) == CHOSEN:
            break
        values = {shape.name: float(value) for shape, value in zip(shapes, tried[i])}
        if all(abs(values[shapes[0].name] - other[shapes[0].name]) > 4.0 * shapes[0].size for other in found):
            amplitude = strength.clip(np.array(strength.off + along[i] / size[i] * strength.size))
            found.append({strength.name: float(amplitude), **values})
    return found


def explain(spec: TwinSpec, forces: Forces, dof: int) -> tuple[np.ndarray, np.ndarray]:
    """Force missing at a joint, (n,), beyond what laws without a place explain; of those orthonormal columns (n, c)."""
    position, velocity = chart(spec.model, forces.pose)[:, dof], forces.velocity[:, dof]
    drive, sense = forces.actuator[:, dof], np.sign(velocity)
    # Not the inertial force: of what is driven it is all that is missing and the drive's, whatever is at work.
    columns = [np.ones_like(velocity), position, velocity, sense, sense * np.abs(drive), drive]
    columns += [np.sin(position), np.cos(position)] if spec.robot.rotary[dof] else []
    left, sizes = forces.missing[:, dof], np.linalg.norm(columns, axis=1)
    vectors, spread, _ = np.linalg.svd(np.stack([c / s for c, s in zip(columns, sizes) if s > 0.0], axis=1), False)
    known = vectors[:, spread > 1e-6 * spread[0]]
    for _ in range(2):
        rest = left - known @ (known.T @ left)
        most = WILD * float(np.median(np.abs(rest)))
        left = left - rest + np.clip(rest, -most, most)
    return left - known @ (known.T @ left), known


def make_force(effect: Effect, moves: Motion, size: float, shape: np.ndarray) -> np.ndarray:
    """Force of an effect of a size along the logs, (n,) [N, N m]."""
    if effect.stage is Stage.FRICTION:
        return np.asarray(-moves.direction * effect.apply(0.0 * moves.position, moves, size, *shape))
    return np.asarray(effect.apply(moves, size, *shape))


def list_values(shape: Parameter) -> np.ndarray:
    """Values of a place or a pitch, a typical size apart, at which a phase or a width is tried some times."""
    if shape.name == "phase":
        return np.arange(PHASES) * 2.0 * np.pi / PHASES
    if shape.name == "width":
        return np.geomspace(0.5, 2.0, WIDTHS) * shape.off
    count = int(np.clip((shape.high - shape.low) / (2.0 * shape.size), 2, FINEST))
    return np.linspace(shape.low, shape.high, count)
