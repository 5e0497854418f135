"""What recorded values must be for a diagnosis to mean anything: finite, in SI units, planar."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vpptwin.errors import InputError
from vpptwin.logs.channels import AXES, Column, Source
from vpptwin.logs.convert import list_fields

MAX_NORM_ERROR = 0.01  # of a quaternion that was meant to be a rotation
MAX_TILT = 0.15  # rad out of the plane; a well set up tracker stays within a few degrees
MIN_TURN = 0.5  # rad of rotation below which a gyro cannot be judged
GYRO_STEP = 0.1  # s over which it is compared, long against delays and against the noise of a tracker
RARE = 0.01  # share of messages below which values beyond a limit look like outliers rather than a wrong unit


def check_finite(label: str, time: np.ndarray, name: str, values: np.ndarray) -> None:
    """Refuse NaN and infinities.

    Args:
        label: file and topic.
        time: (n,) s.
        name: column or field.
        values: (n,) or (n, k).

    Raises:
        InputError: with count and time of the first.
    """
    bad = _find_rows(~np.isfinite(values))
    if len(bad):
        kind = "NaN" if np.isnan(values[bad[0]]).any() else "an infinity"
        raise InputError(
            f"{label}: {name} is {kind} in {len(bad)} of {len(values)} messages, first at {time[bad[0]]:.3f} s",
            "finite numbers",
            "publish nothing while a value is unknown, or cut these messages out of the log",
        )


def check_limits(label: str, time: np.ndarray, column: Column, values: np.ndarray) -> None:
    """Refuse values that no rig of this kind reaches, which are mostly values in another unit.

    Args:
        label: file and topic.
        time: (n,) s.
        column: with its limit.
        values: (n,) or (n, k).

    Raises:
        InputError: naming the unit that they look like.
    """
    beyond = _find_rows(np.abs(values) > column.limit)
    if not len(beyond):
        return
    peak = float(np.abs(values).max())
    if len(beyond) > RARE * len(values):
        raise InputError(
            f"{label}: {column.name} reaches {peak:.4g} and looks like {column.mistake}",
            f"{column.unit}, at most {column.limit:g}",
            "convert it, for instance with `scale` in a topic map",
        )
    raise InputError(
        f"{label}: {column.name} jumps to {peak:.4g} {column.unit} in {len(beyond)} of {len(values)} messages, "
        f"first at {time[beyond[0]]:.3f} s",
        f"at most {column.limit:g} {column.unit}",
        "cut these outliers out of the log",
    )


def check_rotation(label: str, time: np.ndarray, source: Source, fields: Mapping[str, np.ndarray]) -> None:
    """Refuse quaternions that are no unit quaternions, or turn about another axis than the plane's.

    Args:
        label: file and topic.
        time: (n,) s.
        source: of the angle column.
        fields: path -> (n,).

    Raises:
        InputError: with the norm or the tilt found.
    """
    quaternion = np.stack([fields[path] for path in list_fields(source)], axis=-1)
    with np.errstate(over="ignore"):  # an infinite norm is refused like any other
        norm = np.linalg.norm(quaternion, axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > MAX_NORM_ERROR)
    if len(bad):
        raise InputError(
            f"{label}: the orientation of {len(bad)} of {len(norm)} messages is no unit quaternion, "
            f"norm {norm[bad[0]]:.3g} first at {time[bad[0]]:.3f} s",
            "quaternions of norm 1",
            "check the order and number of components where they are published",
        )
    name = AXES[source.axis or "-y"][0]
    others = [index for index, component in enumerate("xyz") if component != name]
    sine = np.linalg.norm(quaternion[:, others], axis=1) / norm
    tilt = 2.0 * np.arcsin(np.minimum(sine, 1.0))
    if np.median(tilt) > MAX_TILT:
        raise InputError(
            f"{label}: the orientation is no rotation about {name}, but {np.median(tilt):.2f} rad off (median)",
            "motion in the vertical plane of world x and z, turning about -y",
            "rotate the tracker's frame, or name the axis in a topic map (fields: {theta: {path: ..., axis: x}})",
        )


def check_gyro(label: str, pose: tuple[np.ndarray, np.ndarray], gyro: tuple[np.ndarray, np.ndarray]) -> None:
    """Refuse a gyro in degrees per second or of the wrong sign, by comparing its integral with the angle seen.

    Args:
        label: file and topic of the gyro.
        pose: time (n,) s and unwrapped angle (n,) rad.
        gyro: time (m,) s and rate (m,) rad/s.

    Raises:
        InputError: if the two agree but for a factor of 57.3, or -1. Logs with little rotation pass unjudged.
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
    factor = float(turned @ measured / (turned @ turned))
    likeness = float(turned @ measured) ** 2 / (float(turned @ turned) * float(measured @ measured) + 1e-300)
    if likeness < 0.8:
        return
    if abs(factor) > 20.0:
        raise InputError(
            f"{label}: rate is {factor:.3g} times the turning seen on /mocap/pose and looks like degrees per second",
            "rad/s",
            "convert it, for instance with `scale: 0.0174533` in a topic map",
        )
    if factor < -0.5:
        raise InputError(
            f"{label}: rate runs against the turning seen on /mocap/pose",
            "angular_velocity.y = -q, with theta counter-clockwise seen with x right and z up",
            "turn the sign of one of them in a topic map",
        )


def _find_rows(bad: np.ndarray) -> np.ndarray:
    return np.flatnonzero(bad if bad.ndim == 1 else bad.any(axis=1))
