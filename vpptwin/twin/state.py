"""Everything that evolves in a twin, as plain arrays: copy it, save it, put it back, continue bit-equal."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from vpptwin.actuators.layer import ActuatorState


@dataclass(frozen=True)
class TwinState:
    """State of N simulations, leading axis N.

    Attributes:
        time: (N,) s.
        qpos: generalized positions, (N, nq) m, rad; x, z, θ on the drone.
        qvel: generalized velocities, (N, nv) m/s, rad/s.
        warmstart: the constraint solver's last accelerations, (N, nv): without them a restored run differs in rounding.
        actuators: state of the actuator layer.
    """

    time: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    warmstart: np.ndarray
    actuators: ActuatorState

    @property
    def blade_pitch(self) -> np.ndarray:
        """Blade pitch, (N, nu) rad (the control input on other rigs)."""
        return self.actuators.output

    @property
    def rotor_speed(self) -> np.ndarray:
        """Rotor speed, (N, nu) rad/s."""
        return self.actuators.rotor_speed

    @property
    def throttle(self) -> np.ndarray:
        """Throttle, (N, nu), 0..1 of battery voltage."""
        return self.actuators.throttle

    def take(self, ids: np.ndarray) -> TwinState:
        """The rows `ids` as a state of their own (a copy); repeats are allowed."""
        rows = {f.name: getattr(self, f.name)[ids] for f in fields(self) if f.name != "actuators"}
        layer = {f.name: getattr(self.actuators, f.name)[ids] for f in fields(self.actuators)}
        return TwinState(**rows, actuators=ActuatorState(**layer))

    def copy(self) -> TwinState:
        """A deep copy."""
        return self.take(np.arange(len(self.time)))

    def replace_rows(self, ids: np.ndarray, rows: TwinState) -> TwinState:
        """This state with its rows `ids` exchanged for `rows`, which has len(ids) rows; neither argument changes."""

        def exchange(old: np.ndarray, new: np.ndarray) -> np.ndarray:
            result = old.copy()
            result[ids] = new
            return result

        top = {
            f.name: exchange(getattr(self, f.name), getattr(rows, f.name))
            for f in fields(self)
            if f.name != "actuators"
        }
        layer = {
            f.name: exchange(getattr(self.actuators, f.name), getattr(rows.actuators, f.name))
            for f in fields(self.actuators)
        }
        return replace(self, **top, actuators=ActuatorState(**layer))
