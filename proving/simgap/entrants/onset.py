"""vpptwin on the track `watch`: its simulation, linearised cell by cell, in a Kalman filter over each run.

Unknown are the state, a disturbing force with a memory, and the noise of the encoders. What sets in is dry friction,
damping or a steady force at one joint, from one cell on: a column of forces, whitened as the residual is. When is told
by regressions on one such number each, with noise as in the healthy run; whether, by how much likelier the run becomes
with the best of them, with whatever noise suits it, than with none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logsumexp

from proving.simgap.entrants.own import write_files
from proving.simgap.entrants.watch import EDGE
from proving.simgap.session import Session
from vpptwin import Twin, TwinSpec, load_twin, read_log
from vpptwin.estimation.measurements import Measurements, read_measurements
from vpptwin.estimation.windows import Windows, cut_windows, fly_windows

CELL, MARGIN = 0.05, 0.02
"""Length of a cell, and what is left out at either end of a run [s]."""
LAWS = ("dry friction", "damping", "steady force")
SLOW = 0.03
"""Speed, as a share of its rms, below which friction has no sign."""
WIDE, BUILT = 1.0, 0.05
"""Prior sizes of what sets in and of what was there all along, in typical forces of the joint."""
LEAST, TEMPER = 10.0, 4.0
"""Nats that a change must be worth, and by how much variances are understated (both of seed 1)."""


@dataclass(frozen=True)
class Cells:
    """A run in K cells of a rig with n joints; z is state error (2 n) and force (n), in units of what is usual.

    Attributes:
        start: of each, (K,) s.
        advance: state error after a cell by z before it, (K, 2 n, 3 n).
        jump: predicted end less estimated start of the next, (K, 2 n).
        seen: measured less predicted positions, mean over a cell, (K, n).
        show: the same by z, (K, n, 3 n).
        variance: of `seen`, infinite where nothing was measured, (K, n).
        laws: force of what may set in, joint by joint in the order of `LAWS`, (K, n, 3 n).
    """

    start: np.ndarray
    advance: np.ndarray
    jump: np.ndarray
    seen: np.ndarray
    show: np.ndarray
    variance: np.ndarray
    laws: np.ndarray

    def explain(self, force: np.ndarray) -> Cells:
        """What is left of them with a force that is known, (K, n)."""
        first = 2 * force.shape[1]
        jump = self.jump + np.einsum("kij,kj->ki", self.advance[:, :, first:], force)
        return replace(self, jump=jump, seen=self.seen - np.einsum("kij,kj->ki", self.show[:, :, first:], force))


def find_onset(session: Session, home: Path) -> dict[str, Any]:
    """Probability that something sets in, and times."""
    with TemporaryDirectory() as folder:
        spec = load_twin(write_files(session, Path(folder)))
        runs = [read_measurements(spec, read_log(log, twin=spec)) for log in sorted(home.glob("run_*.mcap"))]
    windows = [cut(spec, run) for run in runs]
    unit = find_units(spec, windows)
    healthy, watched = (linearise(spec, run, part, unit) for run, part in zip(runs, windows))
    noise, _ = tune_noise(healthy)
    before, during = whiten(healthy, noise, healthy.laws), whiten(watched, noise, switch_on(watched.laws))
    worth, size = weigh(before, during, watched.laws.shape[2])
    kept = slice(int(EDGE * len(watched.start)), int((1.0 - EDGE) * len(watched.start)))
    worth, start = worth[:, kept], watched.start[kept]
    law, at = np.unravel_index(np.argmax(worth), worth.shape)
    force = size[law, kept][at] * watched.laws[:, :, law] * (watched.start >= start[at])[:, None]
    gain = tune_noise(watched)[1] - tune_noise(watched.explain(force))[1]
    weight = np.exp(logsumexp(worth, axis=0) - logsumexp(worth))
    share = (np.arange(50) + 0.5) / 50.0
    times = start[np.minimum(np.searchsorted(np.cumsum(weight), share), len(start) - 1)]
    times += CELL * (np.random.default_rng(0).permutation(share) - 0.5)
    return {"probability": float(expit(gain - LEAST)), "times": np.sort(times).tolist()}


def cut(spec: TwinSpec, run: Measurements) -> Windows:
    """A run in cells."""
    length = spec.model.opt.timestep * round(CELL / spec.model.opt.timestep)
    count = int((run.end - run.start - 2.0 * MARGIN) / length)
    return cut_windows(spec, run, run.start + MARGIN + length * np.arange(count), length, causal=False)


def find_units(spec: TwinSpec, windows: list[Windows]) -> np.ndarray:
    """What is usual: spread of positions, rms velocities, rms inertial forces, (3 n,)."""
    data, pose = mujoco.MjData(spec.model), np.concatenate([part.pose for part in windows])
    carried = np.empty((len(pose[::20]), spec.model.nv))
    product, each = np.empty(spec.model.nv), np.eye(spec.model.nv)
    for row, q in zip(carried, pose[::20]):
        data.qpos[:] = q
        mujoco.mj_forward(spec.model, data)
        for j in range(spec.model.nv):
            mujoco.mj_mulM(spec.model, data, product, each[j])
            row[j] = product[j]
    velocity = np.concatenate([part.velocity for part in windows])
    speeding = np.concatenate([np.diff(part.velocity, axis=0) for part in windows]) / CELL
    force = carried.mean(axis=0) * np.sqrt(np.mean(speeding**2, axis=0))
    return np.concatenate([pose.std(axis=0), np.sqrt(np.mean(velocity**2, axis=0)), force]) + 1e-9


def linearise(spec: TwinSpec, run: Measurements, windows: Windows, unit: np.ndarray) -> Cells:
    """Simulate every cell from its estimated state, and with every state and force a little off."""
    count, n = windows.pose.shape
    small = np.repeat([0.01, 0.01, 0.1], n)
    moved = np.repeat(np.vstack([np.zeros(3 * n), np.diag(small * unit)]), count, axis=0)
    many = windows.take(np.tile(np.arange(count), 3 * n + 1)).shift(spec.model, moved[:, :n], moved[:, n : 2 * n])
    motion = fly_windows(Twin(spec, len(many)), many, moved[:, None, 2 * n :])
    pose, velocity = (part.reshape(3 * n + 1, count, -1, n) for part in (motion.pose, motion.velocity))

    def derive(values: np.ndarray) -> np.ndarray:
        """Derivatives by z, last, of what was simulated, (3 n + 1, ...)."""
        return np.moveaxis(values[1:] - values[0], 0, -1) / small

    end = np.concatenate([pose[:, :, -1], velocity[:, :, -1]], axis=2) / unit[: 2 * n]
    jump = np.zeros((count, 2 * n))
    jump[:-1] = end[0, :-1] - np.concatenate([windows.pose, windows.velocity], axis=1)[1:] / unit[: 2 * n]
    seen, variance, show = np.zeros((count, n)), np.full((count, n), np.inf), np.zeros((count, n, 3 * n))
    for j, series in run.positions.items():
        steps = (series.time - windows.start[0]) / windows.dt
        inside = (steps > 0.0) & (steps < count * windows.steps)
        cell, step = np.divmod(steps[inside], windows.steps)
        cell, low = cell.astype(int), np.minimum(step.astype(int), windows.steps - 1)
        share, track = step - low, pose[..., j]
        told = track[:, cell, low] * (1.0 - share) + track[:, cell, low + 1] * share
        number = np.bincount(cell, minlength=count)
        mean = np.stack([np.bincount(cell, row, count) for row in (series.value[inside], *told)])
        mean /= np.maximum(number, 1) * unit[j]
        seen[:, j], show[:, j] = mean[0] - mean[1], derive(mean[1:])
        variance[number > 0, j] = (series.std / unit[j]) ** 2 / number[number > 0]
    laws, speed = np.zeros((count, n, n, len(LAWS))), velocity[0] / unit[n : 2 * n]
    for j in range(n):
        sign = np.tanh(speed[..., j] / SLOW).mean(axis=1)
        laws[:, j, j] = np.stack([-sign, -speed[..., j].mean(axis=1), np.ones(count)], axis=1)
    return Cells(windows.start, derive(end), jump, seen, show, variance, laws.reshape(count, n, -1))


def switch_on(laws: np.ndarray) -> np.ndarray:
    """Forces of laws (K, n, L), each from every cell on, (K, n, L K)."""
    count = len(laws)
    return np.einsum("knl,kt->knlt", laws, np.tril(np.ones((count, count)))).reshape(count, laws.shape[1], -1)


def whiten(cells: Cells, noise: np.ndarray, forces: np.ndarray | None = None) -> np.ndarray:
    """Innovations of the residual and of responses to columns of forces (K, n, C), in standard deviations, (M, 1 + C).

    `noise` has logarithms: of the encoders' noise in what the samples show, of the disturbance, (n,) each, and of its
    memory [s]. Without forces the second column has the logarithms of the innovations' standard deviations, (M, 2).
    """
    count, n = cells.seen.shape
    columns = np.zeros((count, n, 1)) if forces is None else np.concatenate([np.zeros((count, n, 1)), forces], axis=2)
    sensor, strength = np.exp(2.0 * noise[:n]), np.exp(2.0 * noise[n : 2 * n])
    keep = float(np.exp(-CELL / np.exp(min(noise[-1], 1.0))))
    step, fresh = keep * np.eye(3 * n), np.diag(np.append(np.zeros(2 * n), strength * (1.0 - keep**2)))
    spread, mean = np.diag(np.append(np.full(2 * n, 0.04), strength)), np.zeros((3 * n, columns.shape[2]))
    rows, sizes = [], []
    for k in range(count):
        there = np.isfinite(cells.variance[k])
        if there.any():
            show = cells.show[k, there]
            root = np.linalg.cholesky(show @ spread @ show.T + np.diag((sensor * cells.variance[k])[there]))
            inverse = np.linalg.inv(root)
            missed = -(show @ mean + show[:, 2 * n :] @ columns[k])
            missed[:, 0] += cells.seen[k, there]
            rows.append(inverse @ missed)
            sizes.append(np.log(np.diag(root)))
            gain = spread @ show.T @ inverse.T @ inverse
            mean, spread = mean + gain @ missed, spread - gain @ show @ spread
        step[: 2 * n] = cells.advance[k]
        mean = step @ mean
        mean[: 2 * n] += cells.advance[k, :, 2 * n :] @ columns[k]
        mean[: 2 * n, 0] += cells.jump[k]
        spread = step @ spread @ step.T + fresh
        spread = 0.5 * (spread + spread.T) + 1e-14 * np.eye(3 * n)
    found = np.concatenate(rows) * np.append(1.0, -np.ones(columns.shape[2] - 1))
    return found if forces is not None else np.column_stack([found, np.concatenate(sizes)])


def tune_noise(cells: Cells) -> tuple[np.ndarray, float]:
    """The likeliest noise of a run, as `whiten` takes it, with log-normal priors, and its surprise [nats]."""
    n = cells.seen.shape[1]
    middle = np.append(np.zeros(n), [*np.full(n, np.log(0.01)), np.log(0.1)])

    def surprise(noise: np.ndarray) -> float:
        missed, sizes = whiten(cells, noise).T
        return float(0.5 * missed @ missed + sizes.sum() + 0.5 * np.sum(noise[:n] ** 2) + (noise[-1] - middle[-1]) ** 2)

    corners = middle + np.vstack([np.zeros(2 * n + 1), np.diag([*np.full(n, -0.7), *np.full(n + 1, 1.5)])])
    options = {"maxfev": 60 * n, "xatol": 0.1, "fatol": 0.2, "initial_simplex": corners}
    found = minimize(surprise, middle, method="Nelder-Mead", options=options)
    return found.x, float(found.fun)


def weigh(before: np.ndarray, during: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Log evidence of each law from each cell on over nothing, and its size, (L, K); all may be there all along.

    Args:
        before: whitened residual and laws of the healthy run, (M, 1 + L).
        during: whitened residual of the other run and laws from every cell on, (M, 1 + L K).
        number: L.
    """
    residual, columns = during[:, 0], during[:, 1:].reshape(len(during), number, -1)
    always = columns[:, :, 0]
    inner = np.eye(number) / BUILT**2 + before[:, 1:].T @ before[:, 1:] + always.T @ always
    known = np.linalg.solve(inner, before[:, 1:].T @ before[:, 0] + always.T @ residual)
    shared = np.einsum("mlk,mi->lki", columns, always)
    along = np.einsum("mlk,m->lk", columns, residual - always @ known) / TEMPER
    square = np.einsum("mlk,mlk->lk", columns, columns)
    square -= np.einsum("lki,ij,lkj->lk", shared, np.linalg.inv(inner), shared)
    square = np.maximum(square, 0.0) / TEMPER
    size = along / (square + WIDE**-2)
    gain = 0.5 * along * size
    gain[(np.arange(number) % len(LAWS) < 2)[:, None] & (along < 0.0)] = 0.0  # friction takes energy
    return gain - 0.5 * np.log1p(WIDE**2 * square), size
