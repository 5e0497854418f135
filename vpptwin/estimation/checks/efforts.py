"""Whether logged efforts are forces: held against those that motion asks for, they may be currents or another unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vpptwin.estimation.dynamics import Forces, measure_forces
from vpptwin.estimation.series import Measurements
from vpptwin.system.errors import InputError
from vpptwin.system.fields import UNITS, SignalEntry
from vpptwin.twin.robot.actuation import JOINT, tell_control
from vpptwin.twin.robot.manifold import BALL, FREE
from vpptwin.twin.spec import TwinSpec

FAR = 3.3
"""Factor from which on a force is in another unit: `gain` reaches to 3, and no drive has less than a third of it."""
BESIDE, LIKE, ALIKE, SAME = 0.9, 0.96, 0.99, 0.999
"""Correlation with the force that motion asks for from which on a factor above 1 tells beside another one, by itself,
one below 1 that is a unit's, and those of all actuators together."""
EXCITED, AGREE = 0.05, 0.3
"""Share of that force that either part of it, inertia and the rest, must have to tell the factor by itself; by how
much both may differ."""
UNIT, NEAR, BEYOND = 0.03, 0.25, 50.0
"""How near a factor comes to that of a unit, and where no load or rotor explains it: those below 1 over the last."""
FEWEST = 50


@dataclass(frozen=True)
class Factor:
    """A force that motion asks for is so many times the logged effort.

    Attributes:
        actuator, topic: whose effort, and where it is.
        factor: force over effort.
        likeness: their correlation, friction taken out.
        agree: whether inertia and weight each tell that factor.
        rotary: whether it acts on a hinge.
        entry: of the twin's signals, where it is read from a field.
    """

    actuator: str
    topic: str
    factor: float
    likeness: float
    agree: bool
    rotary: bool
    entry: SignalEntry | None

    @property
    def unit(self) -> str:
        """The unit that the effort is in, where the factor is that of one; else ""."""
        kind = "N m" if self.rotary else "N"
        off = {u: abs(np.log(abs(self.factor) / size)) for u, (si, size) in UNITS.items() if si == kind and size != 1.0}
        nearest = min(off, key=lambda unit: off[unit])
        near = NEAR if self.agree and abs(self.factor) < 1.0 / BEYOND else UNIT
        return nearest if off[nearest] < near and self.factor > 0.0 else ""

    @property
    def scale(self) -> float:
        """The `scale` that the twin's signals must have for it, with that which they have."""
        had = self.entry.effort.scale if self.entry is not None and self.entry.effort is not None else 1.0
        size = UNITS[self.unit][1] if self.unit else self.factor
        return size * (had if isinstance(had, float) else 1.0)

    @property
    def example(self) -> str:
        """What stands in the twin's signals then."""
        had, field = self.entry, self.entry.effort if self.entry is not None else None
        topic, path = had.topic if had is not None else self.topic, field.path if field is not None else "effort"
        return f"{self.actuator}: {{topic: {topic}, effort: {{path: {path}, scale: {self.scale:.4g}}}}}"

    def tell(self) -> str:
        """The factor in words."""
        looks = self.unit or ("current" if abs(self.factor) > 1.0 else "another unit")
        kind = "torque" if self.rotary else "force"
        return (
            f"the effort of {self.actuator} looks like {looks}: {kind} is {self.factor:.3g} times it "
            f"(r = {np.floor(self.likeness * 1e4) / 1e4:.4f})"
        )


def judge_efforts(spec: TwinSpec, measurements: Sequence[Measurements]) -> list[Factor]:
    """Efforts that are in another unit than the force that motion asks for, beyond what a drive may be wrong by.

    Gravity, inertia and friction are those of the MJCF; more friction is no reason. A smaller factor may be a load or
    a rotor that the MJCF lacks, unless it is that of a unit, or so small, or all of them say so.
    """
    actuators = {name: spec.model.actuator(name).id for name in spec.robot.signals.actuators}
    driving = {name: find_own(spec, i) for name, i in actuators.items() if tell_control(spec.model, i) == "effort"}
    driving = {name: dof for name, dof in driving.items() if dof is not None}
    if not driving or spec.model.neq:
        return []
    forces = measure_forces(spec, measurements)
    found = [fit_factor(spec, forces, name, dof) for name, dof in driving.items() if dof is not None]
    told = [each for each in found if each is not None and not 1.0 / FAR < abs(each.factor) < FAR]
    alike = len(told) == len(driving) > 1 and all(each.agree and each.likeness > SAME for each in told)
    more = any(abs(each.factor) > 1.0 and is_clear(each) for each in told)
    return [each for each in told if alike or is_clear(each, BESIDE if more else LIKE)]


