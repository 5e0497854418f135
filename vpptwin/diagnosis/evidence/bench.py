"""The test bench of a diagnosis: many variations of the twin driven through the same windows, side by side."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from copy import copy
from functools import cached_property

import numpy as np

from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.channels import Channel, predict_channel
from vpptwin.diagnosis.evidence.motor import CURRENT, SPEED, predict_motor
from vpptwin.diagnosis.evidence.runs import ROWS, Key, MakeTwin, Runs, Track, Variation, keep_last, pick
from vpptwin.effects import Stage
from vpptwin.estimation.measurements import Measurements
from vpptwin.estimation.windows import WindowMotion, Windows
from vpptwin.twin.robot.manifold import find_place
from vpptwin.twin.sensors import Constants, body_force
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.twin import Twin

MOTIONS = 4
"""Motions of one variation, those simulated last, that a bench keeps."""
ASTRAY, FARTHEST = 1e4, 1e8
"""Noises by which a simulation that diverged is taken to miss, and by which any can: squares must not overflow."""
FAR, UNSEEN = 8.0, 1e4
"""Typical sizes beyond which an effect changes what others do, and beyond which it is a limit that nothing reaches."""


class Bench(Runs):
    """Windows with their measurements, and a twin that can be driven through them in many variations at once.

    Args:
        spec, windows, segments, flights, causal, progress, make_twin: as `Runs` has them.
        channels: what was measured in the windows.
        criteria: thresholds of the diagnosis that works on it.

    Attributes:
        folds: which fold every window belongs to, (K,), and parameters as fitted to all other folds: those judge it.
    """

    folds: tuple[np.ndarray, Sequence[Mapping[Key, float]]] | None = None

    def __init__(
        self, spec: TwinSpec, windows: Windows, channels: Sequence[Channel], segments: int,
        flights: Sequence[Measurements] = (), causal: bool = False, progress: Callable[[int], None] | None = None,
        criteria: Criteria = CRITERIA, make_twin: MakeTwin = Twin,
    ) -> None:  # fmt: skip
        super().__init__(spec, windows, segments, flights, causal, progress, make_twin)
        self.channels, self.criteria = list(channels), criteria
        self._motions: dict[Hashable, tuple[Track | None, WindowMotion]] = {}  # with its track, whose id is in the key
        self._parts: dict[bytes, Bench] = {}
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

        What the track does is in the prediction; `Response.restore` takes it out again. Parameters that were fitted
        fold by fold are, in every window, those of a fit that has not seen it.
        """
        if self.folds is None or not any(key in self.folds[1][0] for key in values):
            return self.miss(self.predict([Variation(dict(values))], values)[0])
        fold, fitted = self.folds
        found = np.empty_like(self.measured)
        for number, each in enumerate(fitted):
            rows, unseen = np.flatnonzero(fold == number), {key: each.get(key, value) for key, value in values.items()}
            if len(rows):
                track = None if self.track is None else self.track.take(rows)
                found[rows] = self._part(rows.tobytes()).about(track).residual(unseen)
        return found

    def _part(self, rows: bytes) -> Bench:
        """Some of the windows, about no track."""
        if rows not in self._parts:
            some = np.frombuffer(rows, int)
            given = self.flights, self.causal, self._progress, self.criteria, self.make_twin
            channels = [channel.take(some) for channel in self.channels]
            self._parts[rows] = Bench(self.spec, self.windows.take(some), channels, self.segments, *given)
        return self._parts[rows]

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

    @cached_property
    def without_dry_friction(self) -> dict[Key, float]:
        """Values that take dry friction out of the twin, where it has any: (effect id, parameter) → off value."""
        rubbing = [e for e in self.spec.catalogue if e.stage is Stage.FRICTION and e.id in self.spec.effects]
        return {(e.id, e.parameters[0].name): e.parameters[0].off for e in rubbing}

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

    def _observe(self, variation: Variation, motion: WindowMotion) -> np.ndarray:
        """All channels of one variation, (K, M)."""
        constants, force = self.sensors(variation.values), None
        if any(channel.kind == "specific force" for channel in self.channels):
            force = self._feel(motion)
        return np.concatenate([self.observe_channel(c, motion, constants, force) for c in self.channels], axis=1)

    def _feel(self, motion: WindowMotion) -> np.ndarray:
        with np.errstate(invalid="ignore", over="ignore"):
            return body_force(motion.pose, motion.velocity, self.windows.dt, self._gravity)

    def observe_channel(
        self, channel: Channel, motion: WindowMotion, constants: Constants, force: np.ndarray | None = None
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
