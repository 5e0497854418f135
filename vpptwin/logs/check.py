"""What recorded values must be for a diagnosis to mean anything: finite, in SI units, planar."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vpptwin.logs.channels import AXES, Column, Source
from vpptwin.logs.streams.convert import list_fields
from vpptwin.system.doubt import object_to
from vpptwin.system.errors import InputError

MAX_NORM_ERROR = 0.01  # of a quaternion that was meant to be a rotation
MAX_TILT = 0.15  # rad out of the plane; a well set up tracker stays within a few degrees
MIN_TURN = 0.5  # rad of rotation below which a gyro cannot be judged
GYRO_STEP = 0.1  # s over which it is compared, long against delays and against the noise of a tracker
HUGE = 1e12  # SI units that nothing measured reaches, and of which no square or sum overflows
RARE = 0.01  # share of messages up to which impossible values are outliers rather than a wrong unit
SLOWEST, FASTEST = 0.6, 1.6  # rate over turning beyond which a scale is wrong: `gyro.scale` reaches from 0.7 to 1.3
MIN_R_SQUARED = 0.8  # squared correlation from which on gyro and tracker show one motion
MIN_FORCE, MAX_FORCE = 2.5, 50.0  # m/s^2, median of any flight; at rest and in hover it is 9.8


def check_finite(label: str, time: np.ndarray, name: str, values: np.ndarray) -> None:
    """Refuse NaN and infinities in a column or field, (n,) or (n, k), of a file's topic; time (n,) s."""
    bad = np.flatnonzero(_any_component(~np.isfinite(values)))
    if len(bad):
        kind = "NaN" if np.isnan(values[bad[0]]).any() else "an infinity"
        raise InputError(
            f"{label}: {name} is {kind} in {len(bad)} of {len(values)} messages, first at {time[bad[0]]:.3f} s",
            "finite numbers",
            "publish nothing while a value is unknown, or cut these messages out of the log",
        )


def find_huge(label: str, time: np.ndarray, name: str, values: np.ndarray) -> np.ndarray:
    """Rare messages, (n,) bool, whose values (n,) or (n, k) are beyond what anything measures; time (n,) s."""
    rows = _any_component(np.abs(values) > HUGE)
    if (count := np.count_nonzero(rows)) > RARE * len(values):
        raise InputError(
            f"{label}: {name} reaches {float(np.abs(values).max()):.4g}, beyond {HUGE:g} in {count} of {len(values)} "
            f"messages, first at {time[np.argmax(rows)]:.3f} s",
            "a quantity that something measured, in SI units",
            "look for what fills it in where a value is unknown, or correct its `scale`",
        )
    return rows


def find_wild(label: str, column: Column, values: np.ndarray) -> np.ndarray:
    """Rare messages, (n,) bool, whose values (n,) or (n, k) no rig of this kind reaches."""
    rows = _any_component(np.abs(values) > column.limit)
    if np.count_nonzero(rows) > RARE * len(values):
        raise InputError(
            f"{label}: {column.name} reaches {float(np.abs(values).max()):.4g} and looks like {column.mistake}",
            f"{column.unit}, at most {column.limit:g}",
            "convert it, for instance with `scale` in a topic map",
        )
    return rows


