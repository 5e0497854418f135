"""An actuator from thrust-stand runs: thrust map, motor, drag, servo, and how pitch disturbs the speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from vpptwin.effects import SIGMAS_90
from vpptwin.estimation.regression import solve_linear
from vpptwin.estimation.series import interpolate
from vpptwin.robots.planar_drone.thrust_stand.bench import BenchRun, Levels
from vpptwin.robots.planar_drone.thrust_stand.thrust_map import CANDIDATES, ThrustMap, choose_map, fit_map
from vpptwin.system.errors import InputError

STEPS_NEEDED = 4
"""Changes of pitch that tell servo lag and delay."""
STEP_SIZE = 0.02
"""Least change of pitch that counts as a step [rad]."""
WINDOW = 0.15
"""Looked at after each step [s]."""
LAGS, DELAYS = (0.005, 0.015, 0.03, 0.06), (0.0, 0.005, 0.012, 0.025)
"""Time constants and delays that a search begins with [s]."""


def bound_90(value: float, std: float) -> tuple[float, float]:
    """Ends of the 90 % interval of a Gaussian."""
    return value - SIGMAS_90 * std, value + SIGMAS_90 * std


@dataclass(frozen=True)
class Constant:
    """One identified number."""

    name: str  # as in a vehicle file, e.g. `motor.k_v`
    value: float  # in `unit`
    std: float  # standard deviation; 0 where it follows from another
    unit: str  # SI
    note: str = ""  # what it rests on, where that is not the measurement alone

    @property
    def interval(self) -> tuple[float, float]:
        """Its 90 % interval."""
        return bound_90(self.value, self.std)


@dataclass(frozen=True)
class HeldOutError:
    """How well a part of the model predicts what it was not fitted to."""

    what: str  # quantity
    error: float  # RMS, in `unit`
    scale: float  # RMS of the quantity itself, or of its changes
    unit: str  # SI


@dataclass(frozen=True)
class Actuator:
    """What thrust-stand runs tell of an actuator."""

    thrust: ThrustMap  # the chosen map
    maps: tuple[ThrustMap, ...]  # all that were tried
    constants: tuple[Constant, ...]  # of motor, drag, servo
    held_out: tuple[HeldOutError, ...]  # errors on what was left out
    levels: Levels  # the means that static fits rest on

    def constant(self, name: str) -> Constant:
        """The constant of that name; KeyError if there is none."""
        return {constant.name: constant for constant in self.constants}[name]


def identify(runs: Sequence[BenchRun], levels: Levels) -> Actuator:
    """Fit everything."""
    maps = tuple(fit_map(c, levels.speed, levels.pitch, levels.thrust, levels.group) for c in CANDIDATES)
    chosen = choose_map(maps)
    electrical, motor_error = fit_motor(levels)
    k_v = electrical[0]
    load, current_error = fit_load(levels, chosen, k_v)
    servo, servo_error = fit_servo(runs, chosen)
    k_q, drag = load[0].value, {c.name: c.value for c in load}
    inertia = fit_inertia(runs, chosen, servo, k_q, drag)
    thrust_error = HeldOutError("thrust at pitches left out", chosen.held_out, float(np.std(levels.thrust)), "N")
    constants = (*electrical, *load, inertia, *servo)
    errors = (thrust_error, motor_error, current_error, servo_error)
    return Actuator(chosen, maps, constants, errors, levels)


def leave_groups_out(inputs: np.ndarray, wanted: np.ndarray, group: np.ndarray) -> float:
    """RMS error of a linear fit on groups that it was not fitted to."""
    missed = np.empty(len(wanted))
    for left_out in np.unique(group):
        out = group == left_out
        missed[out] = inputs[out] @ solve_linear(inputs[~out], wanted[~out])[0] - wanted[out]
    return float(np.sqrt((missed**2).mean()))


def fit_motor(levels: Levels) -> tuple[tuple[Constant, ...], HeldOutError]:
    """k_v and resistance from throttle · battery = R i + ω/k_V (paper Eq. 7)."""
    rotors = levels.speed.shape[1]
    voltage = (levels.throttle * levels.voltage[:, None]).ravel()
    inputs = np.column_stack([levels.current.ravel(), levels.speed.ravel()])
    found, std = solve_linear(inputs, voltage)
    if found[1] <= 0.0 or found[0] <= 0.0:
        raise InputError(
            f"a resistance of {found[0]:.3g} ohm and k_v of {1.0 / found[1]:.3g} rad/s/V",
            "both above 0",
            "check that throttle is 0..1 of the battery's voltage, and the units of current and speed",
        )
    error = leave_groups_out(inputs, voltage, np.repeat(levels.group, rotors))
    constants = (
        Constant("motor.k_v", 1.0 / found[1], std[1] / found[1] ** 2, "rad/s/V"),
        Constant("motor.resistance", found[0], std[0], "ohm"),
    )
    return constants, HeldOutError("motor voltage at pitches left out", error, float(np.std(voltage)), "V")


def fit_load(levels: Levels, thrust: ThrustMap, k_v: Constant) -> tuple[tuple[Constant, ...], HeldOutError]:
    """k_q, no-load current and drag (paper Eq. 5 to 7): i = i_0 + k_q D, D = k_D1 ω² + k_D2 ω² α² + k_D3 ω |α|.

    What speed still changes by in a stretch takes torque too, I ω̇. With a torque channel that sum is measured. Current
    alone gives i_0 and k_q k_D; k_q is then that of an ideal motor, k_q = k_V.
    """
    alpha, speed, current = np.abs(levels.pitch - thrust.offset), levels.speed, levels.current
    terms = np.stack([speed**2, speed**2 * alpha**2, speed * alpha, levels.slope], axis=-1)  # (L, r, 4)
    if levels.torque is not None and np.ptp(levels.torque) > 0.0:
        torque, rotors = np.abs(levels.torque), speed.shape[1]
        (none, k_q), (none_std, k_q_std) = solve_linear(
            np.column_stack([np.full(len(torque), float(rotors)), torque]), current.sum(axis=1)
        )
        drag, drag_std = solve_linear(terms.sum(axis=1), torque)
        error, scale = leave_groups_out(terms.sum(axis=1), torque, levels.group), float(np.std(torque))
        held_out, note = HeldOutError("drag torque at pitches left out", error, scale, "N m"), "from the torque channel"
    else:
        inputs = np.column_stack([np.ones(speed.size), terms.reshape(-1, 4)])
        found, std = solve_linear(inputs, current.ravel())
        k_q, k_q_std, none, none_std = k_v.value, k_v.std, found[0], std[0]
        drag, drag_std = found[1:] / k_q, np.hypot(std[1:], found[1:] * k_q_std / k_q) / k_q
        error = leave_groups_out(inputs, current.ravel(), np.repeat(levels.group, speed.shape[1]))
        held_out = HeldOutError("current at pitches left out", error, float(np.std(current)), "A")
        note = "as of an ideal motor, k_q = k_v: the stand has no torque channel"
    units = {"k_d1": "N m s^2", "k_d2": "N m s^2/rad^2", "k_d3": "N m s/rad"}
    return (
        Constant("motor.k_q", float(k_q), float(k_q_std), "A/(N m)", note),
        Constant("motor.no_load_current", float(none), float(none_std), "A"),
        *(Constant(f"rotor.{k}", float(v), float(s), unit) for (k, unit), v, s in zip(units.items(), drag, drag_std)),
    ), held_out


def lag_pitch(run: BenchRun, time_constant: float, delay: float) -> np.ndarray:
    """Blade pitch behind delay and first-order lag of a run's commands, (n, r) rad (paper, System Identification)."""
    time = run.time
    late = interpolate(time - delay, time, run.pitch)
    # y_k = a y_(k-1) + (1 - a) u_k, a = exp(-Δt/τ): a first-order lag under a held input
    keep = float(np.exp(-run.dt / max(time_constant, 1e-6)))
    filtered, _ = lfilter([1.0 - keep], [1.0, -keep], late, axis=0, zi=late[:1] * keep)
    return np.concatenate([late[:1], filtered[:-1]])  # a command acts from its stamp on


