"""What moves a rig: drives, friction that sticks, and the rest; one step of it, and closed-form rigs over a whole log.

Explicit midpoint: forces and inertias are taken where the rig will be half a step on. A joint with dry friction that
comes to rest within a step is stopped at that instant; one at rest is held by whatever force that takes, up to its
breakaway level, and is let go beyond it (Karnopp with exact events).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from .rig import GRAVITY, Rig

STEP = 0.00025
"""Of the simulation [s]: a quarter of the MJCF's."""
NO_LIMIT = 1e18
LAW = np.dtype(
    [
        (name, np.float64)
        for name in (
            "coulomb", "stiction", "stribeck", "viscous", "bias", "stiffness", "rest", "inertia",  # of the catalogue
            "ripple", "ripple_rate", "ripple_phase", "drag", "place", "place_rate", "hysteresis", "reach",
            "memory", "memory_time", "load", "cable", "slack", "hum", "hum_rate",  # outside it but for the ripple
            "spot", "spot_at", "spot_width", "fade",
            "known_viscous", "known_dry",  # of the MJCF
        )
    ]
)  # fmt: skip
"""What acts on a joint: amplitudes [N, N m], or per unit of what they multiply; `_rate` in rad per m, rad or s."""
DRIVE = np.dtype(
    [("joint", np.int64), ("delay", np.int64)]
    + [(name, np.float64) for name in ("gear", "gain", "lag", "rate", "gap", "limit", "dead")]
)
"""A drive: index of its joint, delay in steps of the simulation, force per input, and what is wrong with it."""
CART, PENDULUM, CARTPOLE, DOUBLE = range(4)
FORMS = {"carriage": CART, "damped cart": CART, "pendulum": PENDULUM, "cart-pole": CARTPOLE, "double pendulum": DOUBLE}
"""Families with equations of motion in closed form."""


def build_laws(rig: Rig) -> np.ndarray:
    """The laws of a rig in which nothing is hidden, (n,) of `LAW`."""
    laws = np.zeros(len(rig.links), LAW)
    laws["stribeck"] = laws["reach"] = laws["memory_time"] = laws["spot_width"] = 1.0
    for law, link in zip(laws, rig.links):
        law["known_viscous"] = law["viscous"] = link.damping
        law["known_dry"] = law["coulomb"] = link.dry
    return laws


def build_drives(rig: Rig) -> np.ndarray:
    """Its drives, (m,) of `DRIVE`."""
    drives = np.zeros(len(rig.drives), DRIVE)
    drives["rate"], drives["limit"], drives["gain"] = NO_LIMIT, NO_LIMIT, 1.0
    for row, drive in zip(drives, rig.drives):
        row["joint"], row["gear"] = drive.joint, drive.gear
    return drives


def list_numbers(rig: Rig) -> np.ndarray:
    """The constants that `find_dynamics` takes: inertias, masses, distances and armatures."""
    first, last = rig.links[0], rig.links[-1]
    c = -last.com[2]  # below the joint
    if FORMS[rig.family] in (CART, PENDULUM):
        about = first.mass if not first.rotary else first.inertia[1] + first.mass * c * c
        return np.array([about + first.armature, first.mass * GRAVITY * c])
    if FORMS[rig.family] == CARTPOLE:
        about = last.inertia[1] + last.mass * c * c + last.armature
        return np.array([first.mass + last.mass + first.armature, last.mass * c, about])
    c1, arm = -first.com[2], -last.place[2]
    upper = first.inertia[1] + first.mass * c1 * c1 + last.mass * arm * arm
    lower = last.inertia[1] + last.mass * c * c
    turning = first.mass * c1 + last.mass * arm
    return np.array([upper, lower, last.mass * arm * c, turning, last.mass * c, first.armature, last.armature])


@njit(cache=True)
def find_dynamics(form: int, p: np.ndarray, q: np.ndarray, v: np.ndarray, M: np.ndarray, h: np.ndarray) -> None:
    """Write the mass matrix, (n, n), and the forces of gravity and of velocities that M a + h = f has, (n,)."""
    if form == CART:
        M[0, 0], h[0] = p[0], 0.0
    elif form == PENDULUM:
        M[0, 0], h[0] = p[0], p[1] * math.sin(q[0])
    elif form == CARTPOLE:
        sine, cosine = p[1] * math.sin(q[1]), p[1] * math.cos(q[1])
        M[0, 0], M[0, 1], M[1, 0], M[1, 1] = p[0], cosine, cosine, p[2]
        h[0], h[1] = -sine * v[1] * v[1], GRAVITY * sine
    else:
        sine, cosine = p[2] * math.sin(q[1]), p[2] * math.cos(q[1])
        M[0, 0], M[1, 1] = p[0] + p[1] + 2.0 * cosine + p[5], p[1] + p[6]
        M[0, 1] = M[1, 0] = p[1] + cosine
        hanging = GRAVITY * p[4] * math.sin(q[0] + q[1])
        h[0] = -sine * v[1] * (2.0 * v[0] + v[1]) + GRAVITY * p[3] * math.sin(q[0]) + hanging
        h[1] = sine * v[0] * v[0] + hanging


