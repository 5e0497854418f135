"""What a fit by hand says of DFKI's simple pendulum, without MuJoCo: python -m examples.simple_pendulum.by_hand FOLDER.

Equation, with the angle from hanging down: I q'' + G sin(q + zero) + F sgn q' + b q' = k τ(t - late), with τ as logged.
Nominal are a point mass m at 0.5 m, so I = m l², G = m g l, and F = b = zero = late = 0, k = 1.
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

MASS = dict.fromkeys(("energy_shaping", "ilqr", "pd_swingup_failure", "pd_system_identification"), 0.6755)
MASS |= {"energy_shaping_1kg": 1.0}
"""Nominal mass of the bob, log by log [kg]."""
LENGTH, GRAVITY = 0.5, 9.81  # m, m/s²
SPANS = {
    "energy_shaping": ((0.1, 4.6), (6.8, 9.0), (12.0, 14.0), (16.3, 17.6)),
    "energy_shaping_1kg": ((0.1, 8.6), (12.5, 14.2), (17.45, 19.3)),
    "ilqr": ((0.1, 2.8), (3.25, 5.0), (10.2, 17.0)),
    "pd_swingup_failure": ((11.8, 17.0),),
    "pd_system_identification": ((0.05, 3.85),),
}
"""Where the pendulum swings and nobody touches it [s]; find_pushes shows where somebody does."""
FREE_SWING = (11.9, 16.8)  # s of pd_swingup_failure: let go by hand, under a constant torque
SLIDING = 0.03  # rad/s over which simulated dry friction turns round
DT = 0.005  # s


def rigid(name: str) -> tuple[float, float]:
    """Nominal inertia [kg m²] and weight times length [N m] of a log."""
    return MASS[name] * LENGTH**2, MASS[name] * LENGTH * GRAVITY


@dataclass
class Log:
    """A log on an even grid of 5 ms.

    Attributes:
        time: [s].
        position, velocity, torque: columns of the CSV, resampled [rad, rad/s, N m].
        angle, rate: from positions alone, without lag.
    """

    time: Array
    position: Array
    velocity: Array
    torque: Array
    period: float
    angle: Array = field(init=False)
    rate: Array = field(init=False)

    def __post_init__(self) -> None:
        self.angle = low_pass(self.position, DT, min(20.0, 0.4 / self.period))
        self.rate = np.gradient(self.angle, DT)

    def rows(self, begin: float, end: float) -> slice:
        """Samples between two times [s]."""
        return slice(*np.searchsorted(self.time, [begin, end]))


def read_log(folder: Path, name: str) -> Log:
    """Log `NAME.csv`."""
    columns = read_columns(folder / f"{name}.csv")
    time = np.arange(columns["time"][1], columns["time"][-1], DT)
    even = [np.interp(time, columns["time"], columns[key]) for key in ("position", "velocity", "torque")]
    return Log(time, *even, float(np.median(np.diff(columns["time"]))))


def accumulate(values: Array) -> Array:
    """Integral from the start by trapezoids, (n,)."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * DT)])


def find_pushes(log: Log, name: str, friction: float = 0.25, limit: float = 1.0) -> list[tuple[float, float]]:
    """Where somebody else moved energy: time [s] and J within a second.

    Gains beyond the motor's work, as no friction gives; and losses beyond it and dry friction [N m].
    """
    inertia, weight = rigid(name)
    strange = 0.5 * inertia * log.rate**2 - weight * np.cos(log.angle) - accumulate(log.torque * log.rate)
    second, path = round(1.0 / DT), friction * accumulate(np.abs(log.rate))
    gain = strange[second:] - strange[:-second]
    gain = np.where(gain > 0.0, gain, np.minimum(gain + path[second:] - path[:-second], 0.0))
    pushes: list[tuple[float, float]] = []
    for index in np.flatnonzero(np.abs(gain) > limit):
        time, joules = float(log.time[index]) + 0.5, float(gain[index])
        if not pushes or time - pushes[-1][0] > 1.5:
            pushes.append((time, joules))
        elif abs(joules) > abs(pushes[-1][1]):
            pushes[-1] = (time, joules)
    return pushes


def fit_energy(log: Log, spans: tuple[tuple[float, float], ...], span: float = 0.2, late: float = 0.0) -> Fit:
    """Least squares of the motor's work over spans [s] on gains of energy and on dry friction."""
    torque = np.interp(log.time - late, log.time, log.torque)
    terms = [log.rate**2 / 2.0, -np.cos(log.angle), accumulate(np.abs(log.rate)), accumulate(torque * log.rate)]
    begins = np.concatenate([np.arange(begin, end - span, span / 2.0) for begin, end in spans])
    first, last = np.searchsorted(log.time, begins), np.searchsorted(log.time, begins + span)
    rows = np.array([term[last] - term[first] for term in terms]).T
    return fit_linear(rows[:, :3], rows[:, 3], ("I", "G", "F"), 8)


def fit_smoothed(log: Log, cutoff: float = 8.0) -> Fit:
    """Least squares of torque on smoothed and differentiated motion of the whole log: what one should not do here."""
    terms = [np.gradient(log.rate, DT), np.sin(log.angle), np.sign(log.rate), log.rate, np.ones_like(log.rate)]
    rows = low_pass(np.array(terms), DT, cutoff)[:, 40:-40].T
    return fit_linear(rows, low_pass(log.torque, DT, cutoff)[40:-40], ("I", "G", "F", "b", "o"), 100)


