"""Signals of a body that flies or floats: attitude, gyro, accelerometer, position, each tested against the others."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from vpptwin.estimation.guess import SLOPE, compare_lag, compare_slope, is_commanded, resample, split_words
from vpptwin.fields import UNITS
from vpptwin.logs.survey import Signal

AXES = ("x", "y", "z")
REST_S = 1.0
"""The stillest stretch of so long is taken for rest [s]."""
TURNS = (("rad/s", 1.0), ("deg/s", UNITS["deg/s"][1]), ("mrad/s", 1e-3))
GRAVITIES = (("m/s^2", 1.0), ("g", UNITS["g"][1]), ("mg", UNITS["mg"][1]))


def find_groups(signals: Sequence[Signal], axes: Sequence[str]) -> dict[str, list[Signal]]:
    """Signals that differ in the end of their name alone, by what they share."""
    groups: dict[str, dict[str, Signal]] = {}
    for signal in signals:
        match = re.fullmatch(rf"(.*?)({'|'.join(axes)})", signal.label.lower())
        if match:
            groups.setdefault(f"{signal.topic} {match.group(1)}", {})[match.group(2)] = signal
    return {stem: [group[axis] for axis in axes] for stem, group in groups.items() if len(group) == len(axes)}


def tell_body(body: str, signals: Sequence[Signal]) -> Iterator[tuple[str, bool]]:
    """Lines on what a body's signals are, and whether each is sure."""
    attitudes = {}
    for stem, group in find_groups([s for s in signals if not is_commanded(s)], (*AXES, "w")).items():
        norms = np.sqrt(np.sum([signal.values**2 for signal in group], axis=0))
        off = float(np.nanmax(np.abs(norms - 1.0)))
        if off < 0.02:
            attitudes[stem] = group
            yield f"{body} attitude: {stem}x, y, z, w is a quaternion (norm within {off:.1g} of 1)", True
    triples = find_groups([s for s in signals if not is_commanded(s)], AXES)
    yield from tell_positions(body, {stem: g for stem, g in triples.items() if stem + "q" not in attitudes})
    for stem, group in find_groups(signals, ("roll", "pitch", "yaw")).items():
        if attitudes and not any(is_commanded(signal) for signal in group):
            yield tell_angles(body, stem, group, next(iter(attitudes.values())))
    for stem, group in triples.items():
        words = set(split_words(stem.split(" ", 1)[1]))
        if words & {"gyro", "gyr"} and attitudes:
            yield tell_gyro(body, stem, group, next(iter(attitudes.values())))
        elif words & {"acc", "accel", "acceleration"} and words & {"imu", "accel", "accelerometer"}:
            yield tell_gravity(body, stem, group)


def tell_positions(body: str, triples: Mapping[str, list[Signal]]) -> Iterator[tuple[str, bool]]:
    """Positions, each with the velocity that is its slope."""
    for stem, group in triples.items():
        topic, _, name = stem.partition(" ")
        if (
            name.rstrip("._")
            and not re.fullmatch(r"(.*[._])?p", name)
            and not name.endswith(("state", "estimate.", "estimate_"))
        ):
            continue
        base = name[:-1] if name.endswith("p") else name
        velocity = triples.get(f"{topic} {base}v")
        if velocity is None:
            yield f"{body} position: {stem}x, y, z by name alone", False
            continue
        tests = [compare_slope(p, v) for p, v in zip(group, velocity)]
        shares = [share for r, share in tests if np.isfinite(r) and r > SLOPE]
        good = len(shares) >= 2 and all(0.6 < share < 1.6 for share in shares)
        numbers = ", ".join(f"{share:.2f} (r {r:.2f})" for r, share in tests)
        yield f"{body} position: {stem}x, y, z, velocity {base}vx, vy, vz; shares of the slope {numbers}", good


