"""The paper's equations integrated by scipy: shares no line with the twin it is compared with."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

X, Z, THETA = 0, 1, 2


@dataclass(frozen=True)
class Paper:
    """A planar craft with variable-pitch rotors (paper Eq. 1, 2, 4 and its servo lag and drag), K flights at once.

    Attributes:
        mass: moving in x, moving in z [kg].
        inertia: about the hinge [kg m^2].
        arm: hinge to rotor [m].
        gravity: m/s².
        k_t: thrust constant [N s/rad²].
        time_constant: of the pitch servos [s].
        delay: from command to servo [s].
        gain: of both rotors' thrust.
        fraction: rotor 1 stronger, rotor 2 weaker by it.
        bias: constant force along x and z [N].
        damping: of x and z [N s/m].
        drag: k_d [N s²/m²].
    """

    mass: tuple[float, float]
    inertia: float
    arm: float
    gravity: float
    k_t: float
    time_constant: float
    delay: float = 0.0
    gain: float = 1.0
    fraction: float = 0.0
    bias: tuple[float, float] = (0.0, 0.0)
    damping: tuple[float, float] = (0.0, 0.0)
    drag: float = 0.0

    def force(self, velocity: np.ndarray, theta: np.ndarray, blade: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Accelerations of x, z, θ, (3, K) m/s², rad/s², at velocity (2, K), blade pitch and rotor speed (2, K)."""
        thrust = self.gain * self.k_t * speed * blade * np.array([[1 + self.fraction], [1 - self.fraction]])
        total, torque = thrust[0] + thrust[1], (thrust[0] - thrust[1]) * self.arm
        absolute = np.hypot(*velocity)
        pushed = [
            (along * total + self.bias[i] - self.damping[i] * velocity[i] - self.drag * absolute * velocity[i])
            / self.mass[i]
            for i, along in ((X, -np.sin(theta)), (Z, np.cos(theta)))
        ]
        return np.array([pushed[X], pushed[Z] - self.gravity, -torque / self.inertia])

    def fly(
        self, pose: np.ndarray, velocity: np.ndarray, command: np.ndarray, speed: np.ndarray, hold: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Integrate from rest of the blades, with commands held for `hold` [s] each.

        Args:
            pose: x, z, θ at the start, (K, 3).
            velocity: (K, 3).
            command: blade pitch, (K, M, 2) rad; zero before the first arrives.
            speed: of the rotors, constant, (K, 2) rad/s.
            hold: s.

        Returns:
            Pose, velocity and acceleration at 0, hold/5, 2 hold/5, ..., M hold, each (5 M + 1, K, 3).
        """
        count = command.shape[1]
        state = np.concatenate([pose.T, velocity.T, np.zeros((2, len(pose)))])
        wanted = np.arange(5 * count + 1) * hold / 5
        ends = np.unique(np.round(np.concatenate([wanted, np.arange(count) * hold + self.delay]), 12))
        ends = ends[ends < count * hold + 1e-9]
        states, accelerations = [state], [self.force(state[3:5], state[2], state[6:], speed.T)]
        for begin, end in pairwise(ends):
            middle = 0.5 * (begin + end)
            late = int(np.floor((middle - self.delay) / hold))
            target = command[:, late].T if late >= 0 else np.zeros_like(state[6:])

            def slope(_: float, flat: np.ndarray, target: np.ndarray = target) -> np.ndarray:
                y = flat.reshape(8, -1)
                forced = self.force(y[3:5], y[2], y[6:], speed.T)
                return np.concatenate([y[3:6], forced, (target - y[6:]) / self.time_constant]).ravel()

            solved = solve_ivp(slope, (begin, end), state.ravel(), "DOP853", t_eval=[end], rtol=1e-10, atol=1e-11)
            state = solved.y[:, -1].reshape(8, -1)
            if np.abs(wanted - end).min() < 1e-9:
                states.append(state)
                accelerations.append(self.force(state[3:5], state[2], state[6:], speed.T))
        series = np.array(states)
        return series[:, 0:3].swapaxes(1, 2), series[:, 3:6].swapaxes(1, 2), np.array(accelerations).swapaxes(1, 2)
