"""What is compared: the measurements inside each window, in short bins, and the same quantities of a simulation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_array

from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.estimation.windows import Windows
from vpptwin.twin.robot.manifold import difference_attitudes, rotate
from vpptwin.twin.sensors import Constants, body_force, find_age, measure_coordinate, measure_rate, turn_rates

BIN = 0.01
"""Samples are averaged over bins of this length [s]."""
MOST_BINS = 300
"""Values in a window of a rig whose sensors are only assumed, at most."""
LEAD = 0.05
"""Start of a window in which poses are not compared: a delayed pose would reach back before it [s]."""
TRAIL = 0.02
"""End of such a window likewise: a pose stamped too early shows what comes after it [s]."""
SIGNALS = {"position": "pose", "velocity": "rate"}
"""Kind of a channel → what constants of sensors call it."""
MISSING = 1e6
"""Standard deviations given to a bin without samples, which takes it out of every sum."""


@dataclass(frozen=True)
class Channel:
    """One measured quantity in K windows of B bins."""

    name: str  # what it is
    unit: str  # SI unit
    kind: str  # `position`, `velocity` or `specific force`
    axis: int  # degree of freedom, or 0 and 1 for body x and z of a specific force
    delayed: bool  # comes from the motion capture
    value: np.ndarray  # mean over each bin, (K, B)
    std: np.ndarray  # noise of that mean, (K, B); huge where the bin is empty
    offset: np.ndarray  # time of each sample after the window's start, (K, B, S) s
    weight: np.ndarray  # 1/samples in the bin, 0 beyond them, (K, B, S)
    sensor_std: float  # noise of one sample
    turn: int = -1  # first of the three degrees of freedom of a body's rotation; -1 for all else
    # the attitude of each sample then, (K, B, S, 4): compared is the rotation from it, whose mean is 0
    measured: np.ndarray | None = None
    _means: dict[tuple[float, float, int], csr_array] = field(init=False, default_factory=dict, repr=False)

    def average(self, track: np.ndarray, dt: float, shift: float = 0.0, age: np.ndarray | float = 0.0) -> np.ndarray:
        """Mean over each bin, (K, B), of what is known every `dt` [s] of the windows, (K, n).

        Args:
            track: values, between which lines are drawn, and on beyond the end to what is late.
            dt: s.
            shift: by how much later than said they are, s.
            age: of what a sample shows, (K, B, S) s.
        """
        count = track.shape[1]
        if np.any(age):
            whole, part = self.locate(count, dt, shift - age)
            rows, then = np.arange(len(track))[:, None, None], np.minimum(whole + 1, count - 1)
            return np.asarray(
                ((track[rows, whole] * (1.0 - part) + track[rows, then] * part) * self.weight).sum(axis=2)
            )
        if (dt, shift, count) not in self._means:
            whole, part = self.locate(count, dt, shift)
            where = np.nonzero(self.weight)
            bins = where[0] * self.value.shape[1] + where[1]
            first, part, weight = where[0] * count, part[where], self.weight[where]
            columns = np.concatenate([first + whole[where], first + np.minimum(whole[where] + 1, count - 1)])
            data = np.concatenate([weight * (1.0 - part), weight * part]), (np.concatenate([bins, bins]), columns)
            self._means[dt, shift, count] = csr_array(data, shape=(self.value.size, track.size))
        return np.asarray(self._means[dt, shift, count] @ track.ravel()).reshape(self.value.shape)

    def locate(self, count: int, dt: float, shift: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """The last of `count` values that is there when a sample is taken, and the way to the next, (K, B, S) each."""
        position = (self.offset + shift) / dt
        inside = np.clip(position, 0.0, count - 1.000001)
        whole = inside.astype(np.intp)
        return whole, (position if np.ndim(shift) else inside) - whole  # of what is late straight on, out of the window

    def take(self, ids: np.ndarray) -> Channel:
        """The channel in some of the windows."""
        value, std, offset, weight = (array[ids] for array in (self.value, self.std, self.offset, self.weight))
        measured = None if self.measured is None else self.measured[ids]
        return replace(self, value=value, std=std, offset=offset, weight=weight, measured=measured)


def bin_channel(
    windows: Windows, series: Series, value: np.ndarray, kind: str, axis: int, delayed: bool, lead: float, name: str,
    floor: float = 0.0, bin_length: float = BIN, attitude: np.ndarray | None = None, turn: int = -1,
) -> Channel:  # fmt: skip
    """Average a series over the bins of each window (all of one flight), from `lead` [s] after its start.

    Of a rotation the `attitude` at the samples is kept, (n, 4), and of its rates too `turn` as `Channel` has it.

    No rigid-body twin is believed below the roughness `floor`, which is added to the sensors' noise. Noise that is not
    white is that of a mean over `BIN`.
    """
    length = windows.steps * windows.dt
    bins = int(length / bin_length + 1e-6)
    edges = windows.start[:, None] + bin_length * np.arange(bins + 1)
    first = np.searchsorted(series.time, edges - 1e-9)
    count = np.diff(first, axis=1)
    samples = max(int(count.max()), 1)
    index = first[:, :-1, None] + np.arange(samples)
    inside = np.arange(samples) < count[..., None]
    if delayed:
        inside &= (bin_length * np.arange(bins) >= lead - 1e-9)[None, :, None]
        if lead > 0.0:
            inside &= (bin_length * np.arange(1, bins + 1) <= length - TRAIL + 1e-9)[None, :, None]
    index = np.clip(index, 0, len(series.time) - 1)
    number = inside.sum(axis=2)
    weight = inside / np.maximum(number, 1)[..., None]
    mean = (value[index] * weight).sum(axis=2)
    averaging = np.sqrt(np.maximum(number, 1)) if series.white else np.sqrt(bin_length / BIN)
    noise = np.hypot(series.std / averaging, floor if series.white else 0.0)
    std = np.where(number > 0, noise, MISSING * series.std)
    offset = np.where(inside, series.time[index] - windows.start[:, None, None], 0.5 * length)
    measured = None if attitude is None else attitude[index]
    found = Channel(name, series.unit, kind, axis, delayed, mean, std, offset, weight, series.std, turn, measured)
    return found if attitude is None else replace(found, value=np.zeros_like(mean))


def observe_windows(
    windows: Windows, measurements: Measurements, lead: float = LEAD, criteria: Criteria = CRITERIA,
    bin_length: float = BIN,
) -> list[Channel]:  # fmt: skip
    """All channels of one flight's windows, in bins [s]; motion capture is compared from `lead` [s] on."""
    channels = []
    for dof, series in sorted(measurements.positions.items()):
        delayed = dof in measurements.delayed
        told = "position", dof, delayed, lead, series.name, 0.0, bin_length
        turn = next((first for first in measurements.attitudes if first <= dof < first + 3), -1)
        attitude = measurements.attitudes[turn].value if turn >= 0 else None
        channels.append(bin_channel(windows, series, series.value, *told, attitude, turn))
    for dof, series in sorted(measurements.velocities.items()):
        told = "velocity", dof, False, 0.0, series.name, criteria.velocity_floor, bin_length
        turn = next((first for first in measurements.attitudes if first <= dof < first + 3), -1)
        channels.append(bin_channel(windows, series, series.value, *told, None, turn))
    if (force := measurements.specific_force) is not None:
        for axis, label in ((0, "body x"), (1, "body z")):
            name, value, floor = f"{force.name}, {label}", force.value[:, axis], criteria.specific_force_floor
            told = "specific force", axis, False, 0.0, name, floor, bin_length
            channels.append(bin_channel(windows, force, value, *told))
    return channels


