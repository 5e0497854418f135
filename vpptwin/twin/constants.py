"""Per-simulation constants of a twin: nominal values with the effects applied, kept in step with the engine."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from mujoco.batch import Batch

from vpptwin.effects import Effect, Stage
from vpptwin.twin.model import locate_effect
from vpptwin.twin.spec import TwinSpec

DELAY_CONSTANT = "actuator.delay"


class ConstantTable:
    """The constants that CONSTANT effects write, by name: fields of the MuJoCo model, of actuators and of sensors.

    Attributes:
        values: parameter values, (effect id, parameter) → (N,).
        table: constants after the effects, name → (N, ...).
        sites: where each effect acts.
        delay_depth: commands that the delay line holds; 0 when no effect delays.
    """

    def __init__(self, spec: TwinSpec, effects: Mapping[str, Effect], num_sims: int, batch: Batch) -> None:
        self._batch = batch
        self._effects = [e for e in effects.values() if e.stage is Stage.CONSTANT]
        self._by_id = effects
        self.sites = {e.id: locate_effect(spec.model, e, spec.vehicle is not None) for e in effects.values()}
        self.values = {
            (e.id, p.name): np.full(num_sims, spec.value(e, p.name)) for e in effects.values() for p in e.parameters
        }
        self._nominal = nominal_constants(spec, num_sims)
        written = {name for e in self._effects for name in e.writes}
        self._fields = sorted(name for name in written if hasattr(spec.model, name))
        for name in self._fields:
            self._nominal[name] = batch.expand(name).copy()
        self.table = {name: value.copy() for name, value in self._nominal.items()}
        self._derives = any(name in mujoco.MjModel._setconst_inputs for name in self._fields)
        delays = [p.high for e in self._effects if DELAY_CONSTANT in e.writes for p in e.parameters]
        self.delay_depth = int(np.ceil(max(delays) / float(spec.model.opt.timestep))) + 2 if delays else 0
        self._stale = True

    def set_parameter(
        self, effect_id: str, parameter: str, values: np.ndarray | float, ids: np.ndarray | None = None
    ) -> None:
        """Set one parameter, for all simulations or for `ids`; the constants follow at the next `refresh`."""
        if (effect_id, parameter) not in self.values:
            known = ", ".join(f"{e}.{p}" for e, p in self.values) or "none"
            raise KeyError(f"{effect_id}.{parameter} is not switched on; these are: {known}")
        self.values[effect_id, parameter][slice(None) if ids is None else ids] = values
        self._stale |= self._by_id[effect_id].stage is Stage.CONSTANT

    def refresh(self) -> None:
        """Apply the CONSTANT effects to nominal values and hand the result to the engine, if anything changed."""
        if not self._stale:
            return
        for name, nominal in self._nominal.items():
            self.table[name][:] = nominal
        for effect in self._effects:
            parameters = {p.name: self.values[effect.id, p.name] for p in effect.parameters}
            effect.apply(self.table, self.sites[effect.id], **parameters)
        for name in self._fields:
            self._batch.expand(name)[:] = self.table[name]
        if self._derives:
            self._batch.set_const()
        self._stale = False


def nominal_constants(spec: TwinSpec, num_sims: int) -> dict[str, np.ndarray]:
    """Constants of actuators and sensors with no effect switched on, each (N, ...)."""
    actuators = (num_sims, spec.model.nu)
    time_constant = spec.vehicle.servo.time_constant if spec.vehicle is not None else 0.0
    return {
        "actuator.delay": np.zeros(actuators),
        "actuator.time_constant": np.full(actuators, time_constant),
        "actuator.gain": np.ones(actuators),
        "mocap.delay": np.zeros(num_sims),
    }
