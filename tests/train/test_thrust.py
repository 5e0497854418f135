"""The thrust-to-weight ratio of a task: what is commanded, and what the simulation makes of it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.train.conftest import step, tiny_env
from vpptwin.report.twin_file import name_twin
from vpptwin.system.resources import models_dir
from vpptwin.train.env.rotors import strengthen
from vpptwin.train.env.vpp_env import VppEnv
from vpptwin.twin import load_twin

WEIGHT = 0.5 * 9.81
"""Of craft (0.450 kg) and slider (0.050 kg), N."""
LEVEL = ("task.start.theta=[0,0]", "task.start.rate=[0,0]", "task.start.velocity_z=[0,0]", "task.start.z=[1,1]")


def ratio_of(env: VppEnv) -> float:
    """Largest commanded thrust over the weight."""
    return env.twin.vehicle.control.thrust_max / WEIGHT


def climb(env: VppEnv, thrust: float) -> float:
    """Vertical acceleration under a normalized thrust, between 0.1 s after its start and 0.2 s, m/s²."""
    env.reset()
    for k in range(20):
        if k == 10:
            before = env.state.qvel[:, 1].copy()
        step(env, torch.tensor([thrust, 0.0]))
    return float(((env.state.qvel[:, 1] - before) / 0.1).mean())


@pytest.mark.parametrize("ratio", [1.5, 2.5, 4.0])
def test_commanded_maximum_over_weight(ratio: float) -> None:
    """The largest command is the ratio times the weight, and so is what both blades give at their largest pitch."""
    nominal, vehicle = load_twin().vehicle, strengthen(load_twin(), ratio).vehicle
    assert nominal is not None
    assert vehicle is not None
    assert vehicle.control.thrust_max == pytest.approx(ratio * WEIGHT)
    rotor = vehicle.rotor
    full = 2.0 * rotor.k_t * rotor.speed * rotor.pitch_max
    # The nominal rotors give 9.995 N of the 10 N that may be commanded.
    assert full == pytest.approx(ratio * WEIGHT, rel=1e-3)
    assert vehicle.airframe == nominal.airframe
    assert vehicle.rig == nominal.rig


def test_tasks_set_it() -> None:
    """Hover and flip fly the vehicle as it is, wall-backtrack with 2.5, an override with what it says."""
    assert strengthen(load_twin(), None).vehicle == load_twin().vehicle
    for task, expected in (("hover", 10.0 / WEIGHT), ("flip", 10.0 / WEIGHT), ("wall-backtrack", 2.5)):
        assert ratio_of(tiny_env(f"task={task}")) == pytest.approx(expected)
    assert ratio_of(tiny_env("task.thrust_to_weight=3")) == pytest.approx(3.0)


@pytest.mark.parametrize("ratio", [1.6, 2.5, 3.2])
def test_the_same_action_climbs_faster(ratio: float) -> None:
    """Half of the largest command accelerates by (ratio/2 - 1) g: down at 1.6, up at 2.5 and 3.2."""
    measured = climb(tiny_env(f"task.thrust_to_weight={ratio}", *LEVEL), 0.5)
    # The governed rotors sag by some rad/s of 471 under the load: within 2 % of the thrust.
    assert measured == pytest.approx((0.5 * ratio - 1.0) * 9.81, abs=0.02 * 0.5 * ratio * 9.81)


def test_hovering_takes_the_inverse_of_the_ratio() -> None:
    """A normalized thrust of 1/2.5 carries the craft of wall-backtrack, one of 1/2.04 that of hover."""
    for task in ("wall-backtrack", "hover"):
        env = tiny_env(f"task={task}", *LEVEL)
        assert climb(env, 1.0 / ratio_of(env)) == pytest.approx(0.0, abs=0.02 * 9.81)


def test_observation_and_weight_stay() -> None:
    """Stronger rotors change neither what is seen at the start nor how a craft falls without thrust."""
    plain, strong = tiny_env(*LEVEL), tiny_env(*LEVEL, "task.thrust_to_weight=3")
    assert torch.equal(plain.reset()["observation"], strong.reset()["observation"])
    np.testing.assert_allclose(climb(plain, 0.0), climb(strong, 0.0), rtol=1e-3)
    assert climb(strong, 0.0) == pytest.approx(-9.81, rel=1e-3)


def test_weaker_rotors_than_trained_saturate() -> None:
    """Thrust is commanded as with the rotors of training, newton for newton, up to what the others can give."""
    trained = tiny_env("task.thrust_to_weight=2.5", *LEVEL)
    weaker = tiny_env("task.thrust_to_weight=1.5", "task.commanded=2.5", *LEVEL)
    assert ratio_of(weaker) == pytest.approx(2.5)
    assert climb(weaker, 0.45) == pytest.approx(climb(trained, 0.45), abs=0.02 * 9.81)  # 1.125 of the weight
    assert climb(weaker, 1.0) == pytest.approx(0.5 * 9.81, abs=0.05 * 9.81)


def test_a_twin_of_strong_rotors() -> None:
    """`strong` has the rotors that wall-backtrack is trained with, and stays as it is when the task asks for them."""
    spec = load_twin("strong")
    assert spec.vehicle == strengthen(load_twin(), 2.5).vehicle
    assert strengthen(spec, 2.5).vehicle.rotor.k_t == pytest.approx(spec.vehicle.rotor.k_t, rel=1e-12)
    assert name_twin(spec, models_dir())["thrust_to_weight"] == 2.5


def test_every_drawn_craft_can_be_vertical_in_time() -> None:
    """As docs/train.md says: within 15° after 0.18 s if it rolls at once, after 0.40 s if it first climbs for 0.2 s."""
    for climb_for, most in ((0.0, 0.18), (0.2, 0.40)):
        env = tiny_env("task=wall-backtrack", *LEVEL, "num_envs=64", "randomize=[paper]")
        env.reset()
        for k in range(round(most / 0.01)):
            step(env, torch.tensor([1.0, 0.0] if k < round(climb_for / 0.01) else [0.15, 1.0]))
        assert (env.state.qpos[:, 2] > np.radians(75.0)).all()