def choose_bin(measurements: Measurements, length: float) -> float:
    """Length of bins [s] in windows of a length [s]: so that what is compared stays few, as its square costs."""
    number = len(measurements.positions) + len(measurements.velocities)
    coarser = [times for times in (1, 2, 5, 10) if number * length <= MOST_BINS * times * BIN]
    return BIN * (coarser or [10])[0]


def join_channels(parts: list[list[Channel]]) -> list[Channel]:
    """The channels of several flights as one set; all flights must have the same channels."""
    joined = []
    for same in zip(*parts, strict=True):
        samples = max(c.offset.shape[2] for c in same)
        value, std = np.concatenate([c.value for c in same]), np.concatenate([c.std for c in same])
        offset = np.concatenate([pad_samples(c.offset, samples) for c in same])
        weight = np.concatenate([pad_samples(c.weight, samples) for c in same])
        attitudes = [pad_samples(c.measured, samples) for c in same if c.measured is not None]
        measured = np.concatenate(attitudes) if attitudes else None
        joined.append(replace(same[0], value=value, std=std, offset=offset, weight=weight, measured=measured))
    return joined


def pad_samples(array: np.ndarray, samples: int) -> np.ndarray:
    """Fill the third axis, (K, B, S, ...), up to `samples` with zeros."""
    beyond = array.ndim - 3
    return np.pad(array, ((0, 0), (0, 0), (0, samples - array.shape[2]), *beyond * ((0, 0),)))


