"""Whether logs show what is hidden, and tell it from its nearest look-alike: linear, about what really happened.

A hidden law is a force along the log. What it adds to free predictions of a window follows from the nominal rig,
linearised about the motion; disturbances, counted as Ornstein's and Uhlenbeck's whatever they are, and the encoders'
noise limit how well it is seen, and where a window starts is not known. A look-alike may have any size; what it leaves
of the hidden law's trace tells them apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from .hidden import Hidden, Scale, Values, name_effect
from .rig import JITTER, Rig
from .sensors import Disturbance, Sensors
from .tree import choose_dynamics
from .trial import Track

WINDOW, WINDOW_ARM, WINDOWS = 1.0, 0.5, 24
"""Length of a free prediction [s], of more than two joints, and how many of a session are looked at."""
FLOOR = 1e-12
"""Of a covariance's diagonal, of its largest entry, so that it can be factored."""
SEEN, APART = 8.0, 6.0
"""Sigma from nothing and from the nearest look-alike from which on a log is said to show it and to tell it apart: well
above what chance gives the best of some fifty look-alikes, set before any diagnosis was run."""
RESTS = (-3.0, -1.0, 0.0, 1.0, 3.0)
"""Where a spring that looks like something else may rest, in spreads from the middle: each a look-alike of its own."""
Column = np.ndarray
"""Force of a law along a log, (T, n) [N, N m]."""


@dataclass(frozen=True)
class Visibility:
    """How visible one hidden effect is."""

    seen: float  # sigma from nothing, what else is hidden and the build's jitter being free
    apart: float  # likewise from the nearest look-alike
    nearest: str  # that look-alike's id
    shift: float  # rms change of free predictions within a second, in units of the encoders' noise
    alike: list[str]  # ids of the look-alikes within `APART` that explain more than half of it

    @property
    def detectable(self) -> bool:
        """Whether the logs show it."""
        return self.seen >= SEEN

    @property
    def separable(self) -> bool:
        """Whether they tell it from all look-alikes too."""
        return self.detectable and self.apart >= APART


@dataclass(frozen=True)
class Evidence:
    """One log as it happened: the track, its logged inputs without noise (T, m)."""

    track: Track
    inputs: np.ndarray


def measure_visibility(
    rig: Rig, scale: Scale, logs: Sequence[Evidence], effects: Sequence[tuple[Hidden, Values]], sensors: Sensors,
    disturbance: Disturbance, real: Rig, small: Sequence[tuple[Hidden, Values]],
) -> tuple[list[Visibility], float]:  # fmt: skip
    """How visible each hidden effect is in a session's logs, and what nobody asks for.

    That is what the build's jitter and small effects make of free predictions, rms in sigma of what noise and
    disturbances make of them: 1 doubles a chi square.
    """
    rivals, n = list_rivals(rig, scale), len(rig.links)
    weights = [trace_weight(rig, log, scale) for log in logs]
    every = [
        [
            trace_build(rig, real, log, small, scale),
            *(trace_hidden(rig, log, h, v, scale) for h, v in effects),
            *(trace(rig, log, kind, j, v, scale) for _, kind, j, v in rivals),
            *(weight * np.eye(n)[j] for j in range(n)),
        ]
        for log, weight in zip(logs, weights)
    ]
    traces, shift = whiten_windows(rig, scale, logs, every, sensors, disturbance)
    unasked, own, other, heavy = np.split(traces, np.cumsum([1, len(effects), len(rivals)]), axis=1)
    shift = shift[1:]
    usual = [(k, scale.carried[j] if kind == "inertia" else 1.0) for k, (_, kind, j, _) in enumerate(rivals)
             if kind in ("inertia", "gain")]  # fmt: skip
    jitter = np.concatenate([other[:, [k for k, _ in usual]] * [size for _, size in usual], heavy], axis=1)
    ridge = np.concatenate([JITTER * jitter, np.eye(jitter.shape[1])])
    found = []
    for i in range(len(effects)):
        beside = np.delete(own, i, axis=1)
        names = sorted({name for name, *_ in rivals} - {h.effect for h, _ in effects})
        left = {name: min(residual(own[:, i], np.concatenate([beside, other[:, some]], axis=1), ridge)
                          for some in list_forms(rivals, name)) for name in names}  # fmt: skip
        seen = residual(own[:, i], beside, ridge)
        nearest = min(left, key=lambda name: left[name])
        alike = [name for name, sigma in left.items() if sigma < min(APART, 0.5 * seen)]
        found.append(Visibility(round(seen, 2), round(left[nearest], 2), nearest, round(float(shift[i]), 3), alike))
    return found, round(float(np.sqrt(np.mean(unasked**2))), 3)