def find_broken(label: str, time: np.ndarray, source: Source, fields: Mapping[str, np.ndarray]) -> np.ndarray:
    """Rare messages, (n,) bool, whose quaternion is none, as trackers send them that have lost their body."""
    quaternion = np.stack([fields[path] for path in list_fields(source)], axis=-1)
    with np.errstate(over="ignore"):  # an infinite norm is refused like any other
        norm = np.linalg.norm(quaternion, axis=1)
    broken = np.asarray(np.abs(norm - 1.0) > MAX_NORM_ERROR)
    bad = np.flatnonzero(broken)
    if len(bad) > RARE * len(norm):
        raise InputError(
            f"{label}: the orientation of {len(bad)} of {len(norm)} messages is no unit quaternion, "
            f"norm {norm[bad[0]]:.3g} first at {time[bad[0]]:.3f} s",
            "quaternions of norm 1",
            "check the order and number of components where they are published",
        )
    name = AXES[source.axis or "-y"][0]
    others = [index for index, component in enumerate("xyz") if component != name]
    sine = np.linalg.norm(quaternion[:, others], axis=1) / np.maximum(norm, 0.5)
    tilt = 2.0 * np.arcsin(np.minimum(sine, 1.0))  # of the part of q = (axis sin a/2, cos a/2) off the axis
    if np.median(tilt) > MAX_TILT:
        raise InputError(
            f"{label}: the orientation is no rotation about {name}, but {np.median(tilt):.2f} rad off (median)",
            "motion in the vertical plane of world x and z, turning about -y",
            "rotate the tracker's frame, or name the axis in a topic map (fields: {theta: {path: ..., axis: x}})",
        )
    return broken


def check_gyro(label: str, pose: tuple[np.ndarray, np.ndarray], gyro: tuple[np.ndarray, np.ndarray]) -> None:
    """Refuse a gyro in degrees per second, of the wrong sign or scale, by comparing its integral with the angle seen.

    Args:
        label: file and topic of the gyro.
        pose: time (n,) s and unwrapped angle (n,) rad.
        gyro: time (m,) s and rate (m,) rad/s.
    """
    time, theta = pose
    inside = np.flatnonzero((time >= gyro[0][0]) & (time <= gyro[0][-1]))
    if len(inside) < 10:
        return
    stride = max(1, round(GYRO_STEP / float(np.median(np.diff(time[inside])))))
    inside = inside[::stride]
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (gyro[1][1:] + gyro[1][:-1]) * np.diff(gyro[0]))])
    turned, measured = np.diff(theta[inside]), np.diff(np.interp(time[inside], gyro[0], integral))
    if len(turned) < 3 or np.ptp(theta[inside]) < MIN_TURN:
        return
    factor, r_squared = compare_steps(turned, measured)
    if r_squared < MIN_R_SQUARED:
        return
    found = f"{label}: rate is {factor:.3g} times the turning"
    advice = "convert it, for instance with `scale: 0.0174533`"
    if abs(factor) > 20.0:
        found += " seen on /mocap/pose and looks like degrees per second"
        object_to(InputError(found, "rad/s", f"{advice} in a topic map"))
    elif abs(factor) < 1.0 / 20.0:
        found += " seen on /mocap/pose, which looks like degrees"
        object_to(InputError(found, "rad on /mocap/pose", f"{advice} for theta in a topic map"))
    elif factor < -0.5:
        object_to(InputError(
            f"{label}: rate runs against the turning seen on /mocap/pose",
            "angular_velocity.y = -q, with theta counter-clockwise seen with x right and z up",
            "turn the sign of one of them in a topic map",
        ))  # fmt: skip
    elif not SLOWEST < factor < FASTEST:
        object_to(InputError(
            f"{found} seen on /mocap/pose",
            "1, the same motion",
            f"convert the one that is wrong, for instance with `scale: {1.0 / factor:.3g}` for rate in a topic map",
        ))  # fmt: skip


def compare_steps(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Factor from one sensor's steps (n,) to another's of the same motion by least squares, and R², 0 to 1."""

    def fit(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
        # y = a x through the origin: a = xy / xx, R² = (xy)² / (xx yy)
        xy, xx, yy = float(x @ y), float(x @ x), float(y @ y)
        return xy / (xx + 1e-300), xy * xy / (xx * yy + 1e-300)

    factor, r_squared = fit(one, other)
    if r_squared < MIN_R_SQUARED:  # outliers, perhaps, which are dealt with later
        calm = np.ones(len(one), dtype=bool)
        for step in (one, other):
            calm &= np.abs(step) <= np.quantile(np.abs(step), 1.0 - 3.0 * RARE)
        factor, r_squared = fit(one[calm], other[calm])
    return factor, r_squared


def _any_component(bad: np.ndarray) -> np.ndarray:
    return np.asarray(bad if bad.ndim == 1 else bad.any(axis=1))
