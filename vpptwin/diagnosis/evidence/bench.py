"""The test bench of a diagnosis: many variations of the twin driven through the same windows, side by side."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import mujoco
import numpy as np

from vpptwin.actuators.layer import SUPPLY
from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.channels import Channel, predict_channel
from vpptwin.diagnosis.evidence.motor import CURRENT, SPEED, predict_motor
from vpptwin.effects import Stage
from vpptwin.estimation.correct import correct_measurements, is_perfect
from vpptwin.estimation.initial import estimate_states
from vpptwin.estimation.measurements import Measurements
from vpptwin.estimation.windows import Motion, Windows, fly_windows, trace_past
from vpptwin.twin.manifold import conjugate, find_place, turn_to_world
from vpptwin.twin.recall import Past, evolves
from vpptwin.twin.sensors import PERFECT, Constants, body_force
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.twin import Twin

ROWS = 4096
"""Simulations that run side by side: enough to keep the engine busy, few enough to stay in memory."""
TWINS, MOTIONS = 32, 4
"""Twins, those used last, and motions of one variation, those simulated last, that a bench keeps."""
ASTRAY, FARTHEST = 1e4, 1e8
"""Noises by which a simulation that diverged is taken to miss, and by which any can: squares must not overflow."""
FAR, UNSEEN = 8.0, 1e4
"""Typical sizes beyond which an effect changes what others do, and beyond which it is a limit that nothing reaches."""
Key = tuple[str, str]
"""Effect id and parameter name."""
Name = TypeVar("Name")
Found = TypeVar("Found")
MakeTwin = Callable[[TwinSpec, int, Iterable[str]], Twin]
"""Makes the simulations that a bench drives, of a twin, their number, and the effects that are switched on."""


@dataclass(frozen=True)
class Variation:
    """How one run through a window differs from the plain twin.

    Attributes:
        values: (effect id, parameter) → value.
        pose: by which the starting pose is moved along its tangent, (nv,).
        velocity: added to the starting velocity, (nv,).
        push: (segment, degree of freedom, N or N m) of a force pulse; None for none.
    """

    values: Mapping[Key, float] = field(default_factory=dict)
    pose: np.ndarray | None = None
    velocity: np.ndarray | None = None
    push: tuple[int, int, float] | None = None


@dataclass(frozen=True)
class Track:
    """What every simulation of K windows starts from and feels beside what its variation says.

    Attributes:
        pose: by which starting poses are moved along their tangents, (K, nv).
        velocity: added to starting velocities, (K, nv).
        push: force pulses, (K, segments, nv) N or N m.
    """

    pose: np.ndarray
    velocity: np.ndarray
    push: np.ndarray

    def of(self, starts: np.ndarray, pushes: np.ndarray) -> Track:
        """The starts of some degrees of freedom, (nv,), and the pulses of some, (nv,)."""
        return Track(self.pose * starts, self.velocity * starts, self.push * pushes)


def resist_turning(twin: Twin) -> np.ndarray:
    """How hard every simulation's bodies are to turn, as a share of nominal, (N, nv); 1 for what does not turn.

    A track's pulses turn a body as they turned the nominal one, whatever its inertia: if they did not, a craft that has
    less of everything, thrust too, would fly the same under weaker gusts, and be likelier for that alone.
    """
    model, moments = twin.spec.model, twin.table.get("body_inertia")
    found = np.ones((twin.num_sims, model.nv))
    if moments is None:
        return found
    for dof in np.flatnonzero(twin.spec.robot.rotary):
        body, joint = model.dof_bodyid[dof], model.dof_jntid[dof]
        hinged = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        axis = model.jnt_axis[joint] if hinged else np.eye(3)[(dof - model.jnt_dofadr[joint]) % 3]
        share = turn_to_world(conjugate(model.body_iquat[body]), axis) ** 2
        found[:, dof] = moments[:, body] @ share / (model.body_inertia[body] @ share)
    return found


def keep_last(known: dict[Name, Found], name: Name, found: Found, most: int) -> Found:
    """What was found, put behind what is known under other names, of which the last `most` stay."""
    known[name] = found
    if len(known) > most:
        del known[next(iter(known))]
    return found


def pick(motion: Motion, run: int) -> Motion:
    """One run of many, arrays (K, steps + 1, ...)."""
    speed = motion.rotor_speed
    return Motion(motion.pose[run], motion.velocity[run], None if speed is None else speed[run])


class Bench:
    """Windows with their measurements, and a twin that can be driven through them in many variations at once.

    Args:
        spec: the twin.
        windows: K windows.
        channels: what was measured in them.
        segments: force pulses in a window.
        flights: the measurements that the windows were cut from, by their index; states at the start of the windows
            are estimated from them anew where sensors are found wrong.
        causal: those states are estimated without looking ahead.
        progress: called with the number of simulated steps as they are done.
        criteria: thresholds of the diagnosis that works on it.
        make_twin: makes what is driven through the windows, of a twin, a number of simulations, and effects.

    Attributes:
        track: about which all is simulated; None for states as estimated, and no force.
        followed: degrees of freedom whose starts, and those whose pulses, tracks of other twins follow, (nv,) each;
            None where all keep the track.
    """

    track: Track | None = None
    followed: tuple[np.ndarray, np.ndarray] | None = None

    def __init__(
        self, spec: TwinSpec, windows: Windows, channels: Sequence[Channel], segments: int,
        flights: Sequence[Measurements] = (), causal: bool = False, progress: Callable[[int], None] | None = None,
        criteria: Criteria = CRITERIA, make_twin: MakeTwin = Twin,
    ) -> None:  # fmt: skip
        self.spec, self.windows, self.channels, self.segments = spec, windows, list(channels), segments
        self.flights, self.causal = list(flights), causal
        self.criteria, self.make_twin = criteria, make_twin
        self._progress = progress
        self._twins: dict[tuple[int, frozenset[str]], Twin] = {}
        self._starts: dict[tuple[float, ...], Windows] = {}
        self._pasts: dict[tuple[float, ...], Past] = {}
        self._motions: dict[Hashable, tuple[Track | None, Motion]] = {}  # with its track, whose id is in the key
        self._gravity = -float(spec.model.opt.gravity[2])

    def about(self, track: Track | None) -> Bench:
        """The same bench, and what it has computed, about another track."""
        other = copy(self)
        other.track = track
        return other

    @cached_property
    def measured(self) -> np.ndarray:
        """All channels side by side, (K, C B)."""
        return np.concatenate([c.value for c in self.channels], axis=1)

    @cached_property
    def std(self) -> np.ndarray:
        """Sensor noise of `measured`, (K, C B); huge where nothing was measured."""
        return np.concatenate([c.std for c in self.channels], axis=1)

    @cached_property
    def valid(self) -> np.ndarray:
        """Where something was measured, (K, C B)."""
        return np.concatenate([c.weight.sum(axis=2) > 0 for c in self.channels], axis=1)

    @cached_property
    def columns(self) -> list[slice]:
        """Where every channel lies in a row of `measured`."""
        ends = np.cumsum([c.value.shape[1] for c in self.channels])
        return [slice(int(end) - c.value.shape[1], int(end)) for c, end in zip(self.channels, ends)]

    @cached_property
    def of_poses(self) -> np.ndarray:
        """Which columns are of positions and attitudes, (C B,) bool."""
        return np.concatenate([np.full(c.value.shape[1], c.kind == "position") for c in self.channels])

    def residual(self, values: Mapping[Key, float]) -> np.ndarray:
        """Measured less predicted by a twin with `values`, (K, C B); 0 where nothing was measured.

        What the track does is in the prediction; `Response.restore` takes it out again.
        """
        return self.miss(self.predict([Variation(dict(values))], values)[0])

    def miss(self, predicted: np.ndarray) -> np.ndarray:
        """Measured less predicted, (..., K, C B); 0 where nothing was measured, far off where the twin went astray."""
        missed = np.where(np.isfinite(predicted), self.measured - predicted, ASTRAY * self.std)
        return self.bound(missed)

    def bound(self, changed: np.ndarray) -> np.ndarray:
        """A change of what is measured, (..., K, C B), by `FARTHEST` at most; 0 where nothing was, or nothing known."""
        known = self.valid & np.isfinite(changed)
        return np.where(known, np.clip(changed, -FARTHEST * self.std, FARTHEST * self.std), 0.0)

    def predict(self, variations: Sequence[Variation], sensors_of: Mapping[Key, float] | None = None) -> np.ndarray:
        """The channels in every variation, (V, K, C B).

        Args:
            variations: how the runs differ. Those that differ in nothing but sensors share a simulation.
            sensors_of: the states that windows start from are those seen through the sensors of these values.
        """
        moving = [self.without_sensors(variation) for variation in variations]
        active = frozenset(effect for seen in moving for effect, _ in seen.values)
        where = id(self.track), active, frozenset((sensors_of or {}).items())
        place: list[Hashable] = []
        for seen in moving:
            shift = [None if a is None else a.tobytes() for a in (seen.pose, seen.velocity)]
            place.append((where, frozenset(seen.values.items()), *shift, seen.push))
        alike: dict[Hashable, list[int]] = {}
        for i, key in enumerate(place):
            alike.setdefault(key, []).append(i)
        found = np.empty((len(variations), *self.measured.shape))
        # A fit looks at a point before it asks for derivatives there.
        for key in alike.keys() & self._motions.keys():
            for i in alike[key]:
                found[i] = self._observe(variations[i], self._motions[key][1])
        new, most = [key for key in alike if key not in self._motions], max(ROWS // len(self.windows), 1)
        for some in (new[begin : begin + most] for begin in range(0, len(new), most)):
            motions = self.simulate([moving[alike[key][0]] for key in some], sensors_of, active)
            for run, key in enumerate(some):
                for i in alike[key]:
                    found[i] = self._observe(variations[i], pick(motions, run))
        if len(variations) == 1 and new:
            keep_last(self._motions, new[0], (self.track, pick(motions, 0)), MOTIONS)
        return found

    def without_sensors(self, variation: Variation) -> Variation:
        """The variation without what changes sensors only, which moves nothing."""
        moving = {key: value for key, value in variation.values.items() if key[0] not in self.of_sensors}
        return replace(variation, values=moving)

    @cached_property
    def of_sensors(self) -> frozenset[str]:
        """Ids of the effects that change what sensors show and nothing else."""
        return frozenset(e.id for e in self.spec.catalogue if e.writes and set(e.writes) <= set(PERFECT))

    @cached_property
    def _remembering(self) -> frozenset[str]:
        """Ids of the effects for which past inputs matter."""
        return frozenset(e.id for e in self.spec.catalogue if e.follows == "command change")

    @cached_property
    def _evolving(self) -> frozenset[str]:
        """Ids of the effects that begin a window as its past says; bristles do not where sensors are guessed."""
        return frozenset(
            e.id for e in self.spec.catalogue if evolves(e) and not (self.guessed and e.stage is Stage.SLIP)
        )

    @cached_property
    def without_dry_friction(self) -> dict[Key, float]:
        """Values that take dry friction out of the twin, where it has any: (effect id, parameter) → off value."""
        rubbing = [e for e in self.spec.catalogue if e.stage is Stage.FRICTION and e.id in self.spec.effects]
        return {(e.id, e.parameters[0].name): e.parameters[0].off for e in rubbing}

    @property
    def guessed(self) -> bool:
        """Whether sensors and disturbances of the rig are assumed, no logs without an effect being known of it."""
        return not self.spec.robot.disturbance.known

    def regime(self, values: Mapping[Key, float]) -> frozenset[tuple[str, int]]:
        """Which effects are so far from the twin's own that derivatives and responses there are others, and how far.

        Effect id and the binary logarithm of how many times `FAR` typical sizes it lies away.
        """
        found = set()
        for effect in self.spec.catalogue:
            strength = effect.parameters[0]
            away = abs(values.get((effect.id, strength.name), 0.0) - self.spec.value(effect, strength.name))
            if (effect.id, strength.name) in values and FAR * strength.size < away < strength.size * UNSEEN:
                found.add((effect.id, int(np.log2(away / (FAR * strength.size)))))
        return frozenset(found)

    def loosen(self, values: Mapping[Key, float]) -> dict[Key, float]:
        """Values of a twin like the one with `values`, but without dry friction: what sticks in a twin may yield."""
        rubbing = {e.id for e in self.spec.catalogue if e.stage in (Stage.FRICTION, Stage.SLIP)}
        far = {effect for effect, _ in self.regime(values)} - rubbing
        return self.without_dry_friction | {key: value for key, value in values.items() if key[0] in far}

    @cached_property
    def _observed(self) -> frozenset[str]:
        """Ids of the effects that change how motion shows in the channels."""
        shown = {*PERFECT, *SUPPLY}
        return frozenset(e.id for e in self.spec.catalogue if e.writes and set(e.writes) <= shown)

    def simulate(
        self, variations: Sequence[Variation], sensors_of: Mapping[Key, float] | None = None,
        active: frozenset[str] | None = None,
    ) -> Motion:  # fmt: skip
        """What happens in every variation, arrays (V, K, steps + 1, ...).

        Args:
            variations: how the runs differ.
            sensors_of: as `predict` has it.
            active: effects that are switched on; None for those that variations have values of.
        """
        count, number = len(variations), len(self.windows)
        model, times = self.spec.model, (count * number, self.windows.steps + 1)
        pose, velocity = np.empty((*times, model.nq)), np.empty((*times, model.nv))
        speed = np.empty((*times, 2)) if self.windows.throttle is not None else None
        active = frozenset(effect for v in variations for effect, _ in v.values) if active is None else active
        windows = self.windows_seen(sensors_of or {})
        for begin in range(0, count * number, ROWS):
            rows = np.arange(begin, min(begin + ROWS, count * number))
            part = self._simulate_rows(variations, windows, rows // number, rows % number, active, sensors_of or {})
            pose[rows], velocity[rows] = part.pose, part.velocity
            if speed is not None:
                speed[rows] = part.rotor_speed
            if self._progress is not None:
                self._progress(len(rows) * self.windows.steps)
        full = (count, number)
        return Motion(
            pose.reshape(*full, *pose.shape[1:]),
            velocity.reshape(*full, *velocity.shape[1:]),
            None if speed is None else speed.reshape(*full, *speed.shape[1:]),
        )

    def windows_seen(self, values: Mapping[Key, float]) -> Windows:
        """The windows with the states at their starts estimated through the sensors of a twin with `values`."""
        sensors = self.sensors(values)
        if is_perfect(sensors) or not self.flights:
            return self.windows
        key = self._key(sensors)
        if key not in self._starts:
            if len(self._starts) > 16:
                self._starts.clear()
            pose, velocity = self.windows.pose.copy(), self.windows.velocity.copy()
            for i in np.unique(self.windows.flight):
                rows = np.flatnonzero(self.windows.flight == i)
                right = correct_measurements(self.flights[i], sensors)
                start = self.windows.start[rows]
                pose[rows], velocity[rows] = estimate_states(right, start, self.spec.model, self.causal)
            self._starts[key] = replace(self.windows, pose=pose, velocity=velocity)
        return self._starts[key]

    @staticmethod
    def _key(sensors: Constants) -> tuple[float, ...]:
        return tuple(float(value) for name in PERFECT for value in sensors[name][0])

    def past_seen(self, values: Mapping[Key, float]) -> Past:
        """How the flights moved, through the sensors of a twin with `values`."""
        sensors = self.sensors(values)
        key = self._key(sensors)
        if key not in self._pasts:
            if len(self._pasts) > 4:
                self._pasts.clear()
            right = [correct_measurements(flight, sensors) for flight in self.flights]
            self._pasts[key] = trace_past(self.spec, right, self.windows, self.causal)
        return self._pasts[key]

    def _observe(self, variation: Variation, motion: Motion) -> np.ndarray:
        """All channels of one variation, (K, M)."""
        constants, force = self.sensors(variation.values), None
        if any(channel.kind == "specific force" for channel in self.channels):
            force = self._feel(motion)
        return np.concatenate([self.observe_channel(c, motion, constants, force) for c in self.channels], axis=1)

    def _feel(self, motion: Motion) -> np.ndarray:
        with np.errstate(invalid="ignore", over="ignore"):
            return body_force(motion.pose, motion.velocity, self.windows.dt, self._gravity)

    def observe_channel(
        self, channel: Channel, motion: Motion, constants: Constants, force: np.ndarray | None = None
    ) -> np.ndarray:
        """A channel as a simulation shows it, (K, B); arrays of `motion` (K, steps + 1, ...), `force` where known."""
        if channel.kind in (SPEED, CURRENT):
            assert motion.rotor_speed is not None
            return predict_motor(channel, self.windows, motion.rotor_speed, constants, self.spec.vehicle.motor)
        pose, velocity, start = motion.pose, motion.velocity, self.windows.start
        place = find_place(self.spec.model, channel.axis)
        with np.errstate(invalid="ignore", over="ignore"):  # what diverges is told by `miss`
            told = self.windows.dt, self._gravity, start, constants, place, force
            return predict_channel(channel, pose, velocity, *told)

    def sensors(self, values: Mapping[Key, float]) -> Constants:
        """Constants of the sensors and the battery of a twin with parameters set, (1,)."""
        return self.twin_with({key: v for key, v in values.items() if key[0] in self._observed}).constants.copy()

    def twin_with(self, values: Mapping[Key, float]) -> Twin:
        """One simulation of the twin with parameters set, for reading its constants."""
        twin = self._twin(1, frozenset(effect for effect, _ in values))
        for effect_id, effect in twin.effects.items():
            for parameter in effect.parameters:
                nominal = self.spec.value(effect, parameter.name)
                twin.set_parameter(effect_id, parameter.name, values.get((effect_id, parameter.name), nominal))
        return twin

    def _twin(self, rows: int, active: frozenset[str]) -> Twin:
        key = (rows, active)
        twin = self._twins.pop(key) if key in self._twins else self.make_twin(self.spec, rows, active)
        return keep_last(self._twins, key, twin, TWINS)

    def _simulate_rows(
        self, variations: Sequence[Variation], windows: Windows, which: np.ndarray, window: np.ndarray,
        active: frozenset[str], sensors_of: Mapping[Key, float],
    ) -> Motion:  # fmt: skip
        nv = self.spec.model.nv
        twin = self._twin(len(which), active)
        for effect_id in active:
            effect = twin.effects[effect_id]
            for parameter in effect.parameters:
                nominal = self.spec.value(effect, parameter.name)
                values = np.array([v.values.get((effect_id, parameter.name), nominal) for v in variations])
                twin.set_parameter(effect_id, parameter.name, values[which])
        if self.guessed and not (active | set(self.spec.effects)) & self._remembering:
            windows = replace(windows, warm=windows.warm[:, -1:])
        taken = windows.take(window)
        zero = np.zeros(nv)
        pose = np.stack([zero if v.pose is None else v.pose for v in variations])
        velocity = np.stack([zero if v.velocity is None else v.velocity for v in variations])
        disturbance, moved = None, (pose[which], velocity[which])
        if any(v.push is not None for v in variations):
            pushes = np.zeros((len(variations), self.segments, nv))
            for i, variation in enumerate(variations):
                if variation.push is not None:
                    segment, dof, size = variation.push
                    pushes[i, segment, dof] = size
            disturbance = pushes[which]
        if self.track is not None:
            moved = moved[0] + self.track.pose[window], moved[1] + self.track.velocity[window]
            pushed = self.track.push[window] + (0.0 if disturbance is None else disturbance)
            disturbance = pushed * resist_turning(twin)[:, None]
        shifted = taken.shift(self.spec.model, *moved)
        past = None
        if self.flights and not self._evolving.isdisjoint(twin.effects):
            _, row, run = np.unique(which, return_index=True, return_inverse=True)
            past = twin.recall_effects(self.past_seen(sensors_of), row)[run, window]
        with np.errstate(invalid="ignore", over="ignore"):  # what diverges is told by `miss`
            return fly_windows(twin, shifted, disturbance, past)