def predict_channel(
    channel: Channel, pose: np.ndarray, velocity: np.ndarray, dt: float, gravity: float, start: np.ndarray,
    sensors: Constants, place: int | None = None, force: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """The channel as a simulation shows it.

    Args:
        channel: K windows.
        pose: (K, steps + 1, nq) m, rad.
        velocity: (K, steps + 1, nv) m/s, rad/s.
        dt: time between them, s.
        gravity: m/s².
        start: when the windows start, (K,) s since the start of the log.
        sensors: constants of the sensors, of every degree of freedom, which broadcast over (K, B).
        place: where in a pose its coordinate, or quaternion, lies; None for its `axis`, on rigs without quaternions.
        force: of `body_force`, where it is known.

    Returns:
        Mean over each bin, (K, B).
    """
    place = channel.axis if place is None else place
    if channel.kind == "specific force":
        force = body_force(pose, velocity, dt, gravity) if force is None else force
        track, shift = force[..., channel.axis], -0.5 * dt
    elif channel.kind == "velocity":
        track, shift = velocity[..., channel.axis], 0.0
    else:
        track, shift = pose[..., place], 0.0
    age: np.ndarray | float = 0.0
    if channel.kind in SIGNALS:
        age = find_age(sensors, SIGNALS[channel.kind], channel.axis, start[:, None, None] + channel.offset)
    if channel.measured is not None:
        whole, part = channel.locate(track.shape[1], dt, shift - age if np.any(age) else shift)
        rows = np.arange(len(track))[:, None, None]
        turned = rotate(
            pose[..., place : place + 4][rows, whole],
            (part * dt)[..., None] * velocity[..., channel.turn : channel.turn + 3][rows, whole],
        )
        axes = range(channel.turn, channel.turn + 3)
        if any(sensors["pose.offset"][..., axis].any() for axis in axes):
            turned = rotate(turned, np.stack([sensors["pose.offset"][..., axis] for axis in axes], axis=-1))
        left = difference_attitudes(channel.measured, turned)[..., channel.axis - channel.turn]
        return np.asarray((left * channel.weight).sum(axis=2))
    if channel.kind == "velocity" and channel.turn >= 0 and sensors["rate.turn"].any():
        body = [channel.average(velocity[..., channel.turn + axis], dt, shift, age) for axis in range(3)]
        mean = turn_rates(sensors, np.stack(body, axis=-1), channel.turn)[..., channel.axis - channel.turn]
    else:
        mean = channel.average(track, dt, shift, age)
    if channel.kind == "velocity":
        return measure_rate(sensors, mean, channel.axis)
    return measure_coordinate(sensors, channel.axis, mean) if channel.kind == "position" else mean
