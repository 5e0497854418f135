"""State estimation in flight: an extended Kalman filter that fuses IMU and motion capture, N crafts at once.

The IMU carries position, velocity and angle on at its own rate; poses of the motion capture correct them and the biases
of gyro and accelerometer with them, as of their stamps: a pose that arrives late is fused where it belongs, and the IMU
samples since then, which are kept, carry the result to the present. Between poses, through dropouts too, the IMU alone
goes on. A pose that cannot be right by the filter's own measure is left out.

Written here because no maintained library has it: filterpy's last release is of 2018, simdkalman is linear, and a
smoother of a robotics package does not run inside a batch of simulations.

The formulas are those of the planar case of J. Solà, Quaternion kinematics for the error-state Kalman filter (2017),
error-state kinematics for IMU-driven systems, and, for the update and its consistency, of Y. Bar-Shalom, X. R. Li and
T. Kirubarajan, Estimation with Applications to Tracking and Navigation (2001).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from vpptwin.engine.compile import can_keep
from vpptwin.robots.planar_drone.vehicle import Vehicle

X, Z, ANGLE, V_X, V_Z, GYRO_BIAS, BIAS_X, BIAS_Z = range(8)
"""The state: hinge position [m], θ [rad], velocity [m/s], biases of gyro [rad/s] and accelerometer [m/s²]."""
SIZE = 8
DEPTH = 512
"""IMU samples that are kept: a pose may come so many late."""
GATE = 16.27
"""Normalized innovations squared beyond this are no noise: of three degrees of freedom 0.1 % are. Such a pose counts as
if it were noisier by as much as takes it to the gate: sensors have errors that the filter does not know of."""
SLACK = (0.05, 0.05, 0.15)
"""What a pose may be off beyond noise [m, m, rad]; one that is beyond the gate with this too is left out."""
KNOWN = 0.05
"""What the velocity of a craft that has been flying is known to [m/s]."""
GIVE_UP = 20
"""After so many poses in a row that were left out the filter believes them, not itself."""


@dataclass(frozen=True)
class FilterNoise:
    """What the filter takes its sensors to be.

    Attributes:
        gyro: of a sample, rad/s.
        accel: of a sample, m/s².
        position: of a pose, m.
        angle: of a pose, rad.
        stamp: of a pose's stamp, s: a craft that moves is elsewhere by then.
        gyro_walk: change of the gyro's bias in a second, rad/s.
        accel_walk: change of the accelerometer's, m/s².
        gyro_bias: what the first may be at the start, rad/s.
        accel_bias: and the second, m/s².
        speed: what velocity may be at the start, m/s.
    """

    gyro: float
    accel: float
    position: float
    angle: float
    stamp: float = 2e-4
    gyro_walk: float = 1e-3
    accel_walk: float = 1e-2
    gyro_bias: float = 0.05
    accel_bias: float = 0.3
    speed: float = 1.0

    @classmethod
    def of_vehicle(cls, vehicle: Vehicle) -> FilterNoise:
        """That of a vehicle's sensors."""
        mocap, imu = vehicle.sensors.mocap, vehicle.sensors.imu
        return cls(imu.gyro_std, imu.accel_std, mocap.position_std, mocap.angle_std)

    def as_array(self) -> np.ndarray:
        """The numbers in order, (10,)."""
        return np.array(astuple(self))


class Crafts(NamedTuple):
    """What evolves of N filters, written in place."""

    imu: np.ndarray  # ring of kept samples, (N, DEPTH, 3)
    base: np.ndarray  # time of the fused state, in samples; NaN before the first pose
    mean: np.ndarray
    covariance: np.ndarray
    now: np.ndarray  # the state at the present
    left_out: np.ndarray  # poses in a row that were


class World(NamedTuple):
    """What does not: between IMU samples [s], gravity [m/s²], and `FilterNoise.as_array`."""

    dt: float
    gravity: float
    noise: np.ndarray


