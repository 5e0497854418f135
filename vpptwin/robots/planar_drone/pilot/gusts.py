"""Gusts: forces on the craft that wander, as a share of its weight."""

from __future__ import annotations

import numpy as np

from vpptwin.system.errors import InputError
from vpptwin.twin import Twin, TwinSpec

SHARE, GUST_TIME = 0.01, 0.3
"""Standard deviation of a gust as a share of the weight [1] (its moment: at the end of an arm), and for how long it
stays alike [s]."""
CARRIERS = ("rail_x.bias", "rail_z.bias", "pitch.bias")
"""The constant forces that gusts are added to, along x, z and θ."""


class GustProcess:
    """Forces and a moment on N crafts, drawn ahead: an Ornstein-Uhlenbeck process.

    Args:
        spec: the drone.
        count: N.
        ticks: policy periods that they last.
        seed: of their randomness.

    Raises:
        InputError: if the rig's catalogue lacks the forces that carry gusts.
    """

    def __init__(self, spec: TwinSpec, count: int, ticks: int, seed: int) -> None:
        missing = set(CARRIERS) - {e.id for e in spec.catalogue}
        if missing:
            found = f"{spec.name} has no effect {min(missing)}"
            raise InputError(found, "a model that gusts can push", "leave out --gusts")
        wind = spec.robot.disturbance
        decay = np.exp(-1.0 / (spec.vehicle.control.policy_rate * wind.memory))
        kicks = np.stack([np.random.default_rng([seed, i, 1]).standard_normal((ticks, 3)) for i in range(count)])
        force = kicks.copy()
        # Ornstein-Uhlenbeck: x_k = a x_(k-1) + sqrt(1 - a²) w_k, a = exp(-Δt/τ) (Särkkä and Solin, 6)
        for k in range(1, ticks):
            force[:, k] = decay * force[:, k - 1] + np.sqrt(1.0 - decay**2) * kicks[:, k]
        self.force = force * wind.std
        self._calm = np.array([spec.effects.get(effect, {}).get("force", 0.0) for effect in CARRIERS])

    def blow(self, twin: Twin, tick: int) -> None:
        """Set the forces of a tick; the twin needs `CARRIERS` switched on."""
        keys = [(effect, "force") for effect in CARRIERS]
        bounds = [twin.effects[effect].parameter("force") for effect in CARRIERS]
        low, high = np.array([p.low for p in bounds]), np.array([p.high for p in bounds])
        twin.set_parameters(keys, np.clip(self._calm + self.force[:, tick], low, high))
