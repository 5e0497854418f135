"""The environment on the processor's cores: numpy's arrays, simulations stepped by numba or MuJoCo."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from vpptwin.engine.arrays import Rows
from vpptwin.robots.planar_drone.kalman import FilterNoise, KalmanFilter
from vpptwin.system.errors import InputError
from vpptwin.train.config import Schedule, TrainConfig
from vpptwin.train.env.base_env import BaseEnv, EnvConfig
from vpptwin.train.env.episodes import Episodes, FailedStarts
from vpptwin.train.env.randomize import IDENTIFIED, name_effects, randomize
from vpptwin.train.env.rotors import load_trained_twin, strengthen
from vpptwin.twin import Twin, TwinState
from vpptwin.twin.health import MAX_FAULTS, find_diverged, save_faults, take_fault
from vpptwin.twin.sensors import body_force, measure_rate, read_sensors
from vpptwin.twin.spec import TwinSpec, check_effects
from vpptwin.twin.stepping.past import SensorState, record_poses, start_sensors


class OnboardFilter:
    """The Kalman filter that `fly` flies on, for every simulation: what a flight computer makes of its sensors.

    Args:
        twin: whose simulations they are.
        noise: times the noise of the vehicle's IMU.
    """

    def __init__(self, twin: Twin, noise: float) -> None:
        imu = twin.vehicle.sensors.imu
        self._std = noise * np.array([imu.gyro_std, imu.accel_std, imu.accel_std])
        self._gravity = twin.vehicle.gravity
        self.filter = KalmanFilter(twin.num_sims, twin.dt, self._gravity, FilterNoise.of_vehicle(twin.vehicle))

    def follow(
        self, twin: Twin, path: tuple[np.ndarray, np.ndarray], state: TwinState, level: float, rng: np.random.Generator
    ) -> None:
        """Feed the IMU's samples of the policy step that the twin flew along `path` to `state`, noise at a level."""
        pose, qvel = (np.concatenate([way, end[:, None]], axis=1) for way, end in zip(path, (state.qpos, state.qvel)))
        force = body_force(pose, qvel, twin.dt, self._gravity)
        turn = np.diff(pose[..., 2], axis=1) / twin.dt
        error = level * self._std * rng.standard_normal((*turn.shape, 3))
        for k in range(turn.shape[1]):
            gyro = measure_rate(twin.constants, turn[:, k]) + error[:, k, 0]
            self.filter.predict(gyro, force[:, k] + error[:, k, 1:])

    def correct(self, seen: np.ndarray, rows: np.ndarray | slice) -> tuple[np.ndarray, np.ndarray]:
        """Take in a pose of the motion capture for the rows, (n, 3); pose and velocity as now known, (n, 3) each."""
        pose, new = np.full((len(self.filter.pose), 3), np.nan), np.zeros(len(self.filter.pose), bool)
        pose[rows], new[rows] = seen, True
        self.filter.correct(pose, seen=new)
        return self.filter.pose[rows], self.filter.velocity[rows]


