"""Servos, propellers and motors of the true rig (the paper's Eq. 5 and 6)."""

from __future__ import annotations

import numpy as np

from .rig import Rig

STEP = 0.001  # s, inner loop
SUBSTEPS = 4
# Where within a step blade pitch is needed: the substeps' midpoints, then the end, s. Shape (SUBSTEPS + 1,).
NODES = np.append((np.arange(SUBSTEPS) + 0.5) / SUBSTEPS, 1.0) * STEP


class Servo:
    """First-order lag behind a pure delay, solved exactly for piecewise constant commands."""

    def __init__(self, rig: Rig, blade_pitch: np.ndarray, step: float = STEP) -> None:
        """Start settled at `blade_pitch` rad, (2, flights); `advance` advances by `step` s."""
        hidden, nodes = rig.hidden, NODES * (step / STEP)
        self.trim = np.stack([hidden.get("servo.trim", "offset_1"), hidden.get("servo.trim", "offset_2")])
        self.horn = blade_pitch.copy()
        self.blade = blade_pitch.copy()
        whole = np.floor(rig.command_delay / step + 1e-9).astype(int)
        self.whole = whole
        self.delayed = bool(rig.command_delay.any())
        self.history = np.repeat(blade_pitch[None], whole.max() + 2, axis=0)
        self.tick = 0
        self.flight = np.arange(rig.count)
        switch = np.maximum(rig.command_delay - whole * step, 0.0)
        self.gains = self._solve(nodes[:, None], switch, rig.servo_lag)
        self.rate = hidden.get("servo.rate_limit", "rate")
        self.gap = hidden.get("servo.backlash", "gap") / 2
        self.limited = hidden.any("servo.rate_limit", "servo.backlash")
        self.twice, self.late = rig.second_lag > 0.0, blade_pitch.copy()
        spread = np.diff(nodes, prepend=0.0)[:, None]
        self.follow = 1 - np.exp(-spread / np.where(self.twice, rig.second_lag, 1.0))  # of the second lag, per span
        spans = np.diff(nodes, prepend=0.0)[:, None]
        earlier = np.clip(switch - (nodes[:, None] - spans), 0.0, spans)  # of each span, until the new command arrives
        self.moves = [(span[:, None], np.exp(-span / rig.servo_lag)[:, None]) for span in (earlier, spans - earlier)]

    @staticmethod
    def _solve(time: np.ndarray, switch: np.ndarray, lag: np.ndarray) -> tuple[np.ndarray, ...]:
        """Weights of start value, command before `switch` and command after it, each (nodes, 1, flights)."""
        before = np.exp(-np.minimum(time, switch) / lag)
        after = np.exp(-np.maximum(time - switch, 0.0) / lag)
        weights = before * after, (1 - before) * after, np.broadcast_to(1 - after, before.shape)
        return tuple(np.ascontiguousarray(w)[:, None, :] for w in weights)

    def advance(self, command: np.ndarray) -> np.ndarray:
        """Advance one step.

        Args:
            command: Blade pitch commanded at its start, rad. (2, flights).

        Returns:
            Blade pitch at NODES, rad. (nodes, 2, flights).
        """
        if self.delayed:
            depth = len(self.history)
            self.history[self.tick % depth] = command
            late = (self.tick - self.whole) % depth
            earlier = self.history[(late - 1) % depth, :, self.flight].T
            command = self.history[late, :, self.flight].T
            self.tick += 1
        else:
            earlier = command
        before = self.blade if self.limited else self.horn
        if self.limited:
            path = self._advance_limited(earlier, command)
        else:
            keep, first, second = self.gains
            path = keep * self.horn + first * earlier + second * command
            self.horn = path[-1]
        return (self._lag_again(before, path) if self.twice.any() else path) + self.trim

    def _lag_again(self, before: np.ndarray, path: np.ndarray) -> np.ndarray:
        """A second lag behind the first, which between two nodes is taken at its mean."""
        lagged = path.copy()
        for node, (start, end) in enumerate(zip((before, *path), path)):
            self.late = self.late + self.follow[node] * (0.5 * (start + end) - self.late)
            lagged[node] = np.where(self.twice, self.late, end)
        return lagged

    def _advance_limited(self, earlier: np.ndarray, command: np.ndarray) -> np.ndarray:
        path = np.empty((len(NODES), *command.shape))
        moves = list(zip((earlier, command), self.moves))[0 if self.delayed else 1 :]
        for node in range(len(NODES)):
            for target, (span, keep) in moves:
                reach = self.rate * span[node]
                self.horn = self.horn + np.clip((1 - keep[node]) * (target - self.horn), -reach, reach)
            self.blade = np.clip(self.blade, self.horn - self.gap, self.horn + self.gap)
            path[node] = self.blade
        return path


