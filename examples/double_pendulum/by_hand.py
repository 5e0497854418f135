"""What a fit by hand says of DFKI's double pendulum, without MuJoCo: python -m examples.double_pendulum.by_hand FOLDER.

Equations with both angles from hanging down, the elbow's relative:
    (a + e + 2 β cos q2) q1'' + (e + β cos q2) q2'' - β sin q2 (2 q1' + q2') q2' + G1 sin q1 + G2 sin(q1 + q2) = τ1 - F1
    (e + β cos q2) q1'' + M22 q2'' + β sin q2 q1'² + G2 sin(q1 + q2) = τ2 - F2
with a = I1 + m2 l1² + (gr² + gr + 1) Ir, e = I2 - gr Ir, M22 = I2 + gr² Ir, β = m2 l1 r2, G1 = (m1 r1 + m2 l1) g,
G2 = m2 r2 g, and F1, F2 friction, dry and viscous (b1, b2).
Angles are the log's plus z1, z2: zero is set at the start, where friction holds the links a little aside.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from examples.by_hand import (
    Array,
    Fit,
    find_lateness,
    fit_linear,
    fit_simulation,
    integrate,
    low_pass,
    read_columns,
)

LOGS = ("00", "02", "04", "11", "13")
DT = 0.002  # s
RIGID = {"a": 0.11116, "e": 0.023464, "M22": 0.026681, "β": 0.033320, "G1": 3.42477, "G2": 1.08954}
"""DFKI's identified parameters in the terms above [kg m², N m]."""
FRICTION = {"b1": 0.001, "b2": 0.001, "F1": 0.14608, "F2": 0.12252}
"""DFKI's, viscous [N m s/rad] and dry [N m]; theirs is cf atan(100 v), which levels off at cf π/2."""
SLIDING = 0.03  # rad/s over which simulated dry friction turns round


@dataclass
class Log:
    """A log on an even grid of 2 ms.

    Attributes:
        columns: of the CSV, resampled, by name.
        angle, rate, pull: (2, n) joints [rad, rad/s, rad/s²], from positions alone, without lag.
    """

    columns: dict[str, Array]
    angle: Array = field(init=False)
    rate: Array = field(init=False)
    pull: Array = field(init=False)

    def __post_init__(self) -> None:
        raw = np.array([self.columns["pos_meas1"], self.columns["pos_meas2"]])
        self.angle = low_pass(raw, DT, 40.0)
        self.rate = np.gradient(self.angle, DT, axis=1)
        self.pull = np.gradient(self.rate, DT, axis=1)

    def torque(self, column: str) -> Array:
        """(2, n) torque [N m] of `con` or `meas`."""
        return np.array([self.columns[f"tau_{column}1"], self.columns[f"tau_{column}2"]])


def read_log(folder: Path, name: str) -> Log:
    """Log `design_A_NAME.csv`."""
    columns = read_columns(folder / f"design_A_{name}.csv")
    time = np.arange(columns["time"][2], columns["time"][-2], DT)
    return Log({key: np.interp(time, columns["time"], column) for key, column in columns.items()})


def fit_current(log: Log, joint: int, cutoff: float = 20.0) -> tuple[float, Fit]:
    """How tau_meas follows from tau_con: lateness [s]; gain, offset [N m] and share of q'' [kg m²] by least squares."""
    commanded, reported = (low_pass(log.torque(column)[joint], DT, cutoff)[100:-100] for column in ("con", "meas"))
    pull = low_pass(log.pull[joint], DT, cutoff)[100:-100]
    fits: dict[float, Fit] = {}
    for late in np.arange(0.0, 0.0121, 0.001):
        shifted = np.interp(np.arange(len(commanded)) - late / DT, np.arange(len(commanded)), commanded)
        rows = np.array([shifted, np.ones_like(pull), pull])[:, 20:].T
        fits[late] = fit_linear(rows, reported[20:], ("gain", "offset", "pull"), 500)
    best = max(fits, key=lambda late: fits[late].share)
    return best, fits[best]


def find_spikes(log: Log, joint: int) -> tuple[int, int, float]:
    """Spikes of tau_meas over 0.15 N m, reversals of the joint, and the median speed at which spikes come [rad/s]."""
    reported = log.torque("meas")[joint]
    jump = np.abs(reported - low_pass(reported, DT, 10.0)) > 0.15
    first = np.flatnonzero(jump & ~np.roll(jump, 1) & (np.arange(len(jump)) > 100))
    first = first[np.diff(first, prepend=-100) > 20]
    reversals = np.count_nonzero(np.diff(np.sign(low_pass(log.rate[joint], DT, 10.0))))
    return len(first), reversals, float(np.median(np.abs(log.rate[joint][first])))


