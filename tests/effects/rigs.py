"""Rigs that the properties of every effect are tested on: the drone, flown and replayed, and a cart with a pendulum."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.twin.hover import share_kernel
from vpptwin.actuators.motor import compute_current
from vpptwin.effects import CATALOGUE, Effect, Link, Parameter, effects_for_rig, find_effect, generic_place
from vpptwin.effects.actuator import SAG
from vpptwin.effects.contact import effects_for_contacts
from vpptwin.effects.joint import JOINT_SHOWS
from vpptwin.twin import Twin, TwinSpec, TwinState, load_twin
from vpptwin.twin.sensors import age_of_pose, measure_pose, measure_rate

CONTROL = 0.01
"""Commands are held, and tracks sampled, for this long [s]."""
START = 5.0
"""Flights start this long after the log did [s], so that what drifts has drifted."""

CART_PENDULUM = """<mujoco model="cart_pendulum">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="Euler"/>
  <worldbody>
    <geom name="wall" type="box" pos="4.1 0 0" size="0.02 1 2" conaffinity="0"/>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="0.8" diaginertia="1e-3 1e-3 1e-3"/>
      <geom type="sphere" size="0.1" contype="0"/>
      <body name="pole">
        <joint name="swing" type="hinge" axis="0 -1 0"/>
        <inertial pos="0 0 -0.3" mass="0.2" diaginertia="2e-3 2e-3 1e-5"/>
        <geom type="sphere" pos="0 0 -0.6" size="0.02" contype="0"/>
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

CART_EFFECTS = effects_for_rig(
    [generic_place("slide", False, 1.0, room=1.0, driven=True), generic_place("swing", True, 1.0, room=1.0, dof=1)],
    {"motor": 1.0}, loops={"motor": (SAG,)}, mounted=True,
    links=[Link("pole", 0.2, (0.0, 0.0, -0.6), 0.3, ways="xz", lever=0.1, hinge="swing")],
    contacts=effects_for_contacts(JOINT_SHOWS, [(0.02, 1.0)], 0.001),
)  # fmt: skip
EFFECTS = {"flown": CATALOGUE, "replayed": CATALOGUE, "cart": CART_EFFECTS}
"""What each rig can have, as known before it is loaded."""


