"""The same hover flown by the engine alone, by the twin and by the training environment, for `throughput.py`."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from vpptwin.engine.callback import stopped_clock
from vpptwin.robots.planar_drone.craft import CRAFT_JOINTS
from vpptwin.robots.planar_drone.vehicle import Vehicle, load_vehicle
from vpptwin.system.resources import find_model_file
from vpptwin.train.env.randomize import Priors, randomize
from vpptwin.train.env.tasks import HOVER, Task
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.robot.losses import take_out_losses

FRICTION = 0.3
"""Dry friction on each rail [N]."""
SUBSTEPS = 10
"""Physics steps of 1 ms in a control step."""
PERIOD = 0.01
"""Control step [s]."""
TASK: Task = HOVER


@dataclass
class Spent:
    """Time spent in what is measured, and what happened meanwhile."""

    wall: float = 0.0  # s
    processor: float = 0.0  # s, of all threads
    steps: int = 0  # control steps, all rigs together
    ended: int = 0  # episodes that ended, all rigs together
    failed: int = 0  # those of them that failed

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Count the time of a block."""
        wall, processor = time.perf_counter(), time.process_time()
        yield
        self.wall += time.perf_counter() - wall
        self.processor += time.process_time() - processor


def steer(vehicle: Vehicle, pose: np.ndarray, velocity: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Thrust [N] and rate [rad/s] that bring crafts (N, 3) upright to their targets, (N, 2)."""
    carried = vehicle.airframe.mass + vehicle.rig.slider_mass
    error = target - pose
    push = (carried + vehicle.rig.carriage_mass) * np.clip(4.0 * error[:, 0] - 3.5 * velocity[:, 0], -4.0, 4.0)
    lift = carried * (vehicle.gravity + np.clip(6.0 * error[:, 1] - 4.0 * velocity[:, 1], -5.0, 5.0))
    thrust = lift * np.cos(pose[:, 2]) - push * np.sin(pose[:, 2])
    rate = 8.0 * (np.arctan2(-push, lift) - pose[:, 2])
    limits = vehicle.control
    return np.column_stack([np.clip(thrust, 0.0, limits.thrust_max), np.clip(rate, -limits.rate_max, limits.rate_max)])


class Rigs(ABC):
    """N rigs that hover, each for 5 s from its own time on, then from a new start: so some begin anew at every step.

    Args:
        count: number of rigs.
        threads: of the engine.
        seed: of starts, targets and what a policy would explore.
    """

    def __init__(self, count: int, threads: int, seed: int) -> None:
        self.count, self.threads, self.rng = count, threads, np.random.default_rng(seed)
        self.vehicle = load_vehicle()
        self.target = np.zeros((count, 3))
        self.elapsed = self.rng.uniform(0.0, TASK.episode, count)

    def fly(self, steps: int) -> Spent:
        """Fly so many control steps of all rigs; only the engine's, twin's or environment's own part is timed."""
        spent = Spent(steps=steps * self.count)
        for _ in range(steps):
            pose, velocity = self.motion()
            command = steer(self.vehicle, pose, velocity, self.target)
            self.step(command + np.array([0.3, 1.0]) * self.rng.standard_normal(command.shape), spent)
        return spent

    @abstractmethod
    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose x, z, θ and velocity, (N, 3) each."""

    @abstractmethod
    def step(self, command: np.ndarray, spent: Spent) -> None:
        """Fly 10 ms under commands (N, 2) [N, rad/s], and begin anew where an episode is over."""

    def begin(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Draw new targets and starts."""
        self.target[ids] = TASK.target.draw(self.rng, len(ids))
        return TASK.start.draw(self.rng, self.target[ids])

    def end_episodes(self, spent: Spent) -> np.ndarray:
        """Advance the clocks; which rigs have to begin anew."""
        self.elapsed += PERIOD
        failed = TASK.limits.exceeded(self.vehicle, *self.motion())
        ids = np.flatnonzero(failed | (self.elapsed >= TASK.episode))
        spent.ended, spent.failed = spent.ended + len(ids), spent.failed + int(failed.sum())
        self.elapsed[ids] = 0.0
        return ids


class EngineRigs(Rigs):
    """`mujoco.batch.Batch.step(nstep=10)` alone, thrusts held for 10 ms.

    Args:
        friction: dry friction on each rail, in the engine's constraint solver [N].
        clock: whether the engine's profiling clock runs, as its Python bindings have it.
    """

    def __init__(self, count: int, threads: int, seed: int, friction: float, clock: bool) -> None:
        super().__init__(count, threads, seed)
        spec = mujoco.MjSpec.from_file(str(find_model_file("rail_rig.xml")))
        take_out_losses(spec, CRAFT_JOINTS)
        for name in ("rail_x", "rail_z"):
            spec.joint(name).frictionloss = friction
        self.batch, self.clock = Batch(spec.compile(), count, threads), clock
        self.qpos, self.qvel, self.ctrl = (self.batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self.qpos[:], self.qvel[:] = self.begin(np.arange(count))

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose and velocity, (N, 3) each."""
        return self.qpos, self.qvel

    def step(self, command: np.ndarray, spent: Spent) -> None:
        """Fly 10 ms; the rate loop is run once, as there is none inside."""
        torque = self.vehicle.control.rate_kp * (command[:, 1] - self.qvel[:, 2])
        half = 0.5 * torque / self.vehicle.airframe.half_length
        self.ctrl[:, 0], self.ctrl[:, 1] = 0.5 * command[:, 0] - half, 0.5 * command[:, 0] + half
        with nullcontext() if self.clock else stopped_clock(), spent.counted():
            self.batch.step(nstep=SUBSTEPS)
        ids = self.end_episodes(spent)
        self.qpos[ids], self.qvel[ids] = self.begin(ids)


class TwinRigs(Rigs):
    """`Twin.advance_policy`: the flight controller, servos, rotors and friction at 1 kHz.

    Args:
        every: all effects of the catalogue, drawn from their priors; else dry friction on both rails alone.
    """

    def __init__(self, count: int, threads: int, seed: int, every: bool) -> None:
        super().__init__(count, threads, seed)
        spec = load_twin()
        rails = ["rail_x.coulomb", "rail_z.coulomb"]
        self.twin = Twin(spec, count, [e.id for e in spec.catalogue] if every else rails, threads)
        if every:
            randomize(self.twin, Priors.of(spec.catalogue), np.arange(count), self.rng)
        else:
            self.twin.set_parameters([(rail, "force") for rail in rails], FRICTION)
        pose, velocity = self.begin(np.arange(count))
        self.state = self.twin.initial_state(pose, velocity)

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose and velocity, (N, 3) each."""
        return self.state.qpos, self.state.qvel

    def step(self, command: np.ndarray, spent: Spent) -> None:
        """Fly 10 ms."""
        with spent.counted():
            self.twin.advance_policy(self.state, command, PERIOD)
        ids = self.end_episodes(spent)
        self.state.write_rows(ids, self.twin.initial_state(*self.begin(ids), ids=ids))


class EnvRigs(Rigs):
    """`VppEnv`, stepped as TorchRL's collector does: sensors with noise, reward, resets that draw every effect anew."""

    def __init__(self, count: int, threads: int, seed: int, estimator: str = "sensors") -> None:
        super().__init__(count, threads, seed)
        import torch

        from vpptwin.train.env.base_env import EnvConfig
        from vpptwin.train.env.vpp_env import VppEnv

        torch.set_num_threads(1)
        spec = load_twin()
        every = [e.id for e in spec.catalogue]
        twin = Twin(spec, count, every, threads)
        self.env = VppEnv(twin, EnvConfig(TASK, seed, 1.0, every, desynchronize=True, estimator=estimator))
        self.now, self.tensor = self.env.reset(), torch.tensor
        self.scale = np.array([self.vehicle.control.thrust_max, self.vehicle.control.rate_max])

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose and velocity, (N, 3) each."""
        self.target = self.env.episodes.target
        return self.env.state.qpos, self.env.state.qvel

    def step(self, command: np.ndarray, spent: Spent) -> None:
        """Fly 10 ms; the environment begins its episodes itself."""
        self.now["action"] = self.tensor(command / self.scale).float()
        with spent.counted():
            last, self.now = self.env.step_and_maybe_reset(self.now)
        spent.ended += int(last["next", "done"].sum())
        spent.failed += int(last["next", "terminated"].sum())


CONTENDERS: dict[str, tuple[str, Callable[[int, int, int], Rigs]]] = {
    "raw": (
        "Batch.step(nstep=10), friction 0.3 N in its solver",
        lambda n, threads, seed: EngineRigs(n, threads, seed, FRICTION, clock=True),
    ),
    "raw, clock stopped": (
        "the same, profiling clock stopped",
        lambda n, threads, seed: EngineRigs(n, threads, seed, FRICTION, clock=False),
    ),
    "raw, no friction": (
        "Batch.step(nstep=10) without friction",
        lambda n, threads, seed: EngineRigs(n, threads, seed, 0.0, clock=True),
    ),
    "twin": (
        "Twin.advance_policy, friction 0.3 N, nothing else",
        lambda n, threads, seed: TwinRigs(n, threads, seed, every=False),
    ),
    "twin, all effects": (
        "Twin.advance_policy, every effect drawn from its prior",
        lambda n, threads, seed: TwinRigs(n, threads, seed, every=True),
    ),
    "environment": ("VppEnv: all effects, sensors, reward, resets", EnvRigs),
    "environment, kalman": (
        "VppEnv with estimator=kalman",
        lambda n, threads, seed: EnvRigs(n, threads, seed, "kalman"),
    ),
}
"""What is measured: title and how to make N rigs of it with a number of threads and a seed."""