class VppEnv(BaseEnv):
    """As many drones as the twin has simulations; see `BaseEnv`.

    Args:
        twin: simulates the rigs; the effects that are randomized have to be switched on in it.
        config: what to fly.

    Attributes:
        onboard: the filters of `estimator=kalman`, or None.
    """

    def __init__(self, twin: Twin, config: EnvConfig) -> None:
        super().__init__(twin, config, twin.num_sims, torch.device("cpu"))
        self.state: TwinState = twin.initial_state()
        self._before = self.state.copy()
        self.sensors: SensorState = start_sensors(self.state.qpos, self.state.qvel, self._depth, self._period)
        self.onboard = OnboardFilter(twin, config.noise) if config.estimator == "kalman" else None
        self.failed_starts = FailedStarts.empty()
        self._everyone = Rows(np.arange(self.count), every=True)

    @property
    def draws(self) -> np.random.Generator:
        """Source of every random number."""
        return self.rng

    def _read(self, tensor: torch.Tensor) -> np.ndarray:
        return tensor.numpy()

    def _draw_parameters(self, rows: Rows) -> None:
        drawn = randomize(self.twin, self._priors, rows.ids, self.rng, self._draw_levels(rows.count))
        self.episodes.drawn[rows.ids] = np.clip(self._priors.standardize(drawn), -5.0, 5.0)

    def _start_rigs(self, rows: Rows, pose: np.ndarray, velocity: np.ndarray) -> None:
        self.state.write_rows(rows.ids, self.twin.initial_state(pose, velocity, ids=rows.ids))
        self.sensors.write_rows(rows.ids, start_sensors(pose, velocity, self._depth, self._period))
        if self.onboard is not None:
            self.onboard.filter.start(rows.ids, pose, velocity)  # the craft has been flying and knows its motion

    def _fly(self, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What diverged begins anew at once."""
        self._before.overwrite(self.state)
        if self.onboard is None:
            self.twin.advance_policy(self.state, command, self._period)
        else:
            path = self.twin.trace_policy(self.state, command, self._period)
            self.onboard.follow(self.twin, path, self.state, self.difficulty, self.rng)
        record_poses(self.sensors, self.state.qpos, self.state.qvel)
        diverged = find_diverged(self.state)
        ids = np.flatnonzero(diverged)
        if len(ids):
            if self.config.fault_folder is not None:
                kept = ids[: max(MAX_FAULTS - self.faults, 0)]
                faults = (take_fault(self.twin, self._before, self.state, command, self._period, i) for i in kept)
                save_faults(self.config.fault_folder, dict(enumerate(faults, self.faults + 1)))
            self._faults += len(ids)
            self._begin(Rows(ids))
        return diverged, diverged

    def _sense(self, rows: Rows) -> tuple[np.ndarray, np.ndarray]:
        state, key = self.state, rows.key
        seen = self.sensors.take(key)
        return read_sensors(
            self.twin.constants[key], seen, state.qpos[key], state.qvel[key], state.time[key], self._period
        )

    def _filter(self, rows: Rows, pose: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (pose, velocity) if self.onboard is None else self.onboard.correct(pose, rows.key)

    def _show_first(self) -> TwinState:
        return self.state

    def take_snapshot(self) -> dict[str, Any]:
        """Everything that evolves, as tensors and plain data, so that a resumed run goes on as if never interrupted."""
        twin, active = self.twin, self.twin.effects
        drawn = {id_: {p.name: twin.parameter(id_, p.name) for p in active[id_].parameters} for id_ in self.randomized}
        return {
            "state": to_tensors(self.state.arrays()),
            "sensors": to_tensors(self.sensors.arrays()),
            "episodes": to_tensors(vars(self.episodes)),
            "failed_starts": to_tensors(vars(self.failed_starts)),
            "parameters": {effect: to_tensors(values) for effect, values in drawn.items()},
            "random": json.dumps(self.rng.bit_generator.state),
            "onboard": None if self.onboard is None else to_tensors(self.onboard.filter.save()),
            "faults": self.faults, "flown": self.flown,
        }  # fmt: skip

    def restore_snapshot(self, snapshot: Mapping[str, Any]) -> None:
        """Go on where a snapshot was taken; the next full reset hands out the observation of that moment.

        Raises:
            InputError: if a version took it that kept less of a simulation.
        """
        missing = self.state.arrays().keys() - snapshot.get("state", {}).keys()
        missing |= vars(self.episodes).keys() - snapshot.get("episodes", {}).keys()
        if missing:
            found = f"a checkpoint whose simulations lack {', '.join(sorted(missing))}"
            raise InputError(found, "one of this version", "train on with init_from=RUN, which takes the policy alone")
        for effect, values in snapshot["parameters"].items():
            for name, value in values.items():
                self.twin.set_parameter(effect, name, value.numpy())
        self.state = TwinState.from_arrays(to_arrays(snapshot["state"]))
        self.sensors = SensorState.from_arrays(to_arrays(snapshot["sensors"]))
        self.episodes = Episodes(**to_arrays(snapshot["episodes"]))
        self.failed_starts = FailedStarts(**to_arrays(snapshot["failed_starts"]))
        if self.onboard is not None:
            self.onboard.filter.restore(to_arrays(snapshot["onboard"]))
        self.rng.bit_generator.state = json.loads(snapshot["random"])
        self._faults, self.flown, self.restored = snapshot["faults"], snapshot["flown"], True


def to_tensors(arrays: Mapping[str, Any]) -> dict[str, torch.Tensor]:
    """Copies of the arrays among the values, as tensors."""
    return {name: torch.tensor(value) for name, value in arrays.items() if isinstance(value, np.ndarray)}


def to_arrays(tensors: Mapping[str, torch.Tensor]) -> dict[str, np.ndarray]:
    """Copies as arrays."""
    return {name: value.numpy().copy() for name, value in tensors.items()}


def make_env(
    config: TrainConfig, fault_folder: Path | None = None, schedule: Schedule | None = None,
    spec: TwinSpec | None = None,
) -> VppEnv:  # fmt: skip
    """The environment of a run.

    Args:
        config: of the run.
        fault_folder: where simulations that diverged are written; None to only count them.
        schedule: of training; None for flying at full difficulty.
        spec: a twin that was read, in place of that of the configuration.

    Raises:
        InputError: if the twin is unknown or not a drone, or an effect is not in its catalogue.
    """
    spec, flown = configure_env(config, schedule, fault_folder, spec)
    return VppEnv(Twin(spec, config.num_envs, active=flown.randomized, num_threads=config.sim_threads), flown)


def configure_env(
    config: TrainConfig, schedule: Schedule | None, faults: Path | None = None, spec: TwinSpec | None = None
) -> tuple[TwinSpec, EnvConfig]:
    """The twin of a run, and what an environment flies with it; arguments as `make_env`.

    Raises:
        InputError: as `make_env`.
    """
    spec = load_trained_twin(config) if spec is None else spec
    _ = spec.vehicle  # refuses other rigs
    randomized = name_effects(config.randomize, spec.catalogue, spec.intervals)
    check_effects({effect: {} for effect in randomized}, spec.catalogue, "randomize")
    flown = EnvConfig(
        config.task, config.seed, config.noise, randomized, IDENTIFIED in config.randomize, config.observation,
        config.estimator, config.desynchronize, schedule, config.critic_memory, config.privileged, faults,
    )  # fmt: skip
    return strengthen(spec, config.task.thrust_to_weight, config.task.commanded), flown