def residual(y: np.ndarray, free: np.ndarray, ridge: np.ndarray) -> float:
    """Length of what is left of y beside free columns, and columns whose sizes are about one."""
    padded = np.concatenate([free, np.zeros((len(ridge) - len(y), free.shape[1]))])
    columns = np.concatenate([padded, ridge], axis=1)
    size = np.linalg.norm(columns, axis=0)
    target = np.concatenate([y, np.zeros(len(ridge) - len(y))])
    solution = np.linalg.lstsq(columns / np.maximum(size, 1e-30), target, rcond=1e-9)[0]
    return float(np.linalg.norm(target - columns / np.maximum(size, 1e-30) @ solution))


def list_rivals(rig: Rig, scale: Scale) -> list[tuple[str, str, int, Values]]:
    """Laws of the catalogue as columns: id, kind, joint, sizes; an id with several may mix them (`list_forms`)."""
    found: list[tuple[str, str, int, Values]] = []
    for j in range(len(rig.links)):
        several: dict[str, list[Values]] = {
            "coulomb": [{}], "stiction": [{"velocity": s * scale.speed[j]} for s in (0.05, 0.2)], "viscous": [{}],
            "bias": [{}], "inertia": [{}], "spring": [{"rest": scale.middle[j] + s * scale.spread[j]} for s in RESTS],
            **({"offset": [{}]} if rig.links[j].rotary else {}),
        }  # fmt: skip
        found += [(name_effect(rig, kind, j), kind, j, v) for kind, sizes in several.items() for v in sizes]
    for i, drive in enumerate(rig.drives):
        u, rate = np.abs(scale.inputs[:, i]), np.abs(np.diff(scale.inputs[:, i])) / scale.period
        several = {
            "gain": [{}], "delay": [{"delay": s} for s in (0.01, 0.03)],
            "lag": [{"time_constant": s} for s in (0.01, 0.03)],
            "backlash": [{"gap": s * scale.input[i]} for s in (0.1, 0.4)],
            "rate_limit": [{"rate": float(np.quantile(rate, s))} for s in (0.7, 0.9)],
            "saturation": [{"limit": float(np.quantile(u, s))} for s in (0.7, 0.9)],
        }  # fmt: skip
        j = drive.joint
        found += [(name_effect(rig, kind, j), kind, j, v) for kind, sizes in several.items() for v in sizes]
    return found


def list_forms(rivals: Sequence[tuple[str, str, int, Values]], name: str) -> list[list[int]]:
    """Columns of one look-alike: all together, of a spring each for itself."""
    some = [k for k, rival in enumerate(rivals) if rival[0] == name]
    return [[k] for k in some] if rivals[some[0]][1] == "spring" else [some]


def trace_weight(rig: Rig, log: Evidence, scale: Scale) -> Column:
    """Gravity's force along a log."""
    stride, find, zero = max(round(0.02 / scale.period), 1), choose_dynamics(rig), np.zeros(len(rig.links))
    rows = log.track.moved[::stride, 0]
    return np.repeat([-find(q, zero)[1] for q in rows], stride, axis=0)[: len(log.inputs)]


def trace_build(rig: Rig, real: Rig, log: Evidence, small: Sequence[tuple[Hidden, Values]], scale: Scale) -> Column:
    """Force that the twin lacks along a log because numbers are a little off, and of small effects."""
    stride, told, true = max(round(0.02 / scale.period), 1), choose_dynamics(rig), choose_dynamics(real)
    moved, rows = log.track.moved, []
    speed = np.diff(moved[:, 1], axis=0, append=moved[-1:, 1]) / scale.period
    for k in range(0, len(moved), stride):
        (M, h), (M_real, h_real) = (find(moved[k, 0], moved[k, 1]) for find in (told, true))
        rows.append((M - M_real) @ speed[k : k + stride].mean(0) + h - h_real)
    column = np.repeat(rows, stride, axis=0)[: len(moved)]
    for i, (believed, built) in enumerate(zip(rig.drives, real.drives)):
        column[:, built.joint] += (built.gear - believed.gear) * log.inputs[:, i]
    for j, (believed_link, built_link) in enumerate(zip(rig.links, real.links)):
        if believed_link.damping:  # where the MJCF has forgotten it, it is hidden
            column[:, j] -= (built_link.damping - believed_link.damping) * moved[:, 1, j]
    return column + sum(trace_hidden(rig, log, hidden, values, scale) for hidden, values in small)