def tell_gyro(body: str, stem: str, group: Sequence[Signal], attitude: Sequence[Signal]) -> tuple[str, bool]:
    """In which unit a gyro turns with the attitude."""
    time = attitude[0].time
    period = float(np.median(np.diff(time)))
    width = max(round(0.05 / period), 1)
    q = np.stack([signal.values for signal in attitude], axis=1)
    a, b = q[:-width], q[width:]
    vector = a[:, 3:] * b[:, :3] - b[:, 3:] * a[:, :3] - np.cross(a[:, :3], b[:, :3])
    scalar = np.sum(a * b, axis=1)
    angle = 2.0 * np.arctan2(np.linalg.norm(vector, axis=1), np.abs(scalar))
    size = np.maximum(np.linalg.norm(vector, axis=1), 1e-12)
    rates = vector / size[:, None] * (np.sign(scalar) * angle)[:, None] / (width * period)
    middle = 0.5 * (time[width:] + time[:-width])
    results, lag = [], 0.0
    for axis, signal in enumerate(group):
        turning = Signal("", "", "", "", "", "", middle, rates[:, axis])
        smooth = replace(signal, values=np.convolve(signal.values, np.ones(width) / width, "same"))
        _, lag = compare_lag(turning, smooth) if axis == 0 else (0.0, lag)  # three axes have one clock
        _step, shown, turned = resample(replace(smooth, time=smooth.time - lag), turning)
        r = float(np.corrcoef(shown, turned)[0, 1]) if len(shown) else np.nan
        results.append((r, float(shown @ turned / (turned @ turned)) if len(shown) else np.nan))
    strong = [share for r, share in results if r > SLOPE]
    unit = next((u for u, one in TURNS if strong and all(0.6 < share * one < 1.6 for share in strong)), "")
    numbers = ", ".join(f"{share:.3g} (r {r:.2f})" for r, share in results)
    sure = bool(unit) and len(strong) == 3
    told = f"{body} gyro: {stem}x, y, z in {unit or 'no known unit'}; shares of the turning {numbers}"
    return told + (f", {1e3 * lag:.0f} ms after the attitude" if lag else ""), sure


def tell_angles(body: str, stem: str, group: Sequence[Signal], attitude: Sequence[Signal]) -> tuple[str, bool]:
    """In which unit roll, pitch and yaw show the attitude, and which of them with the other sign."""
    x, y, z, w = (signal.values for signal in attitude)
    euler = (
        np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
        np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))),
    )
    shares = []
    for angle, signal in zip(euler, group):
        _, shown, seen = resample(signal, replace(attitude[0], values=angle))
        good = len(shown) and min(shown.std(), seen.std()) > 1e-6
        shares.append(
            (float(np.corrcoef(shown, seen)[0, 1]), float(shown.std() / seen.std())) if good else (np.nan, np.nan)
        )
    strong = [share for r, share in shares if abs(r) > SLOPE]
    unit = next(
        (u for u, one in (("rad", 1.0), ("deg", np.pi / 180)) if strong and all(0.6 < s * one < 1.6 for s in strong)),
        "",
    )
    turned = [name for name, (r, _) in zip(("roll", "pitch", "yaw"), shares) if r < -SLOPE]
    numbers = ", ".join(f"{share:.3g} (r {r:.2f})" for r, share in shares)
    told = f"{body} angles: {stem}roll, pitch, yaw in {unit or 'no known unit'}"
    told += f", {' and '.join(turned)} with the other sign" if turned else ""
    return f"{told}; shares of the attitude {numbers}", bool(unit) and len(strong) == 3


def tell_gravity(body: str, stem: str, group: Sequence[Signal]) -> tuple[str, bool]:
    """In which unit an accelerometer shows gravity where it is stillest."""
    norm = np.sqrt(np.sum([signal.values**2 for signal in group], axis=0))
    width = max(round(REST_S * group[0].rate), 2)
    starts = range(0, max(len(norm) - width, 1), max(width // 4, 1))
    spread, rest = min(
        (float(np.std(norm[i : i + width])), float(np.median(norm[i : i + width])))
        for i in starts
        if np.median(norm[i : i + width]) > 0.0
    )
    unit = next((unit for unit, one in GRAVITIES if 0.9 < rest * one / 9.80665 < 1.1), "")
    told = f"{body} accelerometer: {stem}x, y, z shows {rest:.4g} at rest (spread {spread:.2g})"
    return f"{told}, so it is in {unit}" if unit else f"{told}: no gravity in any unit", bool(unit)