@njit(cache=True)
def move_drives(
    drives: np.ndarray, inputs: np.ndarray, lagged: np.ndarray, played: np.ndarray, dt: float, force: np.ndarray
) -> None:
    """Add what the drives make of their inputs to `force`, (n,): lag, limited rate, play, gain, limit, dead band."""
    for i in range(len(drives)):
        d = drives[i]
        wanted = inputs[i] + (lagged[i] - inputs[i]) * (math.exp(-dt / d.lag) if d.lag > 0.0 else 0.0)
        lagged[i] = min(max(wanted, lagged[i] - d.rate * dt), lagged[i] + d.rate * dt)
        played[i] = min(max(played[i], lagged[i] - 0.5 * d.gap), lagged[i] + 0.5 * d.gap)
        output = min(max(d.gain * played[i], -d.limit), d.limit)
        output -= min(max(output, -d.dead), d.dead)
        force[d.joint] += d.gear * output


@njit(cache=True)
def solve(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The solution of A x = b for a symmetric positive definite A; both are overwritten."""
    n = len(b)
    for i in range(n):
        for k in range(i + 1, n):
            if A[k, i] != 0.0:
                factor = A[k, i] / A[i, i]
                for j in range(i, n):
                    A[k, j] -= factor * A[i, j]
                b[k] -= factor * b[i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            b[i] -= A[i, j] * b[j]
        b[i] /= A[i, i]
    return b


@njit(cache=True)
def push_joints(
    laws: np.ndarray, q: np.ndarray, v: np.ndarray, memory: np.ndarray, bent: np.ndarray, time: float,
    force: np.ndarray,
) -> None:  # fmt: skip
    """Add every law's force but dry friction's to `force`, (n,) [N, N m]."""
    for j in range(len(laws)):
        law = laws[j]
        force[j] += (
            law.bias
            - law.viscous * v[j]
            - law.stiffness * (q[j] - law.rest)
            - law.drag * abs(v[j]) * v[j]
            + law.ripple * math.sin(law.ripple_rate * q[j] + law.ripple_phase)
            + law.hum * math.sin(law.hum_rate * time)
            - law.memory * (q[j] - memory[j])
            - law.hysteresis * bent[j]
            - law.cable * max(q[j] - law.slack, 0.0)
        )


@njit(cache=True)
def find_level(law: np.ndarray, q: float, v: float, driving: float) -> float:
    """Dry friction that a joint can muster [N, N m]."""
    falling = law.stiction * math.exp(-((v / law.stribeck) ** 2))
    falling += law.spot * math.exp(-(((q - law.spot_at) / law.spot_width) ** 2))
    return law.coulomb + falling + law.place * (1.0 + math.sin(law.place_rate * q)) + law.load * abs(driving)


@njit(cache=True)
def advance(
    M: np.ndarray, h: np.ndarray, laws: np.ndarray, drives: np.ndarray, cross: np.ndarray, inputs: np.ndarray,
    push: np.ndarray, state: np.ndarray, lagged: np.ndarray, played: np.ndarray, nominal: np.ndarray, time: float,
    dt: float, middle: np.ndarray, hidden: np.ndarray,
) -> None:  # fmt: skip
    """One step.

    Args:
        M: mass matrix half a step on.
        h: bias forces there.
        laws: of the joints.
        drives: as `build_drives` makes them.
        cross: force at joint i per drive force at joint j, (n, n).
        inputs: of the drives now, (m,).
        push: disturbing force, (n,) [N, N m].
        state: position, velocity, acceleration, memory, hysteresis' deflection, friction, (6, n); written.
        lagged: where the drives' lags are, (m,); written.
        played: where what they drag through play is, (m,); written.
        nominal: force that a nominal twin has from its drives, (n,).
        time: s.
        dt: s.
        middle: position and velocity half a step after the end, (2, n); read for this step, written for the next.
        hidden: force that the nominal twin lacks, (n,); the step's is added.
    """
    n = len(laws)
    q, v, memory, bent, friction = state[0], state[1], state[3], state[4], state[5]
    driving = np.zeros(n)
    move_drives(drives, inputs, lagged, played, dt, driving)
    for j in range(n):
        if driving[j] * v[j] > 0.0:
            driving[j] *= max(1.0 - laws[j].fade * abs(v[j]), 0.0)
    force = driving + cross @ driving
    push_joints(laws, middle[0], middle[1], memory, bent, time, force)
    level, held, rubbing = np.zeros(n), np.zeros(n, np.bool_), np.zeros(n)
    for j in range(n):
        level[j] = find_level(laws[j], middle[0, j], middle[1, j] if v[j] != 0.0 else 0.0, driving[j])
        held[j] = v[j] == 0.0 and level[j] > 0.0
        rubbing[j] = -math.copysign(level[j], v[j]) if not held[j] else 0.0
    A, b = np.empty((n, n)), np.empty(n)
    for _ in range(n + 1):
        for i in range(n):
            b[i] = 0.0 if held[i] else force[i] + push[i] - h[i] + rubbing[i]
            for j in range(n):
                A[i, j] = 0.0 if held[i] or held[j] else M[i, j]
            A[i, i] = 1.0 if held[i] else M[i, i] + laws[i].inertia
        solve(A, b)
        worst, excess = -1, 1.0
        for i in range(n):
            if held[i]:
                needed = -(force[i] + push[i] - h[i])
                for j in range(n):
                    needed += M[i, j] * b[j]
                rubbing[i] = needed
                if abs(needed) > excess * level[i]:
                    worst, excess = i, abs(needed) / level[i]
        if worst < 0:
            break
        held[worst], rubbing[worst] = False, math.copysign(level[worst], rubbing[worst])
    for j in range(n):
        known = laws[j].known_dry / level[j] if level[j] > 0.0 else 0.0
        hidden[j] += force[j] - nominal[j] + laws[j].known_viscous * middle[1, j]
        hidden[j] += (1.0 - known) * rubbing[j] - laws[j].inertia * b[j]
        memory[j] += (1.0 - math.exp(-dt / laws[j].memory_time)) * (middle[0, j] - memory[j])
        moved = middle[1, j] * dt / laws[j].reach
        bent[j] += (1.0 - math.exp(-abs(moved))) * (math.copysign(1.0, moved) - bent[j])
        ahead = v[j] + dt * b[j]
        if v[j] * ahead < 0.0 and level[j] > 0.0:
            q[j] += 0.5 * dt * v[j] * v[j] / (v[j] - ahead)
            ahead = 0.0
        else:
            q[j] += 0.5 * dt * (v[j] + ahead)
        v[j], state[2, j], friction[j] = ahead, b[j] if ahead != 0.0 else 0.0, rubbing[j]
        middle[0, j], middle[1, j] = q[j] + 0.5 * dt * ahead, ahead + 0.5 * dt * state[2, j]


@njit(cache=True)
def steer(
    feed: np.ndarray, stiff: np.ndarray, damp: np.ndarray, reference: np.ndarray, seen: np.ndarray, limit: np.ndarray,
    given: np.ndarray,
) -> None:  # fmt: skip
    """Control inputs, (m,): feed-forward and feedback of positions and velocities, (2, n), within their limits."""
    for i in range(len(given)):
        u = feed[i]
        for j in range(seen.shape[1]):
            u += stiff[i, j] * (reference[0, j] - seen[0, j]) + damp[i, j] * (reference[1, j] - seen[1, j])
        given[i] = min(max(u, -limit[i]), limit[i])


@njit(cache=True)
def run_closed_form(
    form: int, numbers: np.ndarray, laws: np.ndarray, later: np.ndarray, change: int, drives: np.ndarray,
    drives_later: np.ndarray, cross: np.ndarray, gears: np.ndarray, start: np.ndarray, feed: np.ndarray,
    stiff: np.ndarray, damp: np.ndarray, reference: np.ndarray, noise: np.ndarray, push: np.ndarray,
    limit: np.ndarray, period: float, steps: int, track: np.ndarray, given: np.ndarray, hidden: np.ndarray,
) -> None:  # fmt: skip
    """Simulate a log of T samples; writes `track` (T, 3, n): position, velocity, friction; `given` (T, m); `hidden`.

    Arguments are those of `Trial`, `steps` how many make a period; `later` are the laws from sample `change` on.
    """
    n, dt = len(laws), period / steps
    state, middle, M, h = np.zeros((6, n)), np.zeros((2, n)), np.zeros((n, n)), np.zeros(n)
    state[:2], middle[:] = start, start
    state[3] = start[0]
    lagged, played, inputs = np.zeros(len(drives)), np.zeros(len(drives)), np.zeros(len(drives))
    nominal = np.zeros(n)
    for k in range(len(track)):
        track[k, 0], track[k, 1], track[k, 2] = state[0], state[1], state[5]
        steer(feed[k], stiff, damp, reference[k], state[:2] + noise[k], limit, given[k])
        nominal[:] = 0.0
        for i in range(len(drives)):
            nominal[drives[i].joint] += gears[i] * given[k, i]
        acting, moving = (laws, drives) if k < change else (later, drives_later)
        for s in range(steps):
            for i in range(len(drives)):
                inputs[i] = given[max((k * steps + s - moving[i].delay) // steps, 0), i]
            find_dynamics(form, numbers, middle[0], middle[1], M, h)
            advance(M, h, acting, moving, cross, inputs, push[k], state, lagged, played, nominal,
                    (k * steps + s) * dt, dt, middle, hidden[k])  # fmt: skip
    hidden /= steps