def is_clear(each: Factor, likeness: float = LIKE) -> bool:
    """Whether no load and no rotor that the MJCF lacks would make such a factor."""
    if abs(each.factor) > 1.0:
        return each.likeness > likeness
    beyond = abs(each.factor) < 1.0 / BEYOND
    if beyond and each.agree:
        return each.likeness > (BESIDE if each.unit else ALIKE)
    return bool(each.unit) and (beyond or each.agree) and each.likeness > ALIKE


def find_own(spec: TwinSpec, actuator: int) -> int | None:
    """Degree of freedom of the simulated hinge or slide that an actuator drives, and no other does."""
    model = spec.model
    if model.actuator_trntype[actuator] != JOINT:
        return None
    joint = int(model.actuator_trnid[actuator, 0])
    others = [i for i in range(model.nu) if i != actuator]
    shared = any(model.actuator_trntype[i] != JOINT or model.actuator_trnid[i, 0] == joint for i in others)
    dof = int(model.jnt_dofadr[joint])
    plain = model.jnt_type[joint] not in (FREE, BALL)
    return dof if plain and not shared and dof not in spec.robot.driven else None


def fit_factor(spec: TwinSpec, forces: Forces, actuator: str, dof: int) -> Factor | None:
    """By least squares with friction and an offset beside; None where too little moves, or nothing was asked for."""
    given, inertial = forces.actuator[:, dof], forces.inertial[:, dof]
    asked = forces.missing[:, dof] + given
    rate = forces.velocity[:, dof]
    if len(given) < FEWEST or not np.ptp(given) or not np.ptp(asked):
        return None
    beside = np.column_stack([np.ones(len(rate)), rate, np.tanh(rate / (0.05 * max(float(rate.std()), 1e-9)))])

    def clear(column: np.ndarray) -> np.ndarray:
        return np.asarray(column - beside @ np.linalg.lstsq(beside, column, rcond=None)[0])

    left, wanted, parts = clear(given), clear(asked), np.column_stack([clear(inertial), clear(asked - inertial)])
    sizes = float(np.std(left)), float(np.std(wanted))
    if min(sizes) <= 0.0:
        return None
    likeness = float(np.corrcoef(left, wanted)[0, 1])
    told = np.linalg.lstsq(parts, left, rcond=None)[0]
    excited = bool((parts.std(axis=0) > EXCITED * sizes[1]).all())
    agree = excited and bool(np.abs(told * sizes[1] / sizes[0] - np.sign(likeness)).max() < AGREE)
    signals = spec.robot.signals
    topic = signals.actuators[actuator]
    entry = signals.entries.get(topic, {}).get(actuator)
    factor = np.sign(likeness) * sizes[1] / sizes[0]
    return Factor(actuator, topic, float(factor), abs(likeness), agree, bool(spec.robot.rotary[dof]), entry)


def refuse_efforts(spec: TwinSpec, measurements: Sequence[Measurements]) -> None:
    """Refuse logs whose efforts are no forces: whatever was found would answer for that.

    Raises:
        InputError: with the factor of each, and the `scale` to give.
    """
    far = judge_efforts(spec, measurements)
    if far:
        kind = " and ".join(dict.fromkeys("N m" if each.rotary else "N" for each in far))
        given = " and ".join(f"`scale: {each.scale:.4g}` for {each.actuator}" for each in far)
        raise InputError(
            f"{measurements[0].name}: {', '.join(each.tell() for each in far)}",
            f"{kind} in every log, or a model as heavy as the rig",
            f"give {given} in the twin's signals ({far[0].example})",
        )