def trace_hidden(rig: Rig, log: Evidence, hidden: Hidden, values: Values, scale: Scale) -> Column:
    """Force of a hidden effect along a log; outside the catalogue, all that the twin lacks."""
    if not hidden.outside:
        column = trace(rig, log, hidden.kind, hidden.joint, values, scale)
        size = {"gain": values.get("gain", 1.0) - 1.0, "delay": 1.0, "lag": 1.0, "backlash": 1.0, "rate_limit": 1.0,
                "saturation": 1.0}.get(hidden.kind, next(iter(values.values())))  # fmt: skip
        return column * size
    column = log.track.lacking.copy()
    for i, drive in enumerate(rig.drives):
        column[:, drive.joint] += drive.gear * (log.track.given[:, i] - log.inputs[:, i])
    return column


def trace(rig: Rig, log: Evidence, kind: str, joint: int, values: Mapping[str, float], scale: Scale) -> Column:
    """Force along a log of a law of size one; of actuators' laws but the gain, of the size given."""
    column = np.zeros_like(log.track.lacking)
    q, v, friction = log.track.moved[:, 0, joint], log.track.moved[:, 1, joint], log.track.moved[:, 2, joint]
    most = max(float(np.abs(friction).max()), 1e-30)
    sense = np.where(v != 0.0, np.sign(v), -friction / most)
    for i, drive in enumerate(rig.drives):
        if drive.joint == joint and kind in ("gain", "delay", "lag", "backlash", "rate_limit", "saturation"):
            u = log.inputs[:, i]
            acts = u if kind == "gain" else distort(u, kind, next(iter(values.values())), scale.period) - u
            column[:, joint] = drive.gear * acts
            return column
    if kind == "offset":
        return trace_offset(rig, log, joint, scale)
    drive = sum((d.gear * log.inputs[:, i] for i, d in enumerate(rig.drives) if d.joint == joint), 0.0 * v)
    column[:, joint] = {
        "coulomb": lambda: -sense,
        "stiction": lambda: -sense * np.exp(-((v / values["velocity"]) ** 2)),
        "viscous": lambda: -v,
        "drag": lambda: -np.abs(v) * v,
        "bias": lambda: np.ones_like(v),
        "spring": lambda: -(q - values["rest"]),
        "inertia": lambda: -np.diff(v, append=v[-1:]) / scale.period,
        "fade": lambda: -np.abs(v) * drive * (drive * v > 0.0),
        "cogging": lambda: np.sin(2.0 * np.pi * values["waves"] * q + values["phase"]),
        "tight_spot": lambda: -sense * np.exp(-(((q - values["place"]) / values["width"]) ** 2)),
        **dict.fromkeys(("rate_bias", "rate_scale"), lambda: np.zeros_like(v)),
    }[kind]()
    return column


def trace_offset(rig: Rig, log: Evidence, joint: int, scale: Scale) -> Column:
    """Force per rad along a log of a twin that believes an encoder which reads too much."""
    stride, find, eps = max(round(0.02 / scale.period), 1), choose_dynamics(rig), 1e-5
    moved, off = log.track.moved, eps * np.eye(len(rig.links))[joint]
    speed = np.diff(moved[:, 1], axis=0, append=moved[-1:, 1]) / scale.period
    rows = []
    for k in range(0, len(moved), stride):
        (M, h), (M_off, h_off) = (find(q, moved[k, 1]) for q in (moved[k, 0], moved[k, 0] + off))
        rows.append(((M_off - M) @ speed[k : k + stride].mean(0) + h_off - h) / eps)
    return np.repeat(rows, stride, axis=0)[: len(moved)]


def distort(u: np.ndarray, kind: str, size: float, period: float) -> np.ndarray:
    """Inputs (T,) after a drive with one fault of that size."""
    if kind == "delay":
        late = np.arange(len(u)) - size / period
        return np.interp(late, np.arange(len(u)), u)
    if kind == "saturation":
        return np.clip(u, -size, size)
    out, held, keep = np.empty_like(u), u[0], np.exp(-period / size) if kind == "lag" else 0.0
    for k, wanted in enumerate(u):
        if kind == "lag":
            mean = wanted + (held - wanted) * (1.0 - keep) * size / period
            held = wanted + (held - wanted) * keep
            out[k] = mean
            continue
        reach = 0.5 * size if kind == "backlash" else size * period
        held = (
            min(max(held, wanted - reach), wanted + reach)
            if kind == "backlash"
            else held + min(max(wanted - held, -reach), reach)
        )
        out[k] = held
    return out


