"""Rigs that the properties of every effect are tested on: the drone, flown and replayed, and a cart with a pendulum."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vpptwin.effects import CATALOGUE, Effect, Parameter, effects_for_rig, find_effect
from vpptwin.twin import Twin, TwinSpec, TwinState, load_twin

CONTROL = 0.01
"""Commands are held, and tracks sampled, for this long [s]."""

CART_PENDULUM = """<mujoco model="cart_pendulum">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="Euler"/>
  <default><joint solimpfriction="0.9999 0.9999 0.001 0.5 2" solreffriction="0.004 1"/></default>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="0.8" diaginertia="1e-3 1e-3 1e-3"/>
      <body name="pole">
        <joint name="swing" type="hinge" axis="0 -1 0"/>
        <inertial pos="0 0 -0.3" mass="0.2" diaginertia="2e-3 2e-3 1e-5"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="slide" gear="3"/></actuator>
</mujoco>
"""
CART_TWIN = """model: cart_pendulum.xml
signals:
  joints: {slide: /joint_states, swing: /joint_states}
  actuators: {motor: /actuator_command}
"""

CART_EFFECTS = effects_for_rig([("slide", False, 1.0), ("swing", True, 1.0)], ["motor"])
EFFECTS = {"flown": CATALOGUE, "replayed": CATALOGUE, "cart": CART_EFFECTS}
"""What each rig can have, as known before it is loaded."""


@dataclass(frozen=True)
class Rig:
    """A rig, how it is driven, and where its rollouts start.

    Attributes:
        name: `flown` (drone under policy commands), `replayed` (drone under blade pitches) or `cart`.
        spec: no effect switched on.
        low, high: corners of the box that starts are drawn from, positions before velocities, (2 nv,) m, rad, m/s, ...
        drives: standard deviation of a random command, (nu,).
        trim: its mean.
    """

    name: str
    spec: TwinSpec
    low: tuple[float, ...]
    high: tuple[float, ...]
    drives: tuple[float, ...]
    trim: tuple[float, ...]

    def effect(self, effect_id: str) -> Effect:
        """The effect as this rig has it, off values bound to the vehicle."""
        return find_effect(self.spec.catalogue, effect_id)

    def start(self, twin: Twin, seed: int, total: int | None = None, first: int = 0) -> TwinState:
        """A random state: rows `first` onwards of a batch of `total`."""
        rng = np.random.default_rng(seed)
        box = rng.uniform(self.low, self.high, (total or twin.num_sims, len(self.low)))
        qpos, qvel = np.split(box[first : first + twin.num_sims], 2, axis=1)
        return twin.initial_state(qpos=twin.pose_for_engine(qpos, qvel), qvel=qvel)

    def command(self, k: int) -> np.ndarray:
        """The k-th command of a random sequence, the same for every simulation, (nu,)."""
        return np.array(self.trim) + np.array(self.drives) * np.random.default_rng([7, k]).normal(size=len(self.trim))

    def advance(self, twin: Twin, state: TwinState, k: int, powered: bool = True) -> TwinState:
        """The state 10 ms later under the k-th command, or with rotors and motors off."""
        command = self.command(k) * powered
        if self.name == "flown":
            return twin.step_policy(state, np.tile(command, (twin.num_sims, 1)), CONTROL)
        held = np.tile(command, (twin.num_sims, round(CONTROL / twin.dt), 1))
        return twin.replay_commands(state, held)[0]

    def roll(self, twin: Twin, state: TwinState, first: int = 0, count: int = 15, powered: bool = True) -> Track:
        """States every 10 ms, the start included."""
        states = [state]
        for k in range(first, first + count):
            states.append(self.advance(twin, states[-1], k, powered))
        return Track(twin, states)

    def with_step(self, dt: float) -> Rig:
        """The same rig simulated with another inner step [s]."""
        model = copy.copy(self.spec.model)
        model.opt.timestep = dt
        return replace(self, spec=replace(self.spec, model=model))


@dataclass(frozen=True)
class Track:
    """States of a rollout, and what the sensors would show of it."""

    twin: Twin
    states: list[TwinState]

    @property
    def last(self) -> TwinState:
        """The final state."""
        return self.states[-1]

    @property
    def pose(self) -> np.ndarray:
        """Positions at the states' times, (T, N, nv) m, rad."""
        return np.array([self.twin.pose_at_time(s.qpos, s.qvel) for s in self.states])

    @property
    def velocity(self) -> np.ndarray:
        """Velocities, (T, N, nv) m/s, rad/s."""
        return np.array([s.qvel for s in self.states])

    def show(self, topic: str) -> np.ndarray:
        """What a topic of SPEC 3 shows, in standard deviations of its sensor, (T, N, k)."""
        if topic == "/joint_states":
            return self.pose / 1e-3  # m, rad: an ordinary encoder
        sensors = self.twin.vehicle.sensors
        if topic == "/imu/data":
            return self.velocity[..., 2:] / sensors.imu.gyro_std
        if topic == "/mocap/pose":
            noise = np.array([sensors.mocap.position_std, sensors.mocap.position_std, sensors.mocap.angle_std])
            return self.delay(self.pose, self.twin.constant("mocap.delay")) / noise
        raise KeyError(f"no sensor model of {topic} in these tests: write one")

    def delay(self, pose: np.ndarray, delay: np.ndarray) -> np.ndarray:
        """Poses (T, N, nv) as they were `delay` (N,) s before."""
        time = CONTROL * np.arange(len(pose))
        rows = [
            [np.interp(time - late, time, pose[:, i, j]) for j in range(pose.shape[2])] for i, late in enumerate(delay)
        ]
        return np.moveaxis(np.array(rows), 2, 0)


def load_rigs(folder: Path) -> dict[str, Rig]:
    """All rigs by name; the cart's files are written to `folder`."""
    (folder / "cart_pendulum.xml").write_text(CART_PENDULUM)
    (folder / "cart.yaml").write_text(CART_TWIN)
    drone = load_twin()
    low, high = (-0.3, 1.2, -0.5, -0.8, -0.5, -2.0), (0.3, 1.6, 0.5, 0.8, 0.8, 2.0)
    cart = load_twin(folder / "cart.yaml")
    return {
        "flown": Rig("flown", drone, low, high, (2.0, 3.0), (6.0, 0.0)),
        "replayed": Rig("replayed", drone, low, high, (0.02, 0.02), (0.12, 0.12)),
        "cart": Rig("cart", cart, (-1, -1.5, -0.8, -3.0), (1, 1.5, 0.8, 3.0), (1.0,), (0.0,)),
    }


def enlarge(parameter: Parameter, times: float = 5.0) -> float:
    """A large value: so many sizes above the off value, or below it, within the bounds."""
    up = parameter.off + times * parameter.size
    return up if up <= parameter.high else float(parameter.clip(np.array(parameter.off - times * parameter.size)))


def switch_on(rig: Rig, num_sims: int, effect_id: str, times: float | np.ndarray = 5.0) -> Twin:
    """A twin with an effect at a large value, `times` its size, possibly another in every simulation."""
    twin = Twin(rig.spec, num_sims, active=[effect_id], num_threads=1)
    for p in rig.effect(effect_id).parameters:
        values = np.array([enlarge(p, t) for t in np.broadcast_to(times, num_sims)])
        twin.set_parameter(effect_id, p.name, values)
    return twin
