"""A learned policy as the pilot of a batch. What it sees is written apart from vpptwin."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from .control import Controller
from .flight import FlightPlan, fly_many
from .recording import Recording
from .rig import PITCH, X, Z, load_nominal

Policy = Callable[[np.ndarray], np.ndarray]
"""Observation (flights, 11) float32 to action (flights, 2) within [-1, 1]: thrust, rate."""
FORGETTING = 0.9  # of the integral, per policy period


def observe(
    pose: np.ndarray, speed: np.ndarray, rate: np.ndarray, target: np.ndarray, integral: np.ndarray
) -> np.ndarray:
    """What a policy sees.

    Args:
        pose: x m, z m, theta rad. (3, flights).
        speed: m/s. (2, flights).
        rate: q, rad/s. (flights,).
        target: As pose. (3, flights).
        integral: Gamma, m. (2, flights).

    Returns:
        The observation in docs/train.md. (flights, 11) float32.
    """
    left, wanted = target - pose, target[PITCH]
    rows = [
        *(left[X], left[Z], speed[X], speed[Z], np.sin(left[PITCH]), np.cos(left[PITCH]), rate),
        *(integral[X], integral[Z], np.sin(wanted), np.cos(wanted)),
    ]
    return np.stack(rows, axis=-1).astype(np.float32)


class PolicyPilot:
    """Flies a batch by a policy. It knows the nominal rig's limits, which scale the actions, and nothing else."""

    def __init__(self, policy: Policy, targets: np.ndarray, strength: float = 1.0) -> None:
        """Take a seat.

        Args:
            policy: Who decides.
            targets: x m, z m, theta rad of each policy period; the last one stays. (ticks, 3, flights).
            strength: Of the rotors, as of a `FlightPlan`.
        """
        self.policy, self.setpoint = policy, targets
        self.integral = np.zeros(targets[0, :PITCH].shape)
        control = load_nominal(strength)["control"]
        self.limits = np.array([[control["thrust_max"]], [control["rate_max"]]])

    def command(
        self, tick: int, pose: np.ndarray, speed: np.ndarray, rate: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Command thrust N and rate rad/s as `pilot.Commander` says."""
        target = self.setpoint[min(max(tick, 0), len(self.setpoint) - 1)]
        self.integral = FORGETTING * self.integral + (target - pose)[:PITCH]
        action = np.asarray(self.policy(observe(pose, speed, rate, target, self.integral)), dtype=float)
        if action.shape != (len(rate), 2):
            raise ValueError(f"the policy gives actions {action.shape}, expected {(len(rate), 2)}")
        thrust, turn = self.limits * np.clip(action.T, -1.0, 1.0)
        return thrust, turn


def fly_policy(
    policy: Policy,
    targets: np.ndarray,
    plans: Sequence[FlightPlan],
    firmware: Callable[[int], Controller] | None = None,
    strength: float | None = None,
) -> list[Recording]:
    """Fly a batch of flights by a policy.

    Args:
        policy: Who decides.
        targets: x m, z m, theta rad of each flight's policy periods from 0 to `duration`. (flights, ticks, 3).
        plans: As `fly_many` takes them; the manoeuvre is a name for the recording. Without an initial state the craft
            settles at its first target before the log starts.
        firmware: As `fly_many` takes it.
        strength: Of the rotors that the policy commands, by default of those that fly.

    Returns:
        A recording per flight.
    """
    if targets.shape[:1] + targets.shape[2:] != (len(plans), 3):
        raise ValueError(f"targets {targets.shape}, expected ({len(plans)}, ticks, 3)")
    strength = plans[0].get("strength", 1.0) if strength is None else strength
    pilot = PolicyPilot(policy, np.ascontiguousarray(targets.transpose(1, 2, 0)), strength)
    return fly_many(plans, pilot, firmware)
