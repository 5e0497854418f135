"""The test bench of a diagnosis: many variations of the twin driven through the same windows, side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from vpptwin.diagnosis.channels import Channel, predict_channel
from vpptwin.estimation.windows import Windows, simulate_windows
from vpptwin.twin.sensors import Constants
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.twin import Twin

ROWS = 4096
"""Simulations that run side by side: enough to keep the engine busy, few enough to stay in memory."""
Key = tuple[str, str]
"""Effect id and parameter name."""


@dataclass(frozen=True)
class Variation:
    """How one run through a window differs from the plain twin.

    Attributes:
        values: (effect id, parameter) → value.
        pose: added to the starting pose, (nv,).
        velocity: added to the starting velocity, (nv,).
        push: (segment, degree of freedom, N or N m) of a force pulse; None for none.
    """

    values: Mapping[Key, float] = field(default_factory=dict)
    pose: np.ndarray | None = None
    velocity: np.ndarray | None = None
    push: tuple[int, int, float] | None = None


class Bench:
    """Windows with their measurements, and a twin that can be driven through them in many variations at once.

    Args:
        spec: the twin.
        windows: K windows.
        channels: what was measured in them.
        segments: force pulses in a window.
        progress: called with the number of simulated steps as they are done.
    """

    def __init__(
        self,
        spec: TwinSpec,
        windows: Windows,
        channels: Sequence[Channel],
        segments: int,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        self.spec, self.windows, self.channels, self.segments = spec, windows, list(channels), segments
        self._progress = progress
        self._twins: dict[tuple[int, frozenset[str]], Twin] = {}
        self._gravity = -float(spec.model.opt.gravity[2])

    @property
    def measured(self) -> np.ndarray:
        """All channels side by side, (K, C B)."""
        return np.concatenate([c.value for c in self.channels], axis=1)

    @property
    def std(self) -> np.ndarray:
        """Sensor noise of `measured`, (K, C B); huge where nothing was measured."""
        return np.concatenate([c.std for c in self.channels], axis=1)

    @property
    def valid(self) -> np.ndarray:
        """Where something was measured, (K, C B)."""
        return np.concatenate([c.weight.sum(axis=2) > 0 for c in self.channels], axis=1)

    def predict(self, variations: Sequence[Variation]) -> np.ndarray:
        """The channels in every variation, (V, K, C B)."""
        pose, velocity = self.simulate(variations)
        return self.observe(variations, pose, velocity)

    def simulate(self, variations: Sequence[Variation]) -> tuple[np.ndarray, np.ndarray]:
        """Pose and velocity in every variation, (V, K, steps + 1, nv) each."""
        count, number = len(variations), len(self.windows)
        shape = (count * number, self.windows.steps + 1, self.spec.model.nv)
        pose, velocity = np.empty(shape), np.empty(shape)
        active = frozenset(effect for v in variations for effect, _ in v.values)
        for begin in range(0, count * number, ROWS):
            rows = np.arange(begin, min(begin + ROWS, count * number))
            pose[rows], velocity[rows] = self._simulate_rows(variations, rows // number, rows % number, active)
            if self._progress is not None:
                self._progress(len(rows) * self.windows.steps)
        full = (count, number, *shape[1:])
        return pose.reshape(full), velocity.reshape(full)

    def observe(self, variations: Sequence[Variation], pose: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """The channels of simulated poses and velocities, (V, K, C B)."""
        predicted = []
        for i, variation in enumerate(variations):
            sensors = self.sensors(variation.values)
            parts = [self.observe_channel(c, pose[i], velocity[i], sensors, self._gravity) for c in self.channels]
            predicted.append(np.concatenate(parts, axis=1))
        return np.stack(predicted)

    def observe_channel(
        self, channel: Channel, pose: np.ndarray, velocity: np.ndarray, sensors: Constants, gravity: float = 0.0
    ) -> np.ndarray:
        """A channel of simulated poses and velocities (K, steps + 1, nv), (K, B); gravity [m/s²] for its forces."""
        return predict_channel(channel, pose, velocity, self.windows.dt, gravity, self.windows.start, sensors)

    def sensors(self, values: Mapping[Key, float]) -> Constants:
        """Constants of the sensors of a twin with parameters set, (1,)."""
        return self.twin_with(values).constants.copy()

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
        if key not in self._twins:
            if len(self._twins) > 24:
                self._twins.clear()
            self._twins[key] = Twin(self.spec, rows, active)
        return self._twins[key]

    def _simulate_rows(
        self, variations: Sequence[Variation], which: np.ndarray, window: np.ndarray, active: frozenset[str]
    ) -> tuple[np.ndarray, np.ndarray]:
        nv = self.spec.model.nv
        twin = self._twin(len(which), active)
        for effect_id in active:
            effect = twin.effects[effect_id]
            for parameter in effect.parameters:
                nominal = self.spec.value(effect, parameter.name)
                values = np.array([v.values.get((effect_id, parameter.name), nominal) for v in variations])
                twin.set_parameter(effect_id, parameter.name, values[which])
        windows = self.windows.take(window)
        zero = np.zeros(nv)
        pose = np.stack([zero if v.pose is None else v.pose for v in variations])
        velocity = np.stack([zero if v.velocity is None else v.velocity for v in variations])
        disturbance = None
        if any(v.push is not None for v in variations):
            pushes = np.zeros((len(variations), self.segments, nv))
            for i, variation in enumerate(variations):
                if variation.push is not None:
                    segment, dof, size = variation.push
                    pushes[i, segment, dof] = size
            disturbance = pushes[which]
        shifted = windows.shift(pose[which], velocity[which])
        return simulate_windows(twin, shifted, disturbance)
