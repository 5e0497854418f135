"""Chains of any length by Pinocchio: mass matrix and bias forces, inverse dynamics, a whole log."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from .plant import FORMS, advance, find_dynamics, list_numbers, steer
from .rig import GRAVITY, Rig

Dynamics = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""(q, v) → M, h of M a + h = f, without friction."""


def build_tree(rig: Rig) -> pin.Model:
    """The rig as Pinocchio has it, armature included."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    parent = 0
    for link in rig.links:
        make = pin.JointModelRevoluteUnaligned if link.rotary else pin.JointModelPrismaticUnaligned
        place = pin.SE3(np.eye(3), np.array(link.place))
        parent = model.addJoint(parent, make(np.array(link.axis)), place, link.joint)
        body = pin.Inertia(link.mass, np.array(link.com), np.diag(link.inertia))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    model.armature = np.array([link.armature for link in rig.links])
    return model


def find_tree_dynamics(rig: Rig) -> Dynamics:
    """Mass matrix and bias forces by Pinocchio."""
    model = build_tree(rig)
    data = model.createData()

    def find(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return pin.crba(model, data, q), pin.nonLinearEffects(model, data, q, v)

    return find


def choose_dynamics(rig: Rig) -> Dynamics:
    """Mass matrix and bias forces, in closed form where there is one."""
    if rig.family not in FORMS:
        return find_tree_dynamics(rig)
    form, numbers, n = FORMS[rig.family], list_numbers(rig), len(rig.links)

    def find(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        M, h = np.zeros((n, n)), np.zeros(n)
        find_dynamics(form, numbers, q, v, M, h)
        return M, h

    return find


def run_tree(
    rig: Rig, laws: np.ndarray, later: np.ndarray, change: int, drives: np.ndarray, drives_later: np.ndarray,
    cross: np.ndarray, gears: np.ndarray, start: np.ndarray, feed: np.ndarray, stiff: np.ndarray, damp: np.ndarray,
    reference: np.ndarray, noise: np.ndarray, push: np.ndarray, limit: np.ndarray, period: float, steps: int,
    track: np.ndarray, given: np.ndarray, hidden: np.ndarray,
) -> None:  # fmt: skip
    """`plant.run_closed_form` for any chain."""
    model = build_tree(rig)
    data, n, dt = model.createData(), len(laws), period / steps
    state, middle, nominal = np.zeros((6, n)), start.copy(), np.zeros(n)
    state[:2], state[3] = start, start[0]
    lagged, played, joints = np.zeros(len(drives)), np.zeros(len(drives)), drives["joint"]
    for k in range(len(track)):
        track[k, 0], track[k, 1], track[k, 2] = state[0], state[1], state[5]
        steer(feed[k], stiff, damp, reference[k], state[:2] + noise[k], limit, given[k])
        nominal[:] = 0.0
        np.add.at(nominal, joints, gears * given[k])
        acting, moving = (laws, drives) if k < change else (later, drives_later)
        delays, late, disturbing, lacking = moving["delay"], bool(moving["delay"].any()), push[k], hidden[k]
        inputs = given[k]
        for step in range(k * steps, (k + 1) * steps):
            if late:
                inputs = given[np.maximum((step - delays) // steps, 0), np.arange(len(delays))]
            M, h = pin.crba(model, data, middle[0]), pin.nonLinearEffects(model, data, middle[0], middle[1])
            advance(M, h, acting, moving, cross, inputs, disturbing, state, lagged, played, nominal, step * dt, dt,
                    middle, lacking)  # fmt: skip
    hidden /= steps
