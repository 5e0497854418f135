"""Per-simulation constants of a twin: nominal values with the effects applied, kept in step with the engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch

from vpptwin.actuators.layer import nominal_constants
from vpptwin.effects import Effect, Stage
from vpptwin.engine.callback import installed
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.stepping.kernel import Kernel

Key = tuple[str, str]
"""Effect id and parameter."""


class ConstantTable:
    """The constants that CONSTANT effects write, by name: fields of the MuJoCo model, of actuators and of sensors.

    Attributes:
        values: parameter values, (effect id, parameter) → (N,).
        parameters: those of the effects that act every step, (N, P), in the order of the compiled pipeline.
        records: constants of actuators and sensors after the effects, (N,) records.
        table: all constants after the effects, name → (N, ...); those of `records` are views of it.
    """

    def __init__(
        self, spec: TwinSpec, effects: Mapping[str, Effect], num_sims: int, batch: Batch, kernel: Kernel
    ) -> None:
        self._batch = batch
        self._effects = [e for e in effects.values() if e.stage is Stage.CONSTANT]
        self._by_id = effects
        self._sites = {e.id: spec.robot.list_sites(e) for e in self._effects}
        columns = kernel.pipeline.columns
        self.parameters = np.zeros((num_sims, len(columns)))
        for effect in spec.catalogue:
            for p in effect.parameters:
                if (effect.id, p.name) in columns:
                    self.parameters[:, columns[effect.id, p.name]] = p.off
        keys = [(e.id, p.name) for e in effects.values() for p in e.parameters]
        self._columns = columns | {key: len(columns) + i for i, key in enumerate(k for k in keys if k not in columns)}
        self._settings = np.zeros((num_sims, len(self._columns) - len(columns)))
        limits = np.array([[p.low, p.high] for e in effects.values() for p in e.parameters]).reshape(-1, 2)
        self._limits = dict(zip(keys, limits))
        self.values: dict[Key, np.ndarray] = {}
        for effect_id, name in keys:
            column, acting = self._columns[effect_id, name], len(columns)  # those that act every step come first
            held = self.parameters[:, column] if column < acting else self._settings[:, column - acting]
            self.values[effect_id, name] = held
            self.values[effect_id, name][:] = spec.value(effects[effect_id], name)
        self.records = np.zeros(num_sims, kernel.constants)
        self._nominal = nominal_constants(spec.robot.servo_lag, self.records)
        self.table = {name: self.records[name] for name in kernel.constants.names or ()}
        written = {name for e in self._effects for name in e.writes}
        self._fields = sorted(written - set(self.table))
        for name in self._fields:
            self._nominal[name] = batch.expand(name)[0].copy()
            self.table[name] = batch.expand(name)
        self._derives = any(name in mujoco.MjModel._setconst_inputs or name.startswith("opt.") for name in self._fields)
        self._stale: np.ndarray | None = np.ones(num_sims, dtype=bool)

    def set_parameters(self, keys: Sequence[Key], values: np.ndarray | float, ids: np.ndarray | None = None) -> None:
        """Set parameters, for all simulations or for `ids`; the constants follow at the next `refresh`.

        Args:
            keys: K parameters.
            values: (n, K), or anything that broadcasts to it.
            ids: n simulations.

        Raises:
            KeyError: if an effect is not switched on or has no such parameter.
            ValueError: if a value lies outside its parameter's bounds or is not a number.
        """
        for effect_id, parameter in keys:
            if (effect_id, parameter) not in self.values:
                known = ", ".join(f"{e}.{p}" for e, p in self.values) or "none"
                raise KeyError(f"{effect_id}.{parameter} is not switched on; these are: {known}")
        rows = np.arange(len(self.records)) if ids is None else np.asarray(ids)
        given = np.broadcast_to(np.asarray(values, dtype=float), (len(rows), len(keys)))
        low, high = np.array([self._limits[key] for key in keys]).reshape(-1, 2).T
        outside = ~((given >= low) & (given <= high))
        if outside.any():
            row, k = np.argwhere(outside)[0]
            effect_id, name = keys[k]
            limits = self._by_id[effect_id].parameter(name)
            raise ValueError(
                f"{effect_id}.{name} = {given[row, k]:g} {limits.unit}".rstrip()
                + f"; expected {limits.low:g} to {limits.high:g}; clip it or change the catalogue's bounds"
            )
        columns, acting = np.array([self._columns[key] for key in keys], dtype=int), self.parameters.shape[1]
        steady = columns >= acting
        self.parameters[rows[:, None], columns[~steady]] = given[:, ~steady]
        if steady.any():
            self._settings[rows[:, None], columns[steady] - acting] = given[:, steady]
            if self._stale is None:
                self._stale = np.zeros(len(self.records), dtype=bool)
            self._stale[rows] = True

    def refresh(self) -> None:
        """Apply the CONSTANT effects to nominal values where parameters changed, and let the engine derive the rest."""
        if self._stale is None:
            return
        rows = np.flatnonzero(self._stale)
        whole = len(rows) == len(self.records)
        fresh = {
            name: np.repeat(np.asarray(nominal)[None], len(rows), axis=0) for name, nominal in self._nominal.items()
        }
        for effect in self._effects:
            parameters = {p.name: self.values[effect.id, p.name][rows] for p in effect.parameters}
            for site in self._sites[effect.id]:
                effect.apply(fresh, site, **parameters)
        for name, values in fresh.items():
            self.table[name][slice(None) if whole else rows] = values
        if self._derives:
            with installed(None):  # a user's callback in Python would be refused
                self._batch.set_const(None if whole else rows)
        self._stale = None
