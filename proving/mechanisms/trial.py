"""A log to be: what its operator does with the rig, who knows the nominal numbers; and what then happens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_continuous_are

from .plant import FORMS, STEP, list_numbers, run_closed_form
from .reference import KINDS, differentiate
from .rig import Rig
from .tree import choose_dynamics, run_tree

FASTEST, ARM = 8.0, 10.0
"""Of any operator's feedback [rad/s], which must live with a drive that lags by 60 ms; of an arm's, which gravity
would topple under a slower one."""


@dataclass(frozen=True)
class Motion:
    """What is done in a log: `tracked`, `open`, `balanced` or `released`; reference; duration [s]; seed; how far."""

    style: str
    kind: str
    duration: float
    seed: int
    reach: float = 1.0


@dataclass(frozen=True)
class Trial:
    """What drives a log of T samples.

    Attributes:
        period: of samples and inputs [s].
        start: position and velocity, (2, n).
        feed: inputs fed forward, (T, m).
        stiff, damp: feedback, input per position and per velocity, (m, n).
        reference: position and velocity, (T, 2, n).
        limit: of the inputs, (m,).
    """

    period: float
    start: np.ndarray
    feed: np.ndarray
    stiff: np.ndarray
    damp: np.ndarray
    reference: np.ndarray
    limit: np.ndarray


@dataclass(frozen=True)
class World:
    """What is true of a rig: numbers, laws, drives, forces across joints (n, n), laws from `change` of a log on."""

    rig: Rig
    laws: np.ndarray
    drives: np.ndarray
    cross: np.ndarray
    later: np.ndarray
    drives_later: np.ndarray
    change: float = 2.0


@dataclass(frozen=True)
class Track:
    """What happened, at every sample: position, velocity, friction (T, 3, n); inputs (T, m); force the twin lacks."""

    moved: np.ndarray
    given: np.ndarray
    lacking: np.ndarray


def plan_trial(rig: Rig, motion: Motion, period: float) -> Trial:
    """Work out a log's inputs on the nominal rig."""
    rng = np.random.default_rng(motion.seed)
    n, m, samples = len(rig.links), len(rig.drives), round(motion.duration / period)
    start, feed, stiff, damp = np.zeros((2, n)), np.zeros((samples, m)), np.zeros((m, n)), np.zeros((m, n))
    reference = np.zeros((samples, 2, n))
    limit = np.array([drive.limit for drive in rig.drives])
    if motion.style == "released":
        start[0] = motion.reach * np.array(rig.travel) * rng.uniform(0.6, 1.0) * rng.choice([-1.0, 1.0])
        start[1] = 0.2 * rig.pace * rng.uniform(-1.0, 1.0, n) * (rng.random() < 0.5)
        return Trial(period, start, feed, stiff, damp, reference, limit)
    time = np.arange(samples) * period
    wished = np.zeros((samples, n))
    for drive in rig.drives:
        j = drive.joint
        wished[:, j] = motion.reach * rig.travel[j] * KINDS[motion.kind](rng, time, rig.pace * rng.uniform(0.8, 1.1))
    path = differentiate(wished, period)
    reference[:] = path[:, :2]
    if motion.style == "balanced":
        stiff[0], damp[0] = balance(rig)
        start[0, 1] = 0.03 * rng.uniform(-1.0, 1.0)
        return Trial(period, start, feed, stiff, damp, reference, limit)
    force, carried = foresee(rig, path)
    rate = ARM if len(rig.links) > 2 else min(2.0 * rig.pace, FASTEST) * (0.2 if motion.style == "open" else 1.0)
    for i, drive in enumerate(rig.drives):
        feed[:, i] = force[:, drive.joint] / drive.gear
        stiff[i, drive.joint] = rate**2 * carried[drive.joint] / drive.gear
        damp[i, drive.joint] = 1.6 * rate * carried[drive.joint] / drive.gear
    return Trial(period, start, feed, stiff, damp, reference, limit)


def foresee(rig: Rig, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces along a path (T, 3, n) by inverse dynamics, (T, n), and the mean inertia that each joint carries, (n,)."""
    find = choose_dynamics(rig)
    force, carried = np.empty((len(path), path.shape[2])), np.zeros(path.shape[2])
    for k, (q, v, a) in enumerate(path):
        M, h = find(q, v)
        force[k] = M @ a + h
        carried += M.diagonal()
    damping, dry = np.array([[link.damping, link.dry] for link in rig.links]).T
    return force + damping * path[:, 1] + dry * np.tanh(50.0 * path[:, 1]), carried / len(path)


def balance(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Feedback that balances a cart's pole: input per position and velocity error, (2,) each."""
    find, zero, eps = choose_dynamics(rig), np.zeros(2), 1e-6
    M, _ = find(zero, zero)
    slope = np.stack([find(eps * e, zero)[1] / eps for e in np.eye(2)], axis=1)
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ slope, np.zeros((2, 2))]])
    B = np.concatenate([np.zeros(2), inverse[:, 0] * rig.drives[0].gear])[:, None]
    weights = np.diag([1.0 / rig.travel[0] ** 2, 40.0, 0.0, 0.0])
    X = solve_continuous_are(A, B, weights, np.array([[4.0 / rig.drives[0].limit ** 2]]))
    gains = (B.T @ X)[0] / (4.0 / rig.drives[0].limit ** 2)
    return gains[:2], gains[2:]


def perform(
    world: World, told: Rig, trial: Trial, noise: np.ndarray | None = None, push: np.ndarray | None = None,
    step: float = STEP,
) -> Track:  # fmt: skip
    """Simulate a log.

    Args:
        world: what is true.
        told: what the twin believes.
        trial: what is done.
        noise: of what the feedback sees, (T, 2, n).
        push: disturbing force, (T, n) [N, N m].
        step: of the simulation [s]; delays count in steps of `STEP`.
    """
    samples, n, m = len(trial.feed), len(world.laws), len(world.drives)
    moved, given, lacking = np.zeros((samples, 3, n)), np.zeros((samples, m)), np.zeros((samples, n))
    arguments = (
        world.laws, world.later, round(min(world.change, 2.0) * samples), world.drives, world.drives_later, world.cross,
        np.array([drive.gear for drive in told.drives]), trial.start, trial.feed, trial.stiff, trial.damp,
        trial.reference, np.zeros((samples, 2, n)) if noise is None else noise,
        np.zeros((samples, n)) if push is None else push, trial.limit, trial.period, round(trial.period / step),
        moved, given, lacking,
    )  # fmt: skip
    if world.rig.family in FORMS:
        run_closed_form(FORMS[world.rig.family], list_numbers(world.rig), *arguments)
    else:
        run_tree(world.rig, *arguments)
    return Track(moved, given, lacking)
