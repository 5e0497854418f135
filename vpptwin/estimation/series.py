"""Measured quantities as series of samples, and those of one flight together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from vpptwin.logs.streams.clocks import Clock

Sampled = tuple[np.ndarray, np.ndarray]
"""Times (n,) s and values (n,) or (n, k)."""
ALIGNED, MIN_STEPS = 0.25, 20
"""Length of the steps [s] over which a gyro is compared with attitudes, and fewest of them."""


@dataclass(frozen=True)
class Series:
    """Samples of one quantity."""

    name: str  # what it is, e.g. `x` or `pitch rate`
    unit: str  # SI unit
    time: np.ndarray  # (n,) s, increasing
    value: np.ndarray  # (n,) or (n, k)
    std: float  # sensor noise of one sample, 1 sigma, in the unit
    white: bool = True  # the noise is independent from sample to sample, so that averaging reduces it
    span: float = 0.0  # how far around an instant samples tell a state there [s]; 0 where nobody has looked
    late: float = 0.0  # by how much later the log stamped the samples [s]: `time` is without that


@dataclass(frozen=True)
class Lag:
    """How far a stream runs behind another: `start` [s] at the first sample, and `drift` [s/s] more from there on."""

    start: float
    drift: float


@dataclass(frozen=True)
class Displacement:
    """How far gyro and accelerometer say that a degree of freedom has moved.

    Attributes:
        time: of the samples, (n,) s.
        value, slope, curvature: displacement and its derivatives, (n,).
        prior: standard deviation of the acceleration that is left over.
    """

    time: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray
    prior: float

    def read(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement and slope at any times, continued from the last sample before each: no look ahead."""
        last = np.maximum(np.searchsorted(self.time, times, side="right") - 1, 0)
        late = times - self.time[last]
        slope = self.slope[last] + self.curvature[last] * late
        return self.value[last] + 0.5 * (self.slope[last] + slope) * late, slope


@dataclass(frozen=True)
class Measurements:
    """What was measured and commanded on one flight.

    Attributes:
        name: file the flight came from.
        positions: degree of freedom → position [m or rad].
        velocities: degree of freedom → velocity [m/s or rad/s].
        specific_force: accelerometer in body axes x, z, (n, 2) m/s²; None without one.
        command: actuator commands (n, nu): blade pitch [rad] on the drone, control inputs elsewhere.
        rotor_speed: measured speed (n, 2) rad/s; None where it was not measured.
        delayed: degrees of freedom whose position comes from the motion capture.
        start, end: span in which everything needed is there [s].
        driven: degree of freedom → position of a joint that is not simulated but follows its log; of three that turn
            a body the first → its attitude (n, 4).
        throttle: commanded share of the battery's voltage (n, 2); None where it was not logged.
        current: measured motor currents (n, 2) A; None where they were not measured.
        lag: of the motion capture's angle behind the gyro's integral; None where nothing tells.
        attitudes: first of three degrees of freedom of a free body's rotation → its attitude, a unit quaternion
            (n, 4). Their `positions` are the angles that it has turned about its own axes since the first sample.
        clocks: topic → the clock that stamped it.
        strikes: spans in which the rig strikes something, which spoil windows, (n, 2) s.
        blows: spans in which geoms strike each other, whether they spoil windows or not, (n, 2) s.
        warnings: what was left out, filled in or is lost, one line each.
        dead_reckon: how far gyro and accelerometer of these measurements say that each degree of freedom has moved, by
            degree of freedom; None where they do not carry the state.
    """

    name: str
    positions: dict[int, Series]
    velocities: dict[int, Series]
    specific_force: Series | None
    command: Series
    rotor_speed: Series | None
    delayed: tuple[int, ...]
    start: float
    end: float
    driven: dict[int, Series] = field(default_factory=dict)
    throttle: Series | None = None
    current: Series | None = None
    lag: Lag | None = None
    attitudes: dict[int, Series] = field(default_factory=dict)
    clocks: Mapping[str, Clock] = field(default_factory=dict)
    strikes: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    blows: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    warnings: tuple[str, ...] = ()
    dead_reckon: Callable[[Measurements, mujoco.MjModel], dict[int, Displacement]] | None = None

    @property
    def duration(self) -> float:
        """Usable length of the flight [s]."""
        return self.end - self.start

    def in_eights(self) -> Measurements:
        """The same, joints' states read from eight samples, whatever the log told of that."""
        return replace(self, positions={dof: replace(series, span=0.0) for dof, series in self.positions.items()})


def integrate(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Running integral of `values` (n, ...) over `time` (n,) by trapezoids, zero at first, (n, ...).

    What SciPy's `cumulative_trapezoid` gives, whose import every command that reads a log would wait for.
    """
    steps = np.diff(time).reshape(-1, *[1] * (values.ndim - 1))
    parts = np.cumsum(steps * (values[1:] + values[:-1]) / 2.0, axis=0)
    return np.concatenate((np.zeros((1, *values.shape[1:])), parts))


def interpolate(at: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Columns (n, k) between their times (n,) by lines, at other times (...), (..., k)."""
    return np.stack([np.interp(at, time, column) for column in values.T], axis=-1)


def align_rates(time: np.ndarray, turned: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Rates (n, 3) about axes that may be turned, scaled and shifted, as attitudes have them that `turned` so, (n, 3).

    By least squares over steps long enough for what attitudes miss to be small: 3 x 3 numbers and three biases.
    """
    at, given = np.arange(time[0], time[-1], ALIGNED), np.column_stack([integrate(rate, time), time, turned])
    moved = np.diff(interpolate(at, time, given), axis=0)
    steps, seen = moved[:, :4], moved[:, 4:]
    if len(steps) < MIN_STEPS or np.linalg.matrix_rank(steps) < 4:
        return rate
    weight = 1.0 / np.maximum(np.linalg.norm(seen - steps[:, :3], axis=1, keepdims=True), 1e-9)
    weight = np.minimum(weight / np.median(weight), 1.0)  # an attitude that jumps does not decide
    mount = np.linalg.lstsq(weight * steps, weight * seen, rcond=None)[0]
    return np.asarray(rate @ mount[:3] + mount[3])