class Propeller:
    """Thrust from blade pitch and speed."""

    def __init__(self, rig: Rig) -> None:
        hidden = rig.hidden
        self.k_t = rig.k_t
        self.onset, self.stalls = hidden.get("rotor.stall", "onset"), hidden.any("rotor.stall")
        self.loss, self.weak = hidden.get("rotor.negative_thrust", "loss"), hidden.any("rotor.negative_thrust")
        self.chip = hidden.get("alien.chip", "loss") if hidden.any("alien.chip") else None
        self.chip_time = hidden.get("alien.chip", "time")
        self.flutter, self.flutters = hidden.get("alien.flutter", "loss"), hidden.any("alien.flutter")
        self.pitch = np.zeros((2, rig.count))

    def break_blade(self, time: float) -> None:
        """Lose a share of rotor 1's thrust once its time (s after the start of the log) has come."""
        if self.chip is None or not (due := (time >= self.chip_time) & (self.chip > 0.0)).any():
            return
        self.k_t = self.k_t * np.stack([np.where(due, 1 - self.chip, 1.0), np.ones_like(self.chip)])
        self.chip = np.where(due, 0.0, self.chip)

    def compute_thrust(self, pitch: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Thrust N at NODES from blade pitch rad and rotor speed rad/s, all (nodes, 2, flights)."""
        useful = pitch
        if self.stalls:
            beyond = np.maximum(np.abs(pitch) - self.onset, 0.0)
            useful = pitch - 0.75 * np.sign(pitch) * beyond
        thrust = self.k_t * speed * useful
        if self.weak:
            thrust *= np.where(pitch < 0.0, 1 - self.loss, 1.0)
        if self.flutters:
            rate = np.abs(pitch[-1] - self.pitch) / STEP
            thrust *= np.maximum(1 - self.flutter * rate, 0.3)
            self.pitch = pitch[-1].copy()
        return thrust


class Motor:
    """Brushless motor on the battery, midpoint rule over a step of a millisecond (its time constant is 60 ms)."""

    def __init__(self, rig: Rig, step: float = STEP) -> None:
        self.step = step
        rotor, motor = rig.nominal["rotor"], rig.nominal["motor"]
        self.k_v, self.k_q, self.resistance = motor["k_v"], motor["k_q"], motor["resistance"]
        self.no_load, self.battery = motor["no_load_current"], float(motor["battery"])
        self.inertia, self.k_d = rotor["inertia"], (rotor["k_d1"], rotor["k_d2"], rotor["k_d3"])
        self.drag_gain = rig.hidden.get("rotor.drag", "gain")
        self.sag = rig.hidden.get("battery.sag", "rate")
        self.speed = np.full((2, rig.count), float(rotor["speed"]))
        self.voltage = np.full((2, rig.count), self.speed / self.k_v)
        self.fraction = (NODES / STEP)[:, None, None]

    def compute_drag(self, speed: np.ndarray, pitch: np.ndarray) -> np.ndarray:
        """Drag torque N m from speed rad/s and blade pitch rad."""
        k1, k2, k3 = self.k_d
        twist = speed * np.abs(pitch)
        return self.drag_gain * (k1 * speed * speed + (k2 * twist + k3) * twist)

    def compute_current(self) -> np.ndarray:
        """Current A under the voltage that has acted up to now. (2, flights)."""
        return (self.voltage - self.speed / self.k_v) / self.resistance

    def compute_supply(self, time: float) -> np.ndarray:
        """Battery voltage V at `time` s after the start of the log. (flights,)."""
        return self.battery * (1 - self.sag * max(time, 0.0))

    def _accelerate(self, speed: np.ndarray, pitch: np.ndarray) -> np.ndarray:
        current = (self.voltage - speed / self.k_v) / self.resistance
        return ((current - self.no_load) / self.k_q - self.compute_drag(speed, pitch)) / self.inertia

    def advance(self, throttle: np.ndarray, pitch: np.ndarray, time: float) -> np.ndarray:
        """Advance one step.

        Args:
            throttle: Share of battery voltage. (2, flights).
            pitch: Blade pitch at NODES, rad. (nodes, 2, flights).
            time: s after the start of the log.

        Returns:
            Rotor speed at NODES, rad/s. (nodes, 2, flights).
        """
        self.voltage = throttle * self.compute_supply(time)
        middle = 0.5 * (pitch[SUBSTEPS // 2 - 1] + pitch[SUBSTEPS // 2])
        half = self.speed + 0.5 * self.step * self._accelerate(self.speed, middle)
        change = self.step * self._accelerate(half, middle)
        path = self.speed + self.fraction * change
        self.speed = path[-1]
        return path
