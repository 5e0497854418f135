"""In which unit or scale efforts were logged, told by the motion that they made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vpptwin.estimation.checks.orientation import MIN_SAMPLES
from vpptwin.estimation.dynamics import Forces, find_driven_joint, measure_forces
from vpptwin.estimation.series import Measurements
from vpptwin.system.doubt import object_to
from vpptwin.system.errors import InputError
from vpptwin.system.fields import UNITS, SignalEntry
from vpptwin.twin.robot.actuation import JOINT, tell_control
from vpptwin.twin.robot.manifold import BALL, FREE
from vpptwin.twin.robot.model import find_free
from vpptwin.twin.spec import TwinSpec

FAR = 3.3
"""Factor from which on a force is in another unit: `gain` reaches to 3, and no drive has less than a third of it."""
BESIDE, LIKE, ALIKE, SAME = 0.9, 0.96, 0.99, 0.999
"""Correlation with the force that motion asks for from which on a factor above 1 tells beside another one, by itself,
one below 1 that is a unit's, and those of all actuators together."""
GROSS, SOMEHOW = 15.0, 0.6
"""Factor from which on no drive is that strong, and correlation that is enough if all actuators have one."""
EXCITED, AGREE = 0.05, 0.3
"""Share of that force that either part of it, inertia and the rest, must have to tell the factor by itself; by how
much both may differ."""
UNIT, NEAR, BEYOND = 0.03, 0.25, 50.0
"""How near a factor comes to that of a unit, and where no load or rotor explains it: those below 1 over the last."""


@dataclass(frozen=True)
class EffortScale:
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

    def is_clear(self, likeness: float = LIKE) -> bool:
        """Whether no load and no rotor that the MJCF lacks would make such a factor."""
        if abs(self.factor) > 1.0:
            return self.likeness > likeness
        beyond = abs(self.factor) < 1.0 / BEYOND
        if beyond and self.agree:
            return self.likeness > (BESIDE if self.unit else ALIKE)
        return bool(self.unit) and (beyond or self.agree) and self.likeness > ALIKE

    def __str__(self) -> str:
        """The factor in words."""
        kind = "torque" if self.rotary else "force"
        looks = self.unit or (f"current, or like {kind} before a gear" if abs(self.factor) > 1.0 else "another unit")
        return (
            f"the effort of {self.actuator} looks like {looks}: {kind} is {self.factor:.3g} times it "
            f"(r = {np.floor(self.likeness * 1e4) / 1e4:.4f})"
        )


def judge_efforts(spec: TwinSpec, measurements: Sequence[Measurements]) -> list[EffortScale]:
    """Efforts that are in another unit than the force that motion asks for, beyond what a drive may be wrong by.

    Gravity, inertia and friction are those of the MJCF; more friction is no reason. A smaller factor may be a load or
    a rotor that the MJCF lacks, unless it is that of a unit, or so small, or all of them say so.
    """
    actuators = {name: spec.model.actuator(name).id for name in spec.robot.signals.actuators}
    pushing = {name: i for name, i in actuators.items() if tell_control(spec.model, i) == "effort"}
    dofs = {name: find_own_dof(spec, i) for name, i in pushing.items()}
    driving = {name: dof for name, dof in dofs.items() if dof is not None}
    rotors = [name for name, i in pushing.items() if find_driven_joint(spec.model, i) is None]
    if not (driving or rotors) or spec.model.neq:
        return []
    forces = measure_forces(spec, measurements)
    scales = [fit_scale(spec, forces, name, dof) for name, dof in driving.items()]
    scales += fit_thrust(spec, forces, rotors)
    far = [each for each in scales if each is not None and not 1.0 / FAR < abs(each.factor) < FAR]
    alike = len(far) == len(scales) > 1 and all(each.agree and each.likeness > SAME for each in far)
    alike |= len(far) == len(scales) and all(each.factor > GROSS and each.likeness > SOMEHOW for each in far)
    more = any(abs(each.factor) > 1.0 and each.is_clear() for each in far)
    return [each for each in far if alike or each.is_clear(BESIDE if more else LIKE)]


def find_own_dof(spec: TwinSpec, actuator: int) -> int | None:
    """Degree of freedom of the simulated hinge or slide that an actuator drives, and no other does."""
    model, joint = spec.model, find_driven_joint(spec.model, actuator)
    if joint is None or model.jnt_type[joint] in (FREE, BALL) or model.jnt_dofadr[joint] in spec.robot.driven:
        return None
    others = [i for i in range(model.nu) if i != actuator]
    shared = any(model.actuator_trntype[i] != JOINT or model.actuator_trnid[i, 0] == joint for i in others)
    return None if shared else int(model.jnt_dofadr[joint])