def fit_smoothed(logs: list[Log], column: str, late: float = 0.0, cutoff: float = 8.0) -> Fit:
    """Least squares of torque on smoothed and differentiated motion: what one should not do with these logs."""
    rows, target, groups = [], [], []
    for number, log in enumerate(logs):
        q, v, a = log.angle, log.rate, log.pull
        cos, sin, none, one = np.cos(q[1]), np.sin(q[1]), np.zeros_like(q[0]), np.ones_like(q[0])
        both, swing = np.sin(q[0] + q[1]), (2.0 * a[0] + a[1]) * cos - (2.0 * v[0] * v[1] + v[1] ** 2) * sin
        shoulder = [a[0], a[0] + a[1], none, swing, np.sin(q[0]), both, v[0], none, np.sign(v[0]), none, one, none]
        elbow = [none, a[0], a[1], a[0] * cos + v[0] ** 2 * sin, none, both, none, v[1], none, np.sign(v[1]), none, one]
        torque = np.array([np.interp(np.arange(len(u)) - late / DT, np.arange(len(u)), u) for u in log.torque(column)])
        for regressors, wanted in ((shoulder, torque[0]), (elbow, torque[1])):
            rows.append(low_pass(np.array(regressors), DT, cutoff)[:, 100:-100:5].T)
            target.append(low_pass(wanted, DT, cutoff)[100:-100:5])
            groups.append(np.full(len(target[-1]), number))
    names = (*RIGID, *FRICTION, "o1", "o2")
    return fit_linear(np.concatenate(rows), np.concatenate(target), names, 100, np.concatenate(groups))


def fit_energy(logs: list[Log], column: str = "con", span: float = 0.2) -> Fit:
    """Least squares of the motors' work over spans [s] on gains of energy and on friction; no accelerations."""
    rows, target, groups = [], [], []
    for number, log in enumerate(logs):
        q, v = log.angle, log.rate
        energies = [v[0] ** 2 / 2.0, v[0] ** 2 / 2.0 + v[0] * v[1], v[1] ** 2 / 2.0]
        energies += [np.cos(q[1]) * (v[0] ** 2 + v[0] * v[1]), -np.cos(q[0]), -np.cos(q[0] + q[1])]
        losses = [v[0] ** 2, v[1] ** 2, np.abs(v[0]), np.abs(v[1]), v[0], v[1]]
        edges = np.arange(100, len(q[0]) - 100, round(span / DT))
        total = np.cumsum([*losses, (log.torque(column) * v).sum(axis=0)], axis=1) * DT
        table = np.diff(np.concatenate([energies, total])[:, edges], axis=1).T
        rows.append(table[:, :-1])
        target.append(table[:, -1])
        groups.append(np.full(len(table), number))
    names = (*RIGID, *FRICTION, "o1", "o2")
    return fit_linear(np.concatenate(rows), np.concatenate(target), names, 8, np.concatenate(groups))


SHARED = (*RIGID, *FRICTION, "late", "o1", "o2")


def accelerate(state: Array, torque: Array, p: Array) -> Array:
    """Rate of (q1, q2, v1, v2) under torques; p as SHARED with z1, z2 behind."""
    q1, q2, v1, v2 = state
    a, e, m22, beta, g1, g2, b1, b2, f1, f2, _, o1, o2, z1, z2 = p
    cos, sin, weight = np.cos(q2), np.sin(q2), g2 * np.sin(q1 + q2 + z1 + z2)
    m11, m12 = a + e + 2.0 * beta * cos, e + beta * cos
    t1 = torque[0] + o1 - b1 * v1 - f1 * np.tanh(v1 / SLIDING) + beta * sin * (2.0 * v1 * v2 + v2**2)
    t1 = t1 - g1 * np.sin(q1 + z1) - weight
    t2 = torque[1] + o2 - b2 * v2 - f2 * np.tanh(v2 / SLIDING) - beta * sin * v1**2 - weight
    det = m11 * m22 - m12**2
    return np.array([v1, v2, (m22 * t1 - m12 * t2) / det, (m11 * t2 - m12 * t1) / det])


