"""What all entrants but vpptwin share: smoothed motion, MuJoCo with corrections, forecasts with their usual errors.

MuJoCo stands for the nominal model that an owner has. The worlds do not use it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from scipy.signal import savgol_filter

from proving.simgap.session import HISTORY, HORIZONS, Run, Session

RATE, STEP = 100.0, 0.002
"""Samples a second of smoothed motion; step of simulations [s]."""
SMOOTHED = 11
"""Samples that a cubic is fitted to."""
LEADS = (0.05, 0.1, 0.15)
"""Times before a forecast at which a simulation may start [s]: the state is smoothed over twice that."""
STRETCHES, LENGTH = 30, HORIZONS[-1]
"""Stretches of the runs that a correction is tried on, and their length [s]."""
QUIET = 0.05
"""Speed, as a share of its rms, below which friction has no sign."""


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


@dataclass(frozen=True)
class Correction:
    """A cause with a size, and for those of two numbers the other one (the rest of a spring)."""

    cause: str
    size: float
    other: float = 0.0

    @property
    def place(self) -> str:
        """The joint, actuator or body."""
        return self.cause.split(".")[0]

    @property
    def kind(self) -> str:
        """Its law."""
        return kind_of(self.cause)

    @property
    def axis(self) -> int:
        """0, 1 or 2, of what has one."""
        return "xyz".index(self.cause[-1]) if ":" in self.cause else 0


def kind_of(cause: str) -> str:
    """The law of a cause, by its id: PLACE.KIND, or PLACE.KIND:AXIS."""
    return re.split("[.:]", cause)[1]


class Lab:
    """A session with its model in MuJoCo."""

    def __init__(self, session: Session) -> None:
        self.session = session
        mujoco.set_mju_user_warning(lambda message: None)  # of simulations that fail, which count as that
        self.model = self.correct(())
        self.positions = [(column, self.joint(of)) for of, column in session.find("position").items()]
        self.pose = [session.find(part) for part in ("x", "y", "z", "qw", "qx", "qy", "qz")]
        self.commands = [session.find("command")[self.model.actuator(i).name] for i in range(self.model.nu)]

    def joint(self, name: str) -> int:
        """Index of a joint."""
        return int(self.model.joint(name).id)

    @property
    def free(self) -> bool:
        """Whether it is one free body."""
        return bool(self.pose[0])

    def dof(self, place: str) -> int:
        """The degree of freedom of a joint, or of the joint that an actuator drives."""
        try:
            return int(self.model.joint(place).dofadr[0])
        except KeyError:
            return int(self.model.jnt_dofadr[self.model.actuator(place).trnid[0]])

    # --- motion

    def read(self, run: Run, clock: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Measured qpos (n, nq) and commands (n, nu) at a clock; commands are held, motion is interpolated."""
        q = np.tile(self.model.qpos0, (len(clock), 1))
        columns = [(next(iter(p.values())), i) for i, p in enumerate(self.pose)] if self.free else [
            (column, int(self.model.jnt_qposadr[joint])) for column, joint in self.positions
        ]  # fmt: skip
        for column, at in columns:
            there = np.isfinite(run.columns[column])
            values = run.columns[column][there]
            q[:, at] = np.interp(clock, run.time[there], values)
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
        model, fine = self.correct(corrections), np.arange(motion.time[0], motion.time[-1] + STEP, STEP)
        held = np.searchsorted(motion.time, fine + 1e-9) - 1
        u = self.drive(motion.u[np.clip(held, 0, None)], corrections)[
            np.round((motion.time - fine[0]) / STEP).astype(int)
        ]
        shift = self.shift({c.place: c.size for c in corrections if c.kind == "offset"})
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
        """Lacking force (n, nv), cause → force of size one (n, nv), and the noise of each column, (nv,); all runs.

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
        if told.kind in ("coulomb", "stiction", "viscous", "drag", "bias", "spring", "load") and not self.free:
            j = self.dof(told.place)
            v, q = motion.v[:, j], motion.q[:, j]
            sign = np.tanh(v / (QUIET * np.sqrt(np.mean(v**2)) + 1e-12))
            slow = np.exp(-((v / (0.1 * np.sqrt(np.mean(v**2)) + 1e-12)) ** 2))
            found[:, j] = {
                "coulomb": -sign, "stiction": -sign * slow, "viscous": -v, "drag": -np.abs(v) * v,
                "bias": np.ones_like(v), "spring": -(q - q.mean()), "load": -np.abs(drive[:, j]) * sign,
            }[told.kind]  # fmt: skip
            return found
        if told.kind in ("wind", "twist", "drag") and self.free:
            if told.kind == "drag":
                found[:, :3] = -motion.v[:, :3]
            else:
                found[:, told.axis + 3 * (told.kind == "twist")] = 1.0
            return found
        if told.kind in ("inertia", "gain", "offset", "mass", "com", "payload", "stiffness", "force_limit", "delay",
                         "lag", "backlash", "rate_limit", "saturation"):  # fmt: skip
            size = given.off + given.scale * (-1.0 if told.kind in ("saturation", "rate_limit", "force_limit") else 1.0)
            size = max(size, 0.05 * given.off)
            other, _ = self.lacking(motion, (Correction(cause, size),))
            return (lacking - other) / (size - given.off)
        return None

    # --- simulation

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
        model = self.correct(corrections)
        vary = [c for c in corrections if c.kind in ("stiction", "load", "cogging", "wind", "drag") and c.size]
        base, applied = model.dof_frictionloss.copy(), np.zeros(model.nv)
        zero = {c.place: c.size for c in corrections if c.kind == "offset"}
        for c in corrections:
            if c.kind in ("bias", "twist"):
                applied[self.dof(c.place) if c.kind == "bias" else 3 + c.axis] += c.size
            if c.kind == "wind":
                applied[c.axis] += c.size
        data, out = mujoco.MjData(model), np.empty((len(stretches), len(HORIZONS), len(self.session.predicted)))
        shift = self.shift(zero)
        for i, stretch in enumerate(stretches):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:], data.qfrc_applied[:] = stretch.q - shift, stretch.v, applied
            u = self.drive(stretch.u, corrections)[round((HISTORY - stretch.lead) / STEP) :]
            rows, seen = np.round((np.array(HORIZONS) + stretch.lead) / STEP).astype(int), 0
            for k in range(rows[-1]):
                if vary:
                    self.vary(model, data, vary, base, applied)
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

    def shift(self, zero: Mapping[str, float]) -> np.ndarray:
        """What encoders read too much, (nq,)."""
        found = np.zeros(self.model.nq)
        for place, size in zero.items():
            found[int(self.model.joint(place).qposadr[0])] = size
        return found

    def correct(self, corrections: Sequence[Correction]) -> mujoco.MjModel:
        """The model with what of the corrections MJCF can say."""
        spec = mujoco.MjSpec.from_string(self.session.model)
        spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        for c in corrections:
            if c.kind == "com":
                spec.body(c.place).ipos[c.axis] += c.size
        model = spec.compile()
        for c in corrections:
            if c.kind in ("coulomb", "viscous", "inertia", "spring"):
                j = self.dof(c.place)
                if c.kind == "coulomb":
                    model.dof_frictionloss[j] = max(model.dof_frictionloss[j] + c.size, 0.0)
                elif c.kind == "viscous":
                    model.dof_damping[j] = max(model.dof_damping[j] + c.size, 0.0)
                elif c.kind == "inertia":
                    model.dof_armature[j] = max(model.dof_armature[j] + c.size, -0.5 * data_inertia(model, j))
                else:
                    model.jnt_stiffness[self.joint(c.place)] = c.size
                    model.qpos_spring[model.jnt_qposadr[self.joint(c.place)]] = c.other
            elif c.kind == "stiffness":
                i = model.actuator(c.place).id
                model.actuator_gainprm[i, 0] *= c.size
                model.actuator_biasprm[i, 1] *= c.size
            elif c.kind == "force_limit":
                model.actuator_forcerange[model.actuator(c.place).id] *= c.size
            elif c.kind == "mass":
                body = model.body(c.place).id
                model.body_inertia[body] *= 1.0 + c.size / model.body_mass[body]
                model.body_mass[body] += c.size
            elif c.kind == "payload":
                body = model.body(c.place).id
                model.body_mass[body] += c.size
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def vary(self, model: mujoco.MjModel, data: mujoco.MjData, corrections: Sequence[Correction],
             base: np.ndarray, applied: np.ndarray) -> None:  # fmt: skip
        """Forces that change along the way, for the next step."""
        model.dof_frictionloss[:] = base
        data.qfrc_applied[:] = applied
        for c in corrections:
            if c.kind == "drag" and self.free:
                data.qfrc_applied[:3] -= c.size * data.qvel[:3]
                continue
            if c.kind == "wind":
                continue
            j = self.dof(c.place)
            if c.kind == "stiction":
                model.dof_frictionloss[j] += c.size * np.exp(-((data.qvel[j] / max(c.other, 1e-6)) ** 2))
            elif c.kind == "load":
                model.dof_frictionloss[j] += c.size * abs(data.qfrc_actuator[j])
            elif c.kind == "drag":
                data.qfrc_applied[j] -= c.size * abs(data.qvel[j]) * data.qvel[j]

    def drive(self, u: np.ndarray, corrections: Sequence[Correction]) -> np.ndarray:
        """Commands (n, nu) at `STEP` as the actuators have them."""
        u, given = u.copy(), {c.cause for c in corrections}
        known = [Correction(cause, size) for cause, size in self.session.known.items() if cause not in given]
        for c in (*known, *corrections):
            if c.kind not in ("gain", "delay", "lag", "backlash", "rate_limit", "saturation"):
                continue
            for name in c.place.split("+"):
                i = self.model.actuator(name).id
                u[:, i] = distort(u[:, i], c.kind, c.size)
        return u

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


def data_inertia(model: mujoco.MjModel, dof: int) -> float:
    """Inertia at a degree of freedom in the pose that the model begins with."""
    return float(model.dof_M0[dof])


def distort(u: np.ndarray, kind: str, size: float) -> np.ndarray:
    """A command (n,) at `STEP` after a drive with one fault."""
    if kind == "gain":
        return size * u
    if kind == "delay":
        rows = np.arange(len(u)) - max(size, 0.0) / STEP
        return np.interp(rows, np.arange(len(u)), u)
    if kind == "saturation":
        return np.clip(u, -abs(size), abs(size))
    out, held = np.empty_like(u), u[0]
    keep = np.exp(-STEP / max(size, 1e-6)) if kind == "lag" else 0.0
    for k, wanted in enumerate(u):
        if kind == "lag":
            held = wanted + (held - wanted) * keep
        elif kind == "backlash":
            held = min(max(held, wanted - 0.5 * abs(size)), wanted + 0.5 * abs(size))
        else:
            held += min(max(wanted - held, -abs(size) * STEP), abs(size) * STEP)
        out[k] = held
    return out
