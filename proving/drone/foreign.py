"""Forces of effects outside the catalogue, of those of it whose law is another (outside.py), and of an elastic rail."""

from __future__ import annotations

import numpy as np

from .rig import PITCH, Rig, X, Z

_SLOSH_DAMPING = 0.05  # 1, of critical


class Foreign:
    """Their parameters and what of them has memory. Whatever no flight of the batch has is left out."""

    def __init__(self, rig: Rig) -> None:
        hidden = rig.hidden
        self.here = {
            effect
            for effects in hidden.flights
            for effect in effects
            if effect.startswith(("alien.", "form.")) or effect == "rail_x.elastic"
        }

        def get(effect: str, *names: str) -> list[np.ndarray]:
            return [hidden.get(effect, name) for name in names]

        self.cogging, self.hum = get("alien.cogging", "force", "period"), get("alien.hum", "force", "frequency")
        self.hysteresis = get("alien.hysteresis", "force", "reach")
        self.slosh, slosh = get("alien.slosh", "mass", "frequency")
        self.omega = 2 * np.pi * slosh  # rad/s
        self.crosswind, self.swirl = hidden.get("alien.crosswind", "gain"), hidden.get("alien.swirl", "gain")
        self.side_thrust = hidden.get("alien.side_thrust", "gain")
        self.creep, self.grease = get("form.creep", "force", "velocity"), get("form.grease", "damping", "exponent")
        self.drag, self.ground = get("form.drag", "k_d", "exponent"), get("form.ground", "gain", "height")
        self.spring = get("form.spring", "stiffness", "rest", "stretch")
        share, tone, self.zeta = get("rail_x.elastic", "share", "frequency", "zeta")
        self.loose, self.tone = share * rig.mass_x, 2 * np.pi * tone  # kg, rad/s
        self.sway, self.sway_rate = np.zeros(rig.count), np.zeros(rig.count)  # m, m/s, of what gives, from the carriage
        self.time = 0.0  # s since the plant's start
        self.bristle = np.zeros(rig.count)  # 1, -1 to 1
        self.climb = np.zeros(rig.count)  # m/s^2, of the craft, a substep ago
        self.swing, self.swing_rate = (
            np.zeros(rig.count),
            np.zeros(rig.count),
        )  # m, m/s, of the mass seen from the craft

    def lift(self, thrust: np.ndarray, position: np.ndarray) -> np.ndarray:
        """Thrust of each rotor near the ground, N. (2, flights)."""
        if "form.ground" not in self.here:
            return thrust
        gain, height = self.ground
        return thrust * (1 + gain * (height / (height + np.maximum(position[Z], 0.0))) ** 3)

    def push_craft(
        self, force: np.ndarray, velocity: np.ndarray, thrust: np.ndarray, sine: np.ndarray, cosine: np.ndarray
    ) -> None:
        """Add to `force` N, N, N m, (3, flights), what acts on the craft."""
        here = self.here
        if "form.drag" in here:
            force[:PITCH] -= self.drag[0] * np.hypot(velocity[X], velocity[Z]) ** (self.drag[1] - 1) * velocity[:PITCH]
        if "alien.crosswind" in here:
            force[X] += self.crosswind * velocity[X] * velocity[Z]
        if "alien.side_thrust" in here:
            aside = self.side_thrust * (thrust[1] - thrust[0])
            force[X] += aside * cosine
            force[Z] += aside * sine
        if "alien.swirl" in here:
            force[PITCH] += self.swirl * velocity[X] * velocity[PITCH]
        if "alien.hum" in here:
            force[Z] += self.hum[0] * np.sin(2 * np.pi * self.hum[1] * self.time)
        if "alien.slosh" in here:
            force[Z] += self.slosh * (self.climb + self._pull_swing())  # not its inertia, but its spring

    def push_joints(self, force: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> None:
        """Add what acts between rails and carriage or slider."""
        here = self.here
        if "alien.cogging" in here:
            force[X] -= self.cogging[0] * np.sin(2 * np.pi * position[X] / self.cogging[1])
        if "alien.hysteresis" in here:
            force[X] -= self.hysteresis[0] * self.bristle
        if "rail_x.elastic" in here:
            force[X] += self.loose * self._pull_sway()
        if "form.creep" in here:
            force[X] -= self.creep[0] * np.tanh(velocity[X] / self.creep[1])
        if "form.grease" in here:
            force[Z] -= self.grease[0] * np.sign(velocity[Z]) * np.abs(velocity[Z]) ** self.grease[1]
        if "form.spring" in here:
            stiffness, rest, stretch = self.spring
            away = position[X] - rest
            force[X] -= stiffness * away * (1 + (away / stretch) ** 2)

    def _pull_swing(self) -> np.ndarray:
        """Acceleration m/s^2 by which the hanging mass is drawn back to where it hangs at rest."""
        return self.omega * (self.omega * self.swing + 2 * _SLOSH_DAMPING * self.swing_rate)

    def _pull_sway(self) -> np.ndarray:
        """Acceleration m/s^2 by which what gives on the rail is drawn back to the carriage, turned round."""
        return self.tone * (self.tone * self.sway + 2 * self.zeta * self.sway_rate)

    def advance(self, velocity: np.ndarray, accel: np.ndarray, step: float) -> None:
        """Advance what has memory by `step` s under the craft's motion, (3, flights) each."""
        self.time += step
        if "alien.hysteresis" in self.here:
            rate = velocity[X] / self.hysteresis[1]
            self.bristle = np.clip(self.bristle + step * (rate - np.abs(rate) * self.bristle), -1.0, 1.0)
        if "rail_x.elastic" in self.here:
            self.sway_rate = self.sway_rate - step * (self._pull_sway() + accel[X])
            self.sway = self.sway + step * self.sway_rate
        if "alien.slosh" in self.here:
            self.climb = accel[Z]
            self.swing_rate = self.swing_rate - step * (self._pull_swing() + self.climb)
            self.swing = self.swing + step * self.swing_rate