def simulate(log: Log, column: str, p: Array, window: float, stride: float = 0.25) -> Array:
    """Simulated minus measured angles [rad], (times, 2, windows, m), for m columns of parameters."""
    length, torque = round(window / DT), log.torque(column)
    begin = np.arange(100, log.angle.shape[1] - length - 60, round(stride / DT))
    state = np.concatenate([log.angle[:, begin], log.rate[:, begin]])[:, :, None] * np.ones(p.shape[1])
    place, left = begin[:, None] - p[10][None] / DT, []
    for step in range(1, length + 1):
        inputs = []
        for part in (-1.0, -0.5, 0.0):
            whole = np.floor(place + step + part).astype(int)
            share = place + step + part - whole
            inputs.append(torque[:, whole] * (1.0 - share) + torque[:, whole + 1] * share)
        state = integrate(lambda x, u: accelerate(x, u, p[:, None, :]), state, inputs, DT)
        if step % 10 == 0:
            left.append(state[:2] - log.angle[:, begin + step][:, :, None])
    return np.array(left)


def fit_windows(
    logs: dict[str, Log],
    column: str = "con",
    free: tuple[str, ...] = SHARED[:11],
    zeros: str = "angle",
    window: float = 0.5,
) -> Fit:
    """Fit by simulating windows [s]; every log has its own zero of the angles, or (`zeros` "torque") o1, o2 instead."""
    start = RIGID | FRICTION | {"late": 0.0, "o1": 0.0, "o2": 0.0}
    steps = {name: 5e-4 if name == "late" else 0.02 * max(abs(start[name]), 0.02) for name in free}
    for name in logs:
        start |= {f"z1 {name}": 0.0, f"z2 {name}": 0.0}
        steps |= {f"z1 {name}": 5e-4, f"z2 {name}": 5e-4} if zeros == "angle" else {"o1": 5e-4, "o2": 5e-4}
    places = {name: len(SHARED) + 2 * index for index, name in enumerate(logs)}

    def residuals(p: Array) -> list[Array]:
        own = {name: np.concatenate([p[: len(SHARED)], p[at : at + 2]]) for name, at in places.items()}
        return [simulate(log, column, own[name], window) for name, log in logs.items()]

    return fit_simulation(residuals, start, steps, 4)


def describe_columns(logs: dict[str, Log]) -> None:
    """Print what the columns mean."""
    print(
        "velocity after position: late [ms], gain; tau_meas after tau_con: late [ms], gain, offset [N m], q'' [kg m²]"
    )
    for name, log in logs.items():
        for joint in (0, 1):
            velocity = low_pass(log.columns[f"vel_meas{joint + 1}"], DT, 40.0)
            late, gain = find_lateness(log.rate[joint], velocity, DT, np.arange(-0.01, 0.0101, 2.5e-4))
            line = f"  {name} joint {joint + 1}: {1e3 * late:.2f} {gain:.4f}; "
            if np.any(log.torque("con")[joint]):
                late, fit = fit_current(log, joint)
                line += f"{1e3 * late:.0f} {fit} explains {fit.share:.3f}; "
            print(line + "spikes {}, reversals {}, at {:.2f} rad/s".format(*find_spikes(log, joint)))
        print(f"  {name}: largest tau_fric {max(np.abs(log.columns[f'tau_fric{j}']).max() for j in (1, 2)):.3g} N m")


def main() -> None:
    """Print all findings."""
    parser = argparse.ArgumentParser(description="Fits by hand of DFKI's double pendulum.")
    parser.add_argument("folder", type=Path, help="with design_A_00.csv and so on")
    logs = {name: read_log(parser.parse_args().folder, name) for name in LOGS}
    describe_columns(logs)
    print("\nleast squares on smoothed motion; DFKI:", {**RIGID, **FRICTION})
    for column in ("con", "meas"):
        for chosen in ([name] for name in LOGS):
            fit = fit_smoothed([logs[name] for name in chosen], column)
            print(f"  {column} {chosen[0]}: explains {fit.share:.3f}  {fit}")
        shares = {
            round(1e3 * late): round(fit_smoothed(list(logs.values()), column, late).share, 3)
            for late in np.arange(-0.03, 0.031, 0.006)
        }
        print(f"  {column}, all logs, torque shifted by ms: explains {shares}")
    print("\nwork of the motors against energy and friction")
    for column in ("con", "meas"):
        for chosen in (("11",), ("00", "02", "11", "13"), LOGS):
            fit = fit_energy([logs[name] for name in chosen], column)
            print(f"  {column} {' '.join(chosen)}: explains {fit.share:.3f}  {fit}")
    print("\nsimulated over windows of 0.5 s")
    for column in ("con", "meas"):
        for chosen in (*((name,) for name in LOGS), ("00", "02", "11", "13")):
            fit = fit_windows({name: logs[name] for name in chosen}, column)
            rms = ", ".join(f"{1e3 * one[0]:.1f} {1e3 * one[1]:.1f}" for one in fit.left)
            print(f"  {column} {' '.join(chosen)}: {fit}\n      leaves {rms} mrad", flush=True)


if __name__ == "__main__":
    main()