def whiten_windows(
    rig: Rig, scale: Scale, logs: Sequence[Evidence], columns: Sequence[Sequence[Column]], sensors: Sensors,
    disturbance: Disturbance,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Traces of forces in free predictions, in units of noise, (rows, columns), and rms shift of each column."""
    n, stride = len(rig.links), max(round(0.02 / scale.period), 1)
    steps = round((WINDOW if n < 3 else WINDOW_ARM) / scale.period / stride)
    spans = [(i, k) for i, log in enumerate(logs) for k in range(0, len(log.inputs) - steps * stride, steps * stride)]
    used = [spans[i] for i in np.unique(np.linspace(0, len(spans) - 1, WINDOWS).round().astype(int))]
    noise = scale.spread * np.hypot(sensors.noise, sensors.quantum / np.sqrt(12.0))
    noisy = np.tile(noise**2 / stride, steps)
    dt = stride * scale.period
    apart = np.abs(np.subtract.outer(np.arange(steps), np.arange(steps))) * dt / disturbance.time
    alike = np.kron(np.exp(-apart), np.diag((disturbance.strength * scale.force) ** 2))
    rows, total, weight = [], np.zeros(len(columns[0])), np.sqrt(len(spans) / len(used))
    for i, first in used:
        forces = np.stack([c[first : first + steps * stride].reshape(steps, stride, n).mean(1) for c in columns[i]], 2)
        response, start, traced = respond(rig, logs[i], first, stride, steps, scale.period, forces)
        covariance = response @ alike @ response.T + np.diag(noisy)
        covariance += start @ np.diag(np.concatenate([scale.spread, scale.speed]) ** 2) @ start.T
        lower = cholesky(covariance + FLOOR * covariance.max() * np.eye(len(covariance)), lower=True)
        rows.append(weight * solve_triangular(lower, traced, lower=True))
        total += np.mean((traced / np.tile(noise, steps)[:, None]) ** 2, axis=0)
    return np.concatenate(rows), np.sqrt(total / len(used))


def respond(
    rig: Rig, log: Evidence, first: int, stride: int, steps: int, period: float, forces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Change of positions in a window, (steps n, ·): by pulses of force, the start's state, forces (steps, n, C)."""
    find, n, dt, eps = choose_dynamics(rig), len(rig.links), stride * period, 1e-6
    damping, gears = np.array([link.damping for link in rig.links]), np.zeros((n, len(rig.drives)))
    for i, drive in enumerate(rig.drives):
        gears[drive.joint, i] = drive.gear

    def accelerate(q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
        M, h = find(q, v)
        return np.linalg.solve(M, force - h - damping * v)

    pulses = np.zeros((steps, n, steps * n))
    pulses[np.arange(steps).repeat(n), np.tile(np.arange(n), steps), np.arange(steps * n)] = 1.0
    driven = np.concatenate([pulses, np.zeros((steps, n, 2 * n)), forces], axis=2)
    moved, faster = np.zeros((2, n, driven.shape[2]))
    moved[:, steps * n : steps * n + n], faster[:, steps * n + n : steps * n + 2 * n] = np.eye(n), np.eye(n)
    out = np.empty((steps, n, driven.shape[2]))
    for k in range(steps):
        at = first + k * stride
        q, v = log.track.moved[at, 0], log.track.moved[at, 1]
        force = gears @ log.inputs[at : at + stride].mean(0)
        here = accelerate(q, v, force)
        slope = np.stack([(accelerate(q + eps * e, v, force) - here) / eps for e in np.eye(n)], 1)
        slower = np.stack([(accelerate(q, v + eps * e, force) - here) / eps for e in np.eye(n)], 1)
        push = slope @ moved + slower @ faster + np.linalg.solve(find(q, v)[0], driven[k])
        faster = faster + dt * push
        moved = moved + dt * faster
        out[k] = moved
    flat = out.reshape(steps * n, -1)
    return flat[:, : steps * n], flat[:, steps * n : steps * n + 2 * n], flat[:, steps * n + 2 * n :]