def swing(state: Array, torque: Array, p: Array) -> Array:
    """Rate of (q, v) under a torque; p are I, G, F, b, k, late, zero."""
    q, v = state
    inertia, weight, dry, viscous, gain, _, zero = p
    return np.array(
        [v, (gain * torque - dry * np.tanh(v / SLIDING) - viscous * v - weight * np.sin(q + zero)) / inertia]
    )


def fit_windows(
    log: Log, name: str, spans: tuple[tuple[float, float], ...], free: tuple[str, ...], window: float = 0.5
) -> Fit:
    """Fit by simulating windows [s] within spans; what is not free is nominal, and F starts at 0.25 N m."""
    inertia, weight = rigid(name)
    start = {"I": inertia, "G": weight, "F": 0.25, "b": 0.0, "k": 1.0, "late": 0.0, "zero": 0.0}
    sizes = {"I": 3e-4, "G": 6e-3, "F": 1e-3, "b": 1e-3, "k": 2e-3, "late": 5e-4, "zero": 5e-4}
    length = round(window / DT)
    begin = np.concatenate([np.arange(first, last - window, 0.1) for first, last in spans])
    begin = np.searchsorted(log.time, begin)
    begin = begin[(begin > 20) & (begin + length + 20 < len(log.time))]

    def residuals(p: Array) -> list[Array]:
        state = np.array([log.angle[begin], log.rate[begin]])[:, :, None] * np.ones(p.shape[1])
        at, left = log.time[begin][:, None] - p[5], []
        for step in range(length):
            times = [at + (step + part) * DT for part in (0.0, 0.5, 1.0)]
            inputs = [np.interp(time, log.time, log.torque) for time in times]
            state = integrate(lambda x, u: swing(x, u, p[:, None, :]), state, inputs, DT)
            if step % 4 == 3:
                left.append(state[:1] - log.angle[begin + step + 1][:, None])
        return [np.array(left)]

    return fit_simulation(residuals, start, {key: sizes[key] for key in free}, 10)


def fit_free_swing(log: Log) -> Fit:
    """The swings of pd_swingup_failure, let go by hand: all in one window, with the nominal weight.

    The torque is constant, so gain k and zero of the angle are one number; here it is the gain.
    """
    begin, end = FREE_SWING
    return fit_windows(log, "pd_swingup_failure", ((begin, end),), ("I", "F", "b", "k"), 1.0)


def describe_torque(log: Log) -> str:
    """What the torque column is: largest, and how fast it follows the velocity's sign where a controller switches."""
    busy = np.abs(log.rate) > 0.5
    along = np.mean(np.sign(log.torque[busy]) == np.sign(log.rate[busy]))
    return f"largest torque {np.abs(log.torque).max():.2f} N m; along the velocity {100 * along:.0f} % of the time"


def main() -> None:
    """Print all findings."""
    parser = argparse.ArgumentParser(description="Fits by hand of DFKI's simple pendulum.")
    parser.add_argument("folder", type=Path, help="with energy_shaping.csv and so on")
    folder = parser.parse_args().folder
    logs = {name: read_log(folder, name) for name in MASS}
    for name, log in logs.items():
        inertia, weight = rigid(name)
        late, gain = find_lateness(
            log.rate, low_pass(log.velocity, DT, 0.4 / log.period), DT, np.arange(-0.02, 0.0201, 5e-4)
        )
        print(f"{name}: nominal I {inertia:.4f} kg m², G {weight:.3f} N m; {describe_torque(log)}")
        print(f"  velocity against position: late {1e3 * late:.1f} ms, gain {gain:.3f}")
        print("  pushes:", ", ".join(f"{joules:+.1f} J at {time:.1f} s" for time, joules in find_pushes(log, name)))
        fit = fit_smoothed(log)
        print(f"  smoothed, whole log: explains {fit.share:.3f}  {fit}")
        fit = fit_energy(log, SPANS[name])
        print(f"  energy, untouched:   explains {fit.share:.3f}  {fit}  G/I {fit['G'] / fit['I']:.2f}")
        shares = {late: round(fit_energy(log, SPANS[name], late=1e-3 * late).share, 3) for late in range(-30, 31, 6)}
        print(f"  energy, torque shifted by ms: explains {shares}")
        free = ("I", "F", "b", "k") if name == "pd_swingup_failure" else ("I", "F", "b", "k", "late")
        for chosen in (("I", "F"), free):
            fit = fit_windows(log, name, SPANS[name], chosen)
            print(f"  windows of 0.5 s: {fit}; leaves {1e3 * fit.left[0][0]:.0f} mrad", flush=True)
    log = logs["pd_swingup_failure"]
    print(f"free swings under {log.torque[log.rows(*FREE_SWING)].mean():.4f} N m: {fit_free_swing(log)}")
    for begin, end in ((1.6, 3.5), (5.6, 6.5), (8.6, 9.9), (18.0, 40.0)):
        rest = log.rows(begin, end)
        angle, torque = log.position[rest].mean(), log.torque[rest].mean()
        weight = rigid("pd_swingup_failure")[1] * np.sin(angle)
        print(f"  at rest from {begin} s: {angle:.4f} rad under {torque:.4f} N m; its weight {weight:.4f} N m")


if __name__ == "__main__":
    main()
