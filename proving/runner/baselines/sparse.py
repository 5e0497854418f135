"""Sparse regression on the missing wrench: pysindy's STLSQ over force terms, each standing for one effect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pysindy
from scipy.signal import fftconvolve, savgol_coeffs

from proving.runner.baselines.track import RATE, SMOOTHED, VEHICLE, Track, prepare_track
from vpptwin.logs.flight import Flight

CARRIED, MOVED = (
    VEHICLE.airframe.mass + VEHICLE.rig.slider_mass,
    VEHICLE.airframe.mass + VEHICLE.rig.slider_mass + VEHICLE.rig.carriage_mass,
)
"""Masses that move in z and in x [kg]."""
ARM, GRAVITY = VEHICLE.airframe.half_length, VEHICLE.gravity
THRESHOLD = 0.1
"""Of STLSQ on columns and target of unit norm (pysindy's default); a term's worth is held against its square."""
EDGE = 20
"""Samples left out at either end of a flight, where smoothing is poor."""
FRICTION_SPEED = 0.02
"""Speed over which the sign of a velocity is smoothed [m/s, rad/s]: below it the smoothed motion has no sign."""


def name_by_regression(flights: Sequence[Flight]) -> str:
    """The effect whose term, of those that STLSQ keeps, explains most that the others kept cannot."""
    parts = [build_terms(prepare_track(flight)) for flight in flights]
    names = list(parts[0][1])
    missing = np.concatenate([wrench for wrench, _ in parts], axis=0)
    library = np.stack([np.concatenate([average(terms[name]) for _, terms in parts]) for name in names], axis=-1)
    weight = 1.0 / np.maximum(1.4826 * np.median(np.abs(missing - np.median(missing, axis=0)), axis=0), 1e-9)
    target = (missing * weight).ravel()
    columns = (library * weight[:, None]).reshape(-1, len(names))
    scale = np.linalg.norm(columns, axis=0)
    unit = columns / np.maximum(scale, 1e-12)
    target /= np.linalg.norm(target)
    kept = np.flatnonzero(pysindy.STLSQ(threshold=THRESHOLD).fit(unit, target[:, None]).coef_[0])
    worth = {names[i]: misfit(unit[:, kept[kept != i]], target) - misfit(unit[:, kept], target) for i in kept}
    best = max(worth, key=lambda name: worth[name], default="")
    return best if best and worth[best] > THRESHOLD**2 else ""


def misfit(columns: np.ndarray, target: np.ndarray) -> float:
    """What least squares leaves of a target of unit norm."""
    left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0] if columns.size else target
    return float(left @ left)


def average(forces: np.ndarray) -> np.ndarray:
    """Forces (n, 3) averaged as smoothing averages accelerations: its second derivative, integrated twice."""
    second = savgol_coeffs(SMOOTHED, 3, deriv=2, delta=1.0 / RATE)
    kernel = np.cumsum(np.cumsum(second)) / RATE**2
    return fftconvolve(forces, np.roll(kernel, 1)[:, None], mode="same", axes=0)[EDGE:-EDGE]


def build_terms(track: Track) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Missing force along x and z [N] and moment [N m], and effect → what a unit of it adds, not averaged, (n, 3)."""
    pose, velocity, accel = track.smooth, track.velocity, track.accel
    thrust = track.at(track.time, track.thrust)
    change = np.gradient(thrust, track.time, axis=0)
    speed = track.at(track.time, track.speed).sum(axis=1)
    x, z, angle = pose.T
    v_x, v_z, rate = velocity.T
    a_x, a_z, spin = accel.T
    sine, cosine = np.sin(angle), np.cos(angle)
    nothing = np.zeros_like(x)

    def push(left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Wrench of thrusts along the body's axis."""
        return np.stack([-(left + right) * sine, (left + right) * cosine, (right - left) * ARM], axis=1)

    def along(axis: int, force: np.ndarray) -> np.ndarray:
        """Wrench with one component."""
        return np.stack([force if i == axis else nothing for i in range(3)], axis=1)

    inertia = VEHICLE.airframe.inertia
    needed = np.stack([MOVED * a_x, CARRIED * a_z, inertia * spin], axis=1)
    left, right = thrust.T
    sign = np.tanh(velocity / FRICTION_SPEED)
    total, airspeed = left + right, np.hypot(v_x, v_z)
    across = v_x * cosine + v_z * sine
    axial = v_z * cosine - v_x * sine
    side = np.abs(CARRIED * a_x + total * sine)
    terms = {
        "rail_x.coulomb": along(0, -sign[:, 0]),
        "rail_z.coulomb": along(1, -sign[:, 1]),
        "pitch.coulomb": along(2, -sign[:, 2]),
        "rail_x.stiction": along(0, -sign[:, 0] * np.exp(-((v_x / 0.05) ** 2))),
        "rail_z.stiction": along(1, -sign[:, 1] * np.exp(-((v_z / 0.05) ** 2))),
        "rail_x.jamming": along(0, -sign[:, 0] * side * np.abs(z)),
        "rail_z.jamming": along(1, -sign[:, 1] * side),
        "rail_x.viscous": along(0, -v_x),
        "rail_z.viscous": along(1, -v_z),
        "pitch.viscous": along(2, -rate),
        "rail_x.bias": along(0, nothing + 1.0),
        "rail_z.bias": along(1, nothing + 1.0),
        "pitch.bias": along(2, nothing + 1.0),
        "rail_x.spring": along(0, -x),
        "carriage.mass": along(0, -a_x),
        "airframe.mass": np.stack([-a_x, -(a_z + GRAVITY), nothing], axis=1),
        "airframe.inertia": along(2, -spin),
        "airframe.com": along(2, -((a_z + GRAVITY) * cosine + a_x * sine)),
        "airframe.com_height": along(2, (a_z + GRAVITY) * sine - a_x * cosine),
        "air.drag": np.stack([-airspeed * v_x, -airspeed * v_z, nothing], axis=1),
        "air.ground_effect": push(left * np.exp(-z / 0.3), right * np.exp(-z / 0.3)),
        "rotor.thrust_gain": push(left, right),
        "rotor.asymmetry": push(left, -right),
        "rotor.negative_thrust": push(-np.minimum(left, 0.0), -np.minimum(right, 0.0)),
        "rotor.inflow": push(-speed / 2 * (axial - ARM * rate), -speed / 2 * (axial + ARM * rate)),
        "rotor.in_plane": np.stack([-speed * across * cosine, -speed * across * sine, nothing], axis=1),
        "servo.lag": push(*-change.T),
        "servo.trim": push(nothing + 1.0, -nothing - 1.0),
    }
    return needed[EDGE:-EDGE] - average(push(left, right) - along(1, nothing + CARRIED * GRAVITY)), terms