class KalmanFilter:
    """Filters of N crafts. All start at the first pose; `save` gives what `restore` takes.

    Args:
        count: N.
        dt: between IMU samples [s].
        gravity: m/s².
        noise: of the sensors.

    Attributes:
        samples: IMU samples so far; the present is `samples * dt`.
    """

    def __init__(self, count: int, dt: float, gravity: float, noise: FilterNoise) -> None:
        self.dt, self._noise = dt, noise.as_array()
        self.samples = 0
        self._imu = np.zeros((count, DEPTH, 3))
        self._base = np.full(count, np.nan)
        self._mean, self._now = np.zeros((count, SIZE)), np.zeros((count, SIZE))
        self._covariance = np.zeros((count, SIZE, SIZE))
        self._left_out = np.zeros(count, np.int64)
        self._crafts = Crafts(self._imu, self._base, self._mean, self._covariance, self._now, self._left_out)
        self._world = World(float(dt), float(gravity), self._noise)

    def predict(self, gyro: np.ndarray, accel: np.ndarray) -> None:
        """Take in one IMU sample.

        Args:
            gyro: mean rate since the last one, (N,) rad/s.
            accel: mean specific force since then in body axes x, z, (N, 2) m/s².
        """
        self._imu[:, self.samples % DEPTH, 0] = gyro
        self._imu[:, self.samples % DEPTH, 1:] = accel
        self.samples += 1
        # Flat: to open a tuple of arrays takes longer than to carry one craft on.
        _carry(*self._crafts[:5], self.samples, *self._world)

    def correct(self, pose: np.ndarray, age: np.ndarray | float = 0.0, seen: np.ndarray | None = None) -> np.ndarray:
        """Take in poses of the motion capture.

        Args:
            pose: x, z, θ, (N, 3) m, m, rad; θ may be off by whole turns.
            age: how long ago each was stamped, (N,) or one for all, s.
            seen: which crafts have a new pose, (N,) bool; None for all.

        Returns:
            Normalized innovation squared, (N,): of three degrees of freedom. NaN where there was no pose, or it was the
            first, or older than one that is fused already.
        """
        count = len(self._base)
        stamp = self.samples - np.broadcast_to(np.asarray(age, dtype=float), count) / self.dt
        wanted = np.ones(count, bool) if seen is None else seen
        nis = np.full(count, np.nan)
        _fuse(self._crafts, self._world, self.samples, np.ascontiguousarray(pose, dtype=float), stamp, wanted, nis)
        return nis

    @property
    def pose(self) -> np.ndarray:
        """Position and angle now, (N, 3) m, m, rad; a copy."""
        return self._now[:, [X, Z, ANGLE]]

    @property
    def velocity(self) -> np.ndarray:
        """Velocity and rate now, (N, 3) m/s, m/s, rad/s; a copy."""
        rate = self._imu[:, (self.samples - 1) % DEPTH, 0] - self._now[:, GYRO_BIAS]
        return np.column_stack([self._now[:, V_X], self._now[:, V_Z], rate])

    @property
    def biases(self) -> np.ndarray:
        """Biases of gyro [rad/s] and accelerometer x, z [m/s²], (N, 3); a copy."""
        return self._now[:, GYRO_BIAS:].copy()

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviations of the state when it was last fused, (N, 8)."""
        return np.sqrt(np.einsum("nii->ni", self._covariance))

    def start(self, ids: np.ndarray, pose: np.ndarray, velocity: np.ndarray) -> None:
        """Begin anew in the rows `ids` at poses and velocities (n, 3) that are known as well as in flight."""
        spread = np.array([self._noise[2], self._noise[2], self._noise[3], KNOWN, KNOWN, *self._noise[[7, 8, 8]]])
        self._base[ids], self._left_out[ids], self._imu[ids] = self.samples, 0, 0.0
        self._mean[ids] = 0.0
        self._mean[ids, :3], self._mean[ids, V_X : V_Z + 1] = pose, velocity[:, :2]
        self._now[ids] = self._mean[ids]
        self._imu[ids, (self.samples - 1) % DEPTH, 0] = velocity[:, 2]
        self._covariance[ids] = np.diag(spread**2)

    def save(self) -> dict[str, np.ndarray]:
        """Everything that evolves, by name; copies."""
        kept = {name: values.copy() for name, values in vars(self).items() if isinstance(values, np.ndarray)}
        return kept | {"samples": np.array(self.samples)}

    def restore(self, saved: dict[str, np.ndarray]) -> None:
        """Go on from what `save` gave."""
        for name, values in saved.items():
            if name == "samples":
                self.samples = int(values)
            else:
                getattr(self, name)[...] = values


@njit(cache=can_keep(), error_model="numpy")
def _move(state: np.ndarray, sample: np.ndarray, part: float, gravity: float) -> tuple[float, float, float, float]:
    """Carry a state (8,) on by an IMU sample (3,); acceleration in the world's axes and the angle's sine and cosine."""
    rate = sample[0] - state[GYRO_BIAS]
    # A sample is a mean over its time: turned by the angle halfway it is right to second order while the craft flips.
    middle = state[ANGLE] + 0.5 * part * rate
    sine, cosine = np.sin(middle), np.cos(middle)
    along, across = sample[1] - state[BIAS_X], sample[2] - state[BIAS_Z]
    a_x = cosine * along - sine * across
    a_z = sine * along + cosine * across - gravity
    state[X] += part * (state[V_X] + 0.5 * part * a_x)
    state[Z] += part * (state[V_Z] + 0.5 * part * a_z)
    state[V_X] += part * a_x
    state[V_Z] += part * a_z
    state[ANGLE] += part * rate
    return a_x, a_z, sine, cosine


@njit(cache=can_keep(), error_model="numpy")
def _spread(
    p: np.ndarray, a_x: float, a_z: float, sine: float, cosine: float, part: float, gravity: float, noise: np.ndarray
) -> None:
    """Carry a covariance (8, 8) on: F P Fᵀ + Q, F being the identity but for five rows."""
    # An error of angle turns the specific force R f: its derivative by θ is (-(R f)_z, (R f)_x), R f = a + (0, g).
    lean_x, lean_z = -(a_z + gravity), a_x
    # One pass over rows and one over columns in place of two products of (8, 8).
    for turn in range(2):  # rows, then columns
        for j in range(SIZE):
            if turn == 0:
                x, z, angle, v_x, v_z = p[X, j], p[Z, j], p[ANGLE, j], p[V_X, j], p[V_Z, j]
                gyro, b_x, b_z = p[GYRO_BIAS, j], p[BIAS_X, j], p[BIAS_Z, j]
            else:
                x, z, angle, v_x, v_z = p[j, X], p[j, Z], p[j, ANGLE], p[j, V_X], p[j, V_Z]
                gyro, b_x, b_z = p[j, GYRO_BIAS], p[j, BIAS_X], p[j, BIAS_Z]
            x, z = x + part * v_x, z + part * v_z
            v_x += part * (lean_x * angle - cosine * b_x + sine * b_z)
            v_z += part * (lean_z * angle - sine * b_x - cosine * b_z)
            angle -= part * gyro
            if turn == 0:
                p[X, j], p[Z, j], p[ANGLE, j], p[V_X, j], p[V_Z, j] = x, z, angle, v_x, v_z
            else:
                p[j, X], p[j, Z], p[j, ANGLE], p[j, V_X], p[j, V_Z] = x, z, angle, v_x, v_z
    # Q: noise of a sample holds for all its time, so its square grows with dt²; the biases walk, and theirs with dt.
    p[ANGLE, ANGLE] += (noise[0] * part) ** 2
    p[V_X, V_X] += (noise[1] * part) ** 2
    p[V_Z, V_Z] += (noise[1] * part) ** 2
    p[GYRO_BIAS, GYRO_BIAS] += noise[5] ** 2 * part
    p[BIAS_X, BIAS_X] += noise[6] ** 2 * part
    p[BIAS_Z, BIAS_Z] += noise[6] ** 2 * part


@njit(cache=can_keep(), error_model="numpy")
def _advance(imu: np.ndarray, state: np.ndarray, p: np.ndarray, begin: float, end: float, world: World) -> None:
    """Carry state and covariance of one craft from one time to another, both in samples, through the kept samples."""
    dt, gravity, noise = world
    now = begin
    while now < end - 1e-9:
        index = int(np.floor(now + 1e-9))
        stop = min(index + 1.0, end)
        part = (stop - now) * dt
        a_x, a_z, sine, cosine = _move(state, imu[index % DEPTH], part, gravity)
        _spread(p, a_x, a_z, sine, cosine, part, gravity, noise)
        # A sample used in parts has one and the same noise: part² + part (dt - part), and the parts add up to dt².
        if part < dt:
            p[ANGLE, ANGLE] += noise[0] ** 2 * part * (dt - part)
            p[V_X, V_X] += noise[1] ** 2 * part * (dt - part)
            p[V_Z, V_Z] += noise[1] ** 2 * part * (dt - part)
        now = stop


@njit(cache=can_keep(), error_model="numpy")
def _carry(
    imu: np.ndarray, base: np.ndarray, mean: np.ndarray, covariance: np.ndarray, now: np.ndarray, samples: int,
    dt: float, gravity: float, noise: np.ndarray,
) -> None:  # fmt: skip
    """The newest sample moves every state on; fused states that would fall out of the ring move too."""
    for n in range(len(base)):
        if np.isnan(base[n]):
            continue
        _move(now[n], imu[n, (samples - 1) % DEPTH], dt, gravity)
        if samples - base[n] >= DEPTH - 1:
            _advance(imu[n], mean[n], covariance[n], base[n], base[n] + 1.0, World(dt, gravity, noise))
            base[n] += 1.0


@njit(cache=can_keep(), error_model="numpy")
def _start(mean: np.ndarray, p: np.ndarray, pose: np.ndarray, noise: np.ndarray) -> None:
    """Begin at a pose (3,), at rest as far as known."""
    mean[:] = 0.0
    mean[:3] = pose
    p[:] = 0.0
    spread = (noise[2], noise[2], noise[3], noise[9], noise[9], noise[7], noise[8], noise[8])
    for i in range(SIZE):
        p[i, i] = spread[i] ** 2


@njit(cache=can_keep(), error_model="numpy")
def _fuse(
    crafts: Crafts, world: World, samples: int, pose: np.ndarray, stamp: np.ndarray, wanted: np.ndarray,
    nis: np.ndarray,
) -> None:  # fmt: skip
    """Fuse the poses of all crafts that have one, and carry the results to the present."""
    for n in range(len(wanted)):
        if not wanted[n] or not np.isfinite(pose[n]).all():
            continue
        imu, mean, p, base = crafts.imu[n], crafts.mean[n], crafts.covariance[n], crafts.base[n]
        time = min(stamp[n], float(samples))
        if np.isnan(base):
            if samples - time >= DEPTH - 1:
                continue
            _start(mean, p, pose[n], world.noise)
        elif time <= base:
            continue
        else:
            # Fused as of its stamp: by the time a pose arrives the craft has moved on by more than its noise.
            _advance(imu, mean, p, base, time, world)
            rate = imu[int(np.floor(time - 1e-9)) % DEPTH, 0] - mean[GYRO_BIAS]
            nis[n], crafts.left_out[n] = _correct(mean, p, pose[n], rate, crafts.left_out[n], world.noise)
        crafts.base[n] = time
        # Nobody asks for the present's covariance: from the fused state on the state alone is carried.
        now, reached = crafts.now[n], time
        now[:] = mean
        while reached < samples - 1e-9:
            index = int(np.floor(reached + 1e-9))
            end = min(index + 1.0, float(samples))
            _move(now, imu[index % DEPTH], (end - reached) * world.dt, world.gravity)
            reached = end


@njit(cache=can_keep(), error_model="numpy", forceinline=True)
def _correct(
    mean: np.ndarray, p: np.ndarray, pose: np.ndarray, rate: float, left_out: int, noise: np.ndarray
) -> tuple[float, int]:
    """Fuse a pose (3,) into a state of its time, or leave it out; its NIS, and how many in a row were left out."""
    innovation = pose - mean[:3]
    innovation[ANGLE] -= 2.0 * np.pi * np.round(innovation[ANGLE] / (2.0 * np.pi))
    s = p[:3, :3].copy()  # S = H P Hᵀ + R
    late = (mean[V_X], mean[V_Z], rate)
    for i in range(3):
        s[i, i] += (noise[3] if i == ANGLE else noise[2]) ** 2
        for j in range(3):  # a stamp off by δ shows the craft where it is δ later: all three are off together
            s[i, j] += late[i] * late[j] * noise[4] ** 2
    inverse = np.linalg.inv(s)
    nis = _weigh(innovation, inverse)
    for i in range(3):
        s[i, i] += SLACK[i] ** 2
    if _weigh(innovation, np.linalg.inv(s)) > GATE:
        if left_out < GIVE_UP:
            return nis, left_out + 1
        v_x, v_z = mean[V_X], mean[V_Z]
        _start(mean, p, pose, noise)
        mean[V_X], mean[V_Z] = v_x, v_z
        return nis, 0
    if nis > GATE:  # the innovation's covariance magnified until it lies on the gate
        inverse *= GATE / nis
    gain = np.zeros((SIZE, 3))  # P Hᵀ S⁻¹, H the first three rows of the identity
    for i in range(SIZE):
        for j in range(3):
            for k in range(3):
                gain[i, j] += p[i, k] * inverse[k, j]
    for i in range(SIZE):
        for j in range(3):
            mean[i] += gain[i, j] * innovation[j]
    rows = p[:3].copy()
    for i in range(SIZE):
        for j in range(SIZE):
            for k in range(3):
                p[i, j] -= gain[i, k] * rows[k, j]
    for i in range(SIZE):  # P - K H P is symmetric but for rounding, which would add up
        for j in range(i):
            p[i, j] = p[j, i] = 0.5 * (p[i, j] + p[j, i])
    return nis, 0


@njit(cache=can_keep(), error_model="numpy", forceinline=True)
def _weigh(innovation: np.ndarray, inverse: np.ndarray) -> float:
    """Normalized innovation squared, νᵀ S⁻¹ ν: of χ² with three degrees of freedom where the filter is consistent."""
    nis = 0.0
    for i in range(3):
        for j in range(3):
            nis += innovation[i] * inverse[i, j] * innovation[j]
    return nis