def fit_thrust(spec: TwinSpec, forces: Forces, rotors: Sequence[str]) -> list[EffortScale]:
    """Of the actuators that push the one free body along its way, the weight that they bear included: one factor."""
    joints = find_free(spec.model)
    if not rotors or len(joints) != 1 or len(forces.time) < MIN_SAMPLES:
        return []
    along = slice(int(spec.model.jnt_dofadr[joints[0]]), int(spec.model.jnt_dofadr[joints[0]]) + 3)
    given = forces.actuator[:, along]
    required = forces.missing[:, along] + given
    sizes = float(np.linalg.norm(given)), float(np.linalg.norm(required))
    if min(sizes) <= 0.0:
        return []
    likeness = float((given * required).sum()) / (sizes[0] * sizes[1])
    factor = float(np.sign(likeness)) * sizes[1] / sizes[0]
    return [describe_effort(spec, name, factor, likeness, False, False) for name in rotors]


def describe_effort(
    spec: TwinSpec, actuator: str, factor: float, likeness: float, agree: bool, rotary: bool
) -> EffortScale:  # fmt: skip
    """The scale of an actuator's effort, with what the twin says of it."""
    topic = spec.robot.signals.actuators[actuator]
    entry = spec.robot.signals.entries.get(topic, {}).get(actuator)
    return EffortScale(actuator, topic, factor, abs(likeness), agree, rotary, entry)


def fit_scale(spec: TwinSpec, forces: Forces, actuator: str, dof: int) -> EffortScale | None:
    """By least squares with friction and an offset beside; None where too little moves, or nothing was asked for."""
    given, inertial = forces.actuator[:, dof], forces.inertial[:, dof]
    required, rate = forces.missing[:, dof] + given, forces.velocity[:, dof]
    if len(given) < MIN_SAMPLES or not np.ptp(given) or not np.ptp(required):
        return None
    # Offset, viscous and smoothed Coulomb friction.
    beside = np.column_stack([np.ones(len(rate)), rate, np.tanh(rate / (0.05 * max(float(rate.std()), 1e-9)))])

    def take_out(column: np.ndarray) -> np.ndarray:
        return np.asarray(column - beside @ np.linalg.lstsq(beside, column, rcond=None)[0])

    effort, force = take_out(given), take_out(required)
    parts = np.column_stack([take_out(inertial), take_out(required - inertial)])
    sizes = float(np.std(effort)), float(np.std(force))
    if min(sizes) <= 0.0:
        return None
    likeness = float(np.corrcoef(effort, force)[0, 1])
    shares = np.linalg.lstsq(parts, effort, rcond=None)[0]
    excited = bool((parts.std(axis=0) > EXCITED * sizes[1]).all())
    agree = excited and bool(np.abs(shares * sizes[1] / sizes[0] - np.sign(likeness)).max() < AGREE)
    factor = float(np.sign(likeness)) * sizes[1] / sizes[0]
    return describe_effort(spec, actuator, factor, likeness, agree, bool(spec.robot.rotary[dof]))


def join_equal(far: Sequence[EffortScale]) -> list[EffortScale]:
    """Those with one factor as one, whose actuator is all of their names."""
    names = dict[str, list[str]]()
    for each in far:
        names.setdefault(f"{each.factor:.3g}", []).append(each.actuator)
    first = {f"{each.factor:.3g}": each for each in reversed(far)}
    return [replace(first[key], actuator=", ".join(named)) for key, named in names.items()]


def list_scales(far: Sequence[EffortScale]) -> str:
    """The `scale` of each, in words."""
    return " and ".join(f"`scale: {each.scale:.4g}` for {each.actuator}" for each in far)


def refuse_efforts(spec: TwinSpec, measurements: Sequence[Measurements]) -> None:
    """Refuse logs whose efforts are no forces: whatever was found would answer for that.

    Raises:
        InputError: with the factor of each, and the `scale` to give.
    """
    far = judge_efforts(spec, measurements)
    if far:
        kind, given = " and ".join(dict.fromkeys("N m" if each.rotary else "N" for each in far)), list_scales(far)
        object_to(InputError(
            f"{measurements[0].name}: {', '.join(map(str, join_equal(far)))}",
            f"{kind} in every log, or a model as heavy as the rig",
            f"give {given} in the twin's signals ({far[0].example})",
        ))  # fmt: skip
