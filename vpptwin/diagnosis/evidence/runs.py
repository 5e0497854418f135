"""The twin driven through windows, in many variations side by side."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

import mujoco
import numpy as np

from vpptwin.actuators.layer import SUPPLY
from vpptwin.effects import Stage
from vpptwin.estimation.correct import correct_measurements, is_perfect
from vpptwin.estimation.initial import estimate_states
from vpptwin.estimation.measurements import Measurements
from vpptwin.estimation.windows import WindowMotion, Windows, enter_windows, fly_on, fly_windows, trace_past
from vpptwin.twin.robot.manifold import conjugate, turn_to_world
from vpptwin.twin.sensors import PERFECT, Constants
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.stepping.recall import Past, evolves
from vpptwin.twin.twin import Twin

ROWS = 4096
"""Simulations that run side by side: enough to keep the engine busy, few enough to stay in memory."""
TWINS = 4
"""Twins, those used last, that are kept."""
Key = tuple[str, str]
"""Effect id and parameter name."""
Name = TypeVar("Name")
Found = TypeVar("Found")
MakeTwin = Callable[[TwinSpec, int, Iterable[str]], Twin]
"""Makes the simulations that are driven, of a twin, their number, and the effects that are switched on."""


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

    def take(self, rows: np.ndarray) -> Track:
        """Of some of the windows."""
        return Track(self.pose[rows], self.velocity[rows], self.push[rows])


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


def pick(motion: WindowMotion, run: int) -> WindowMotion:
    """One run of many, arrays (K, steps + 1, ...)."""
    speed = motion.rotor_speed
    return WindowMotion(motion.pose[run], motion.velocity[run], None if speed is None else speed[run])


class Call(NamedTuple):
    """What the runs of one call share."""

    windows: Windows  # as their sensors see them
    active: frozenset[str]  # effects that are switched on
    sensors_of: Mapping[Key, float]


class Run(NamedTuple):
    """Simulations that are ready to fly, and which variation and window each of them is, (N,)."""

    twin: Twin
    windows: Windows
    push: np.ndarray | None  # (N, segments, nv)
    which: np.ndarray
    window: np.ndarray


class Runs:
    """A twin that can be driven through windows in many variations at once.

    Args:
        spec: the twin.
        windows: K windows.
        segments: force pulses in a window.
        flights: the measurements that the windows were cut from, by their index; states at the start of the windows
            are estimated from them anew where sensors are found wrong.
        causal: those states are estimated without looking ahead.
        progress: called with the number of simulated steps as they are done.
        make_twin: makes what is driven through the windows, of a twin, a number of simulations, and effects.

    Attributes:
        track: about which all is simulated; None for states as estimated, and no force.
    """

    track: Track | None = None

    def __init__(
        self, spec: TwinSpec, windows: Windows, segments: int, flights: Sequence[Measurements] = (),
        causal: bool = False, progress: Callable[[int], None] | None = None, make_twin: MakeTwin = Twin,
    ) -> None:  # fmt: skip
        self.spec, self.windows, self.segments = spec, windows, segments
        self.flights, self.causal = list(flights), causal
        self.make_twin, self._progress = make_twin, progress
        self._twins: dict[tuple[int, frozenset[str]], Twin] = {}
        self._starts: dict[tuple[float, ...], Windows] = {}
        self._pasts: dict[tuple[float, ...], Past] = {}

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

    @property
    def guessed(self) -> bool:
        """Whether sensors and disturbances of the rig are assumed, no logs without an effect being known of it."""
        return not self.spec.robot.disturbance.known

    @cached_property
    def _observed(self) -> frozenset[str]:
        """Ids of the effects that change how motion shows in the channels."""
        shown = {*PERFECT, *SUPPLY}
        return frozenset(e.id for e in self.spec.catalogue if e.writes and set(e.writes) <= shown)

    def simulate(
        self, variations: Sequence[Variation], sensors_of: Mapping[Key, float] | None = None,
        active: frozenset[str] | None = None,
    ) -> WindowMotion:  # fmt: skip
        """What happens in every variation, arrays (V, K, steps + 1, ...).

        Args:
            variations: how the runs differ.
            sensors_of: the states that windows start from are those seen through the sensors of these values.
            active: effects that are switched on; None for those that variations have values of.
        """
        active = frozenset(effect for v in variations for effect, _ in v.values) if active is None else active
        call = Call(self.windows_seen(sensors_of or {}), active, sensors_of or {})
        pulses = self._list_pulses(variations)
        whole = sorted({*range(len(variations))} - {i for some in pulses.values() for i in some})
        motion = self._allot(len(variations))
        number = len(self.windows)
        for begin in range(0, len(whole) * number, ROWS):
            rows = np.arange(begin, min(begin + ROWS, len(whole) * number))
            run = self._ready([variations[i] for i in whole], rows // number, rows % number, call)
            part = fly_windows(run.twin, run.windows, run.push, self._recall(run, call))
            motion.put((np.array(whole)[rows // number], rows % number), part)
            self._tell(len(rows) * self.windows.steps)
        if pulses:
            self._fly_pulses(variations, pulses, call, motion)
        return motion

    def _list_pulses(self, variations: Sequence[Variation]) -> dict[int, list[int]]:
        """Those of the variations that differ in a pulse alone, by its segment; none if it does not pay to tell."""
        pulses = defaultdict[int, list[int]](list)
        for i, one in enumerate(variations):
            if one.push is not None and one.pose is None and one.velocity is None:
                pulses[one.push[0]].append(i)
        pushed = [variations[i].values for some in pulses.values() for i in some]
        parts = self.windows.driven is None and self.windows.steps % self.segments == 0
        alike = all(values == pushed[0] for values in pushed)
        return pulses if parts and alike and len(pulses) > 1 and self.make_twin is Twin else {}

    def _fly_pulses(
        self, variations: Sequence[Variation], pulses: Mapping[int, Sequence[int]], call: Call, motion: WindowMotion
    ) -> None:
        """Write what happens in variations that differ in a pulse alone: each is simulated from where that begins."""
        number, span = len(self.windows), self.windows.steps // self.segments
        pushed = [i for some in pulses.values() for i in some]
        still = replace(variations[pushed[0]], push=None)
        run = self._ready([still], np.zeros(number, int), np.arange(number), call)
        state, whole = enter_windows(run.twin, run.windows, self._recall(run, call)), self._allot(1)
        pose, velocity, states = run.windows.pose, run.windows.velocity, []
        for segment in range(self.segments):
            states.append(state)
            stretch = run.windows.part(segment * span, span, pose, velocity)
            push = None if run.push is None else run.push[:, segment : segment + 1]
            state, part = fly_on(run.twin, state, stretch, push)
            pose, velocity = part.pose[:, -1], part.velocity[:, -1]
            whole.put((0, slice(None), slice(segment * span, (segment + 1) * span + 1)), part)
        self._tell(number * self.windows.steps)
        motion.put((np.array(pushed),), pick(whole, 0))
        for segment, some in pulses.items():
            first, which = segment * span, np.repeat(np.arange(len(some)), number)
            run = self._ready([variations[i] for i in some], which, np.tile(np.arange(number), len(some)), call)
            begun = whole.pose[0, run.window, first], whole.velocity[0, run.window, first]
            stretch, push = run.windows.part(first, self.windows.steps - first, *begun), run.push
            assert push is not None
            _, part = fly_on(run.twin, states[segment].take(run.window), stretch, push[:, segment:])
            motion.put((np.array(some)[which], run.window, slice(first, None)), part)
            self._tell(len(which) * stretch.steps)

    def _allot(self, count: int) -> WindowMotion:
        """Room for so many runs."""
        times, model = (count, len(self.windows), self.windows.steps + 1), self.spec.model
        speed = None if self.windows.throttle is None else np.empty((*times, 2))
        return WindowMotion(np.empty((*times, model.nq)), np.empty((*times, model.nv)), speed)

    def _tell(self, steps: int) -> None:
        if self._progress is not None:
            self._progress(steps)

    def _ready(self, variations: Sequence[Variation], which: np.ndarray, window: np.ndarray, call: Call) -> Run:
        """A twin with a simulation for each of rows: of a variation and a window, (N,) indices of both."""
        nv = self.spec.model.nv
        twin = self._twin(len(which), call.active)
        for effect_id in call.active:
            effect = twin.effects[effect_id]
            for parameter in effect.parameters:
                nominal = self.spec.value(effect, parameter.name)
                values = np.array([v.values.get((effect_id, parameter.name), nominal) for v in variations])
                twin.set_parameter(effect_id, parameter.name, values[which])
        windows = call.windows
        if self.guessed and not (call.active | set(self.spec.effects)) & self._remembering:
            windows = replace(windows, warm=windows.warm[:, -1:])
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
        return Run(twin, windows.take(window).shift(self.spec.model, *moved), disturbance, which, window)

    def _recall(self, run: Run, call: Call) -> np.ndarray | None:
        """What the past left in the effects of every simulation, (N, S); None where nothing evolves."""
        if not self.flights or self._evolving.isdisjoint(run.twin.effects):
            return None
        _, row, number = np.unique(run.which, return_index=True, return_inverse=True)
        return run.twin.recall_effects(self.past_seen(call.sensors_of), row)[number, run.window]

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
