"""What all entrants but vpptwin share: smoothed motion, MuJoCo with corrections, forecasts with their usual errors.

MuJoCo stands for the nominal model that an owner has. The worlds do not use it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from scipy.signal import savgol_filter

from proving.simgap.entrants.corrections import (
    DRIVES,
    RESISTING,
    STEP,
    Correction,
    correct_model,
    distort_all,
    find_dof,
    find_push,
    find_steady,
    vary_forces,
)
from proving.simgap.session import HISTORY, HORIZONS, Run, Session

RATE = 100.0
"""Samples a second of smoothed motion."""
SMOOTHED = 11
"""Samples that a cubic is fitted to."""
LEADS = (0.05, 0.1, 0.15)
"""Times before a forecast at which a simulation may start [s]: the state is smoothed over twice that."""
STRETCHES, LENGTH = 30, HORIZONS[-1]
"""Stretches of the runs that a correction is tried on, and their length [s]."""
Push = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Position (nq,), velocity (nv,) and commands (nu,) → force, (nv,)."""


@dataclass(frozen=True)
class Motion:
    """A run on an even clock: qpos (n, nq), qvel, qacc (n, nv), commands (n, nu)."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray


@dataclass(frozen=True)
class Stretch:
    """Motion `lead` before a start, commands from `HISTORY` before it on, measured columns at the horizons, (10, n)."""

    q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    lead: float
    measured: np.ndarray | None = None


class Lab:
    """A session with its model in MuJoCo."""

    def __init__(self, session: Session) -> None:
        self.session = session
        mujoco.set_mju_user_warning(lambda message: None)  # of simulations that fail, which count as that
        self.model = correct_model(session.model, ())
        self.positions = [(column, int(self.model.joint(of).id)) for of, column in session.find("position").items()]
        self.pose = [session.find(part) for part in ("x", "y", "z", "qw", "qx", "qy", "qz")]
        self.commands = [session.find("command")[self.model.actuator(i).name] for i in range(self.model.nu)]

    @property
    def free(self) -> bool:
        """Whether it is one free body."""
        return bool(self.pose[0])

    # --- motion

    def read(self, run: Run, clock: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Measured qpos (n, nq) and commands (n, nu) at a clock; commands are held, motion is interpolated."""
        q = np.tile(self.model.qpos0, (len(clock), 1))
        columns = [(next(iter(p.values())), i) for i, p in enumerate(self.pose)] if self.free else [
            (column, int(self.model.jnt_qposadr[joint])) for column, joint in self.positions
        ]  # fmt: skip
        for column, at in columns:
            there = np.isfinite(run.columns[column])
            q[:, at] = np.interp(clock, run.time[there], run.columns[column][there])
        if self.free:
            flips = np.cumprod(np.where((q[1:, 3:7] * q[:-1, 3:7]).sum(1) < 0.0, -1.0, 1.0))
            q[1:, 3:7] *= flips[:, None]
        return q, self.hold(run, clock)

    def hold(self, run: Run, clock: np.ndarray) -> np.ndarray:
        """Commands (n, nu) at a clock, each held until the next."""
        u = np.zeros((len(clock), self.model.nu))
        for i, column in enumerate(self.commands):
            there = np.isfinite(run.columns[column])
            rows = np.searchsorted(run.time[there], clock + 1e-9) - 1
            u[:, i] = run.columns[column][there][np.clip(rows, 0, None)]
        return u

    def smooth(self, run: Run) -> Motion:
        """A run smoothed by cubics, with its derivatives."""
        step, ends = 1.0 / RATE, [run.time[np.isfinite(run.columns[c])] for c in self.session.predicted]
        clock = np.arange(max(e[0] for e in ends), min(e[-1] for e in ends), step)
        q, u = self.read(run, clock)
        q = savgol_filter(q, SMOOTHED, 3, axis=0)
        if self.free:
            q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
        v = np.zeros((len(clock), self.model.nv))
        for k in range(1, len(clock) - 1):
            mujoco.mj_differentiatePos(self.model, v[k], 2.0 * step, q[k - 1], q[k + 1])
        v[0], v[-1] = v[1], v[-2]
        return Motion(clock, q, v, savgol_filter(v, SMOOTHED, 3, deriv=1, delta=step, axis=0), u)

    @cached_property
    def motions(self) -> list[Motion]:
        """All runs."""
        return [self.smooth(run) for run in self.session.runs]

    def lacking(self, motion: Motion, corrections: Sequence[Correction] = ()) -> tuple[np.ndarray, np.ndarray]:
        """Force that a corrected model lacks along a motion, and its actuators' force, (n, nv) each."""
        model, fine = (
            correct_model(self.session.model, corrections),
            np.arange(motion.time[0], motion.time[-1] + STEP, STEP),
        )
        held = np.searchsorted(motion.time, fine + 1e-9) - 1
        u = self.drive(motion.u[np.clip(held, 0, None)], corrections)[
            np.round((motion.time - fine[0]) / STEP).astype(int)
        ]
        _, shift = find_steady(model, corrections)
        data, found = mujoco.MjData(model), np.empty((2, len(motion.time), model.nv))
        for k in range(len(motion.time)):
            data.qpos[:], data.qvel[:], data.ctrl[:] = motion.q[k] - shift, motion.v[k], u[k]
            mujoco.mj_forward(model, data)
            drive = data.qfrc_actuator.copy()
            data.qacc[:] = motion.a[k]
            mujoco.mj_inverse(model, data)
            found[:, k] = data.qfrc_inverse - drive, drive
        return found[0], found[1]

    @cached_property
    def residuals(self) -> list[tuple[Motion, np.ndarray, np.ndarray]]:
        """Each run's motion, the force that the nominal model lacks, its actuators' force."""
        return [(motion, *self.lacking(motion)) for motion in self.motions]

    @cached_property
    def table(self) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray]:
        """Of all runs lacking force (n, nv), cause → force of size one (n, nv), and the noise of each column, (nv,).

        Forces are averaged as smoothing averages accelerations. Noise is the median change over a tenth of a second.
        """
        kept = slice(SMOOTHED, -SMOOTHED)
        parts = [(motion, lacking[kept], drive) for motion, lacking, drive in self.residuals]
        pushes: dict[str, list[np.ndarray]] = {}
        for motion, lacking, drive in self.residuals:
            for cause in self.session.causes:
                push = self.push(cause, motion, lacking, drive)
                if push is not None:
                    pushes.setdefault(cause, []).append(savgol_filter(push, SMOOTHED, 1, axis=0)[kept])
        lacking = np.concatenate([lacking for _, lacking, _ in parts])
        change = np.abs(lacking[10:] - lacking[:-10])
        noise = np.maximum(1.05 * np.median(change, axis=0), 1e-6 * (np.abs(lacking).max(axis=0) + 1e-9))
        return lacking, {cause: np.concatenate(some) for cause, some in pushes.items()}, noise

    # --- simulation

    def push(self, cause: str, motion: Motion, lacking: np.ndarray, drive: np.ndarray) -> np.ndarray | None:
        """Force along a motion that a cause of size one adds, (n, nv), linear about its typical size; None: no force.

        Args:
            cause: its id.
            motion: smoothed.
            lacking: force that the nominal model lacks, (n, nv).
            drive: force of its actuators, (n, nv).
        """
        told, given = Correction(cause, 1.0), self.session.causes[cause]
        found = np.zeros_like(lacking)
        if told.kind in RESISTING and not self.free:
            j = find_dof(self.model, told.place)
            found[:, j] = find_push(told.kind, motion.q[:, j], motion.v[:, j], drive[:, j])
            return found
        if told.kind == "drag":
            found[:, :3] = -motion.v[:, :3]
            return found
        if told.kind in ("wind", "twist"):
            return found + find_steady(self.model, [told])[0]
        if told.kind in (*DRIVES, "inertia", "offset", "mass", "com", "payload", "stiffness", "force_limit"):
            size = given.off + given.scale * (-1.0 if told.kind in ("saturation", "rate_limit", "force_limit") else 1.0)
            size = max(size, 0.05 * given.off)
            return (lacking - self.lacking(motion, (Correction(cause, size),))[0]) / (size - given.off)
        return None

    def start(self, run: Run, at: float, lead: float) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity `lead` before an instant, by cubics over as much to either side of that."""
        clock = np.linspace(at - 2.0 * lead, at, 4 * round(lead * RATE) + 1)
        q, _ = self.read(run, clock)
        fitted = np.linalg.lstsq(np.vander(clock - at + lead, 4, increasing=True), q, rcond=None)[0]
        now, soon = fitted[0].copy(), fitted[0] + 1e-3 * fitted[1]
        if self.free:
            now[3:7] /= np.linalg.norm(now[3:7])
            soon[3:7] /= np.linalg.norm(soon[3:7])
        v = np.zeros(self.model.nv)
        mujoco.mj_differentiatePos(self.model, v, 1e-3, now, soon)
        return now, v

    @cached_property
    def lead(self) -> float:
        """How long before a forecast simulations start: that of `LEADS` with the least error a tenth of a second on."""
        scale = np.array(list(self.session.scales.values()))

        def measure(lead: float) -> float:
            stretches = [self.cut(run, at, lead) for run, at in self.places[::3]]
            measured = np.stack([s.measured for s in stretches if s.measured is not None])
            return float(np.nanmean(np.abs((measured - self.predict(stretches))[:, 0] / scale)))

        return min(LEADS, key=measure)

    @cached_property
    def places(self) -> list[tuple[Run, float]]:
        """Where the tried stretches start: run and instant."""
        per, found = max(STRETCHES // len(self.session.runs), 2), []
        for run, motion in zip(self.session.runs, self.motions):
            instants = np.linspace(motion.time[0] + HISTORY + 0.03, motion.time[-1] - LENGTH - 0.02, per)
            found += [(run, float(at)) for at in instants]
        return found

    def cut(self, run: Run, at: float, lead: float | None = None) -> Stretch:
        """A stretch of a run, its measured columns only where the run has them."""
        lead = self.lead if lead is None else lead
        clock = np.arange(at - HISTORY, at + LENGTH + 0.5 * STEP, STEP)
        measured = None
        if all(np.isfinite(run.columns[c][run.time > at + 1e-6]).any() for c in self.session.predicted):
            there = [(run.columns[c], np.isfinite(run.columns[c])) for c in self.session.predicted]
            measured = np.stack([np.interp(at + np.array(HORIZONS), run.time[r], c[r]) for c, r in there], axis=1)
        begin = self.start(run.cut(at - HISTORY - 0.02, at), at, lead)
        return Stretch(*begin, self.hold(run, clock), lead, measured)

    @cached_property
    def tried(self) -> list[Stretch]:
        """Stretches of the runs, evenly."""
        return [self.cut(run, at) for run, at in self.places]

    def predict(
        self, stretches: Sequence[Stretch], corrections: Sequence[Correction] = (), push: Push | None = None
    ) -> np.ndarray:
        """Motion of predicted columns from each start, (stretches, 10, n); NaN where a simulation fails."""
        model = correct_model(self.session.model, corrections)
        vary = [c for c in corrections if c.kind in ("stiction", "load", "cogging", "wind", "drag") and c.size]
        base, applied, shift = model.dof_frictionloss.copy(), *find_steady(model, corrections)
        data, out = mujoco.MjData(model), np.empty((len(stretches), len(HORIZONS), len(self.session.predicted)))
        for i, stretch in enumerate(stretches):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:], data.qfrc_applied[:] = stretch.q - shift, stretch.v, applied
            u = self.drive(stretch.u, corrections)[round((HISTORY - stretch.lead) / STEP) :]
            rows, seen = np.round((np.array(HORIZONS) + stretch.lead) / STEP).astype(int), 0
            for k in range(rows[-1]):
                if vary:
                    vary_forces(model, data, vary, base, applied, self.free)
                data.ctrl[:] = u[k]
                if push:
                    data.qfrc_applied[:] = applied + push(data.qpos, data.qvel, u[k])
                mujoco.mj_step(model, data)
                if k + 1 == rows[seen]:
                    out[i, seen] = self.show(data.qpos + shift)
                    seen += 1
        return np.where(np.abs(out) < 1e6, out, np.nan)

    def show(self, q: np.ndarray) -> np.ndarray:
        """Predicted columns of a position."""
        return q[:3] if self.free else q[[int(self.model.jnt_qposadr[joint]) for _, joint in self.positions]]

    def drive(self, u: np.ndarray, corrections: Sequence[Correction]) -> np.ndarray:
        """Commands (n, nu) at `STEP` as the actuators have them, with what is known of these."""
        given = {c.cause for c in corrections}
        known = [Correction(cause, size) for cause, size in self.session.known.items() if cause not in given]
        return distort_all(self.model, u, [*known, *corrections])

    def miss(self, corrections: Sequence[Correction] = (), push: Push | None = None) -> np.ndarray:
        """Measured less predicted motion of the tried stretches, in standard deviations of the motion, (K, 10, n)."""
        measured = np.stack([s.measured for s in self.tried if s.measured is not None])
        return (measured - self.predict(self.tried, corrections, push)) / np.array(list(self.session.scales.values()))

    def forecast(
        self, corrections: Sequence[Correction] = (), push: Push | None = None, samples: int = 30
    ) -> list[list[list[list[float]]]]:
        """Forecasts of all windows: a prediction, plus errors of its like on the runs."""
        windows = [self.cut(w.run, w.start) for w in self.session.windows]
        told = self.predict(windows, corrections, push)
        errors = self.miss(corrections, push) * np.array(list(self.session.scales.values()))
        errors = errors[np.isfinite(errors).all(axis=(1, 2))]
        if not len(errors):
            errors = np.zeros((1, *told.shape[1:]))
        chosen = errors[np.linspace(0, len(errors) - 1, min(samples, len(errors))).astype(int)]
        stay = np.stack([self.show(w.q) for w in windows])
        told = np.where(np.isfinite(told), told, stay[:, None])
        return [[(one + error).tolist() for error in chosen] for one in told]