def find_steps(run: BenchRun) -> np.ndarray:
    """Indices at which the pitch command of a rotor jumps and then stays for `WINDOW`."""
    jumps = np.flatnonzero((np.abs(np.diff(run.pitch, axis=0)) > STEP_SIZE).any(axis=1)) + 1
    length = round(WINDOW / run.dt)
    return np.array([j for j in jumps if j + length < len(run.pitch) and j > length], dtype=int)


def fit_servo(runs: Sequence[BenchRun], thrust: ThrustMap) -> tuple[tuple[Constant, ...], HeldOutError]:
    """Time constant and delay of the servo from what thrust does after steps of pitch."""
    places = [(run, find_steps(run)) for run in runs]
    count = sum(len(steps) for _, steps in places)
    if count < STEPS_NEEDED:
        raise InputError(
            f"{count} steps of the pitch command by {STEP_SIZE:g} rad and more",
            f"{STEPS_NEEDED}, for servo.time_constant and its delay",
            "command steps, and hold each for 0.4 s",
        )
    length = round(WINDOW / runs[0].dt)

    def residual(given: np.ndarray, which: int | None = None) -> np.ndarray:
        parts = []
        for run, steps in places:
            if not len(steps):
                continue
            predicted = thrust.predict(run.speed, lag_pitch(run, abs(given[0]), max(given[1], 0.0))).sum(axis=1)
            for number, step in enumerate(steps):
                if which is not None and number % 2 != which:
                    continue
                part = slice(step, step + length)
                wrong = predicted[part] - run.thrust[part]
                parts.append(wrong - wrong[-length // 4 :].mean())  # where it ends is the map's matter
        return np.concatenate(parts)

    def solve(which: int | None) -> tuple[np.ndarray, np.ndarray, float]:
        starts = [np.array([lag, delay]) for lag in LAGS for delay in DELAYS]
        start = min(starts, key=lambda given: float((residual(given, which) ** 2).sum()))
        bounds = ([1e-4, 0.0], [0.5, 0.2])
        found = least_squares(
            lambda given: residual(given, which), np.clip(start, [2e-4, 1e-4], None), bounds=bounds, x_scale=0.01,
            diff_step=1e-3,
        )  # fmt: skip
        return found.x, found.jac, float(found.cost)

    found, jacobian, cost = solve(None)
    freedom = max(len(jacobian) / 20.0, 3.0)  # neighbouring samples are alike
    # cov = (Jᵀ J)⁻¹ s², s² the residual variance over the independent samples (Ljung, 9.4)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * (2.0 * cost / len(jacobian)) * len(jacobian) / freedom
    std = np.sqrt(np.diag(covariance))
    other = residual(solve(0)[0], 1)
    constants = (
        Constant("servo.time_constant", float(found[0]), float(std[0]), "s"),
        Constant("servo.delay", float(found[1]), float(std[1]), "s"),
    )
    spread = float(np.std(np.concatenate([run.thrust for run in runs])))
    return constants, HeldOutError("thrust after steps left out", float(np.sqrt((other**2).mean())), spread, "N")


def fit_inertia(
    runs: Sequence[BenchRun], thrust: ThrustMap, servo: tuple[Constant, ...], k_q: float, drag: dict[str, float]
) -> Constant:
    """Rotor inertia from I (ω₂ - ω₁) = ∫ (i - i_0)/k_q - D dt over 30 ms after steps (paper Eq. 6)."""
    span = 30
    inputs, wanted = [], []
    for run in runs:
        pitch = np.abs(lag_pitch(run, servo[0].value, servo[1].value) - thrust.offset)
        load = (
            drag["rotor.k_d1"] * run.speed**2 + drag["rotor.k_d2"] * run.speed**2 * pitch**2
            + drag["rotor.k_d3"] * run.speed * pitch
        )  # fmt: skip
        load[1:] = 0.5 * (load[1:] + load[:-1])  # a current is that of the step before, and so is the mean load
        torque = (run.current - drag["motor.no_load_current"]) / k_q - load
        total = np.concatenate([np.zeros((1, torque.shape[1])), np.cumsum(torque, axis=0)]) * run.dt
        smooth = np.stack([np.convolve(speed, np.ones(5) / 5.0, "same") for speed in run.speed.T], axis=1)
        for step in find_steps(run):
            for begin in range(step, step + round(WINDOW / run.dt) - span - 1, span // 2):
                inputs.append(total[begin + span + 1] - total[begin + 1])
                wanted.append(smooth[begin + span] - smooth[begin])
    pushed, gained = np.concatenate(inputs), np.concatenate(wanted)
    # both sides are noisy; the torque's integral is the better known one
    slope, std = solve_linear(pushed[:, None], gained)
    if slope[0] <= 0.0:
        raise InputError("rotor speed that does not follow the motor's torque", "it to", "check units and signs")
    return Constant("rotor.inertia", 1.0 / slope[0], std[0] / slope[0] ** 2, "kg m^2")