@dataclass(frozen=True)
class Rig:
    """A rig, how it is driven, and where its rollouts start.

    Attributes:
        name: `flown` (drone under policy commands), `replayed` (drone under blade pitches) or `cart`.
        spec: no effect switched on.
        low, high: corners of the box that starts are drawn from, positions before velocities, (2 nv,) m, rad, m/s, ...
        near_low, near_high: the same of a box near a wall, moving onto it and along it.
        drives: standard deviation of a random command, (nu,).
        trim: its mean.
        hold: for how many intervals of 10 ms a command stands.
        throttled: whether a replay simulates the rotors, from a throttle, instead of taking their speeds as they are.
    """

    name: str
    spec: TwinSpec
    low: tuple[float, ...]
    high: tuple[float, ...]
    near_low: tuple[float, ...]
    near_high: tuple[float, ...]
    drives: tuple[float, ...]
    trim: tuple[float, ...]
    hold: int = 1
    throttled: bool = False

    @property
    def drone(self) -> bool:
        """Whether it is ours."""
        return self.spec.robot.step == "step_drone"

    def effect(self, effect_id: str) -> Effect:
        """The effect as this rig has it, off values bound to the vehicle."""
        return find_effect(self.spec.catalogue, effect_id)

    def for_effect(self, effect_id: str) -> Rig:
        """The rig driven so that the effect can be seen: where it acts where bodies touch, from near a wall onto it."""
        effect = self.effect(effect_id)
        if effect.touching:
            calm = tuple(0.25 * drive for drive in self.drives)
            return replace(self, low=self.near_low, high=self.near_high, drives=calm)
        return replace(self, throttled="/rotor/state" in effect.shows)

    def twin(self, num_sims: int, values: Mapping[str, Mapping[str, np.ndarray | float]] | None = None) -> Twin:
        """A twin with some effects switched on, parameters at off where no value is given."""
        with share_kernel() if self.name != "flown" else nullcontext():
            twin = Twin(self.spec, num_sims, active=values or (), num_threads=1)
        for effect_id, given in (values or {}).items():
            for name, value in given.items():
                twin.set_parameter(effect_id, name, value)
        return twin

    def start(self, twin: Twin, seed: int, total: int | None = None, first: int = 0) -> TwinState:
        """A random state: rows `first` onwards of a batch of `total`."""
        rng = np.random.default_rng(seed)
        box = rng.uniform(self.low, self.high, (total or twin.num_sims, len(self.low)))
        qpos, qvel = np.split(box[first : first + twin.num_sims], 2, axis=1)
        return twin.initial_state(qpos=twin.pose_for_engine(qpos, qvel), qvel=qvel, time=START)

    def command(self, k: int) -> np.ndarray:
        """The command at interval k of a random sequence, the same for every simulation, (nu,)."""
        draw = np.random.default_rng([7, k // self.hold]).normal(size=len(self.trim))
        return np.array(self.trim) + np.array(self.drives) * draw

    def advance(
        self, twin: Twin, state: TwinState, k: int, powered: bool = True, duration: float = CONTROL
    ) -> TwinState:
        """The state 10 ms (or `duration`) later under the k-th command, or with rotors and motors off."""
        command = self.command(k) * powered
        if self.name == "flown":
            return twin.step_policy(state, np.tile(command, (twin.num_sims, 1)), duration)
        held = np.tile(command, (twin.num_sims, round(duration / twin.dt), 1))
        throttle = np.full(held.shape, 0.45 + 0.1 * (-1) ** k) if self.throttled else None
        return twin.replay_commands(state, held, throttle=throttle)[0]

    def roll(self, twin: Twin, state: TwinState, first: int = 0, count: int = 12, powered: bool = True) -> Track:
        """States every 10 ms, the start included."""
        states = [state]
        for k in range(first, first + count):
            states.append(self.advance(twin, states[-1], k, powered))
        return Track(twin, states)

    def with_step(self, dt: float) -> Rig:
        """The same rig simulated with another inner step [s]."""
        model = copy.copy(self.spec.model)
        model.opt.timestep = dt
        return replace(self, spec=self.spec.with_robot(model=model))


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
        """What a topic shows, in standard deviations of its sensor, (T, N, k)."""
        if topic == "/joint_states":  # m, rad, m/s, rad/s: an ordinary encoder
            rate = [measure_rate(self.twin.constants, v, np.arange(v.shape[1])) for v in self.velocity]
            return np.concatenate([self.pose / 1e-3, np.array(rate) / 1e-2], axis=2)
        sensors, constants = self.twin.vehicle.sensors, self.twin.constants
        if topic == "/imu/data":
            return np.array([measure_rate(constants, v[:, 2]) for v in self.velocity])[..., None] / sensors.imu.gyro_std
        if topic == "/mocap/pose":
            noise = np.array([sensors.mocap.position_std, sensors.mocap.position_std, sensors.mocap.angle_std])
            age = np.array([age_of_pose(constants, s.time) for s in self.states])
            return np.array([measure_pose(constants, pose) for pose in self.look_back(age)]) / noise
        if topic == "/rotor/state":
            noise = np.array([sensors.rotor.speed_std] * 2 + [sensors.rotor.current_std] * 2)
            return np.array([np.concatenate([s.rotor_speed, self.current(s)], axis=1) for s in self.states]) / noise
        raise KeyError(f"no sensor model of {topic} in these tests: write one")

    def current(self, state: TwinState) -> np.ndarray:
        """Of the motors, (N, 2) A."""
        motor = self.twin.vehicle.motor
        left = 1.0 - self.twin.constants["battery.sag"] * state.time
        return compute_current(motor, state.throttle * motor.battery * left[:, None], state.rotor_speed)

    def look_back(self, age: np.ndarray) -> np.ndarray:
        """Poses as they were `age` (T, N) s before, straight between samples, (T, N, nv)."""
        pose, index = self.pose, np.arange(len(self.states))
        shown = np.empty_like(pose)
        for i, j in np.ndindex(pose.shape[1:]):
            shown[:, i, j] = np.interp(index - age[:, i] / CONTROL, index, pose[:, i, j])
        return shown


def load_rigs(folder: Path) -> dict[str, Rig]:
    """All rigs by name; the cart's files are written to `folder`."""
    (folder / "cart_pendulum.xml").write_text(CART_PENDULUM)
    (folder / "cart.yaml").write_text(CART_TWIN)
    drone = load_twin()
    low, high = (-0.3, 1.2, -0.5, -0.8, -0.5, -2.0), (0.3, 1.6, 0.5, 0.8, 0.8, 2.0)
    # Level it touches the wall at 1.485 m.
    near = (1.482, 1.2, -0.1, 0.02, -0.1, -0.1), (1.484, 1.6, 0.1, 0.04, 0.1, 0.1)
    bumper = (3.974, -0.1, 0.1, -0.2), (3.978, 0.1, 0.2, 0.2)  # the cart's at 3.98 m
    cart = load_twin(folder / "cart.yaml")
    return {
        "flown": Rig("flown", drone, low, high, *near, (4.0, 6.0), (4.0, 0.0)),
        "replayed": Rig("replayed", drone, low, high, *near, (0.08, 0.08), (0.06, 0.06)),
        "cart": Rig("cart", cart, (-1, -1.5, -0.8, -3.0), (1, 1.5, 0.8, 3.0), *bumper, (1.0,), (0.0,), hold=3),
    }


Values = dict[str, dict[str, np.ndarray]]


def enlarge(parameter: Parameter, times: float = 5.0) -> float:
    """A large value: so many sizes above the off value, or below it, within the bounds."""
    up = parameter.off + times * parameter.size
    return up if up <= parameter.high else float(parameter.clip(np.array(parameter.off - times * parameter.size)))


def large_values(rig: Rig, effect_id: str, times: float | np.ndarray = 5.0) -> Values:
    """An effect's parameters, `times` their size from off: one for all simulations, or one for each."""
    parameters = rig.effect(effect_id).parameters
    return {effect_id: {p.name: np.array([enlarge(p, t) for t in np.atleast_1d(times)]).squeeze() for p in parameters}}


def off_values(rig: Rig, effect_id: str) -> Values:
    """An effect's parameters at their off values."""
    return {effect_id: {p.name: np.array(p.off) for p in rig.effect(effect_id).parameters}}


def companions(rig: Rig, effect_id: str) -> Values:
    """The effects that this one modifies, at large values: without them it does nothing."""
    return {
        name: values for other in rig.effect(effect_id).modifies for name, values in large_values(rig, other).items()
    }


def bare(rig: Rig, num_sims: int, effect_id: str) -> Twin:
    """A twin without the effect."""
    return rig.twin(num_sims, companions(rig, effect_id))


def switch_off(rig: Rig, num_sims: int, effect_id: str) -> Twin:
    """A twin with the effect at its off value."""
    return rig.twin(num_sims, companions(rig, effect_id) | off_values(rig, effect_id))


def switch_on(rig: Rig, num_sims: int, effect_id: str, times: float | np.ndarray = 5.0) -> Twin:
    """A twin with an effect at a large value, `times` its size, possibly another in every simulation."""
    return rig.twin(num_sims, companions(rig, effect_id) | large_values(rig, effect_id, times))
