"""A policy at the controls of the independent simulation: what it sees, what it commands, what is asked and judged."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from proving.drone import EFFECTS, fly_policy
from proving.drone.control import PITCH_LSB, Firmware
from proving.drone.flight import FlightPlan
from proving.drone.policy import PolicyPilot, observe
from proving.drone.rig import load_nominal
from proving.firmware import VpptwinFirmware
from proving.policy_flights import (
    CENTRAL,
    PERIOD,
    Sky,
    assign,
    draw_targets,
    judge,
    load_flyer,
    measure,
    read_drone,
    summarise,
)
from vpptwin.train.env import observe as trained
from vpptwin.train.env.randomize import PAPER_EFFECTS
from vpptwin.train.env.tasks import FLIP

CATALOGUE, VEHICLE = read_drone()


def steer(observation: np.ndarray) -> np.ndarray:
    """Position, angle and rate loops that read nothing but the observation, upright or inverted.

    The force that the errors ask for is taken along the target's body z; tilting towards it is left to the angle loop.
    """
    dx, dz, vx, vz, sine, cosine, rate, *_, target_sine, target_cosine = observation.astype(float).T
    control, weight = load_nominal()["control"], 0.5 * 9.81
    upright = np.sign(target_cosine)
    wanted = -np.clip((0.58 * (6.0 * dx - 4.0 * vx)) / weight, -0.5, 0.5)  # of the thrust's direction, from up, rad
    left = np.arctan2(sine, cosine) + wanted
    theta = np.arctan2(target_sine, target_cosine) - np.arctan2(sine, cosine)
    thrust = upright * (weight + 0.5 * (10.0 * dz - 5.0 * vz)) * (np.cos(theta) * upright > 0.3)
    turn = np.clip(8.0 * left - 0.1 * rate, -10.0, 10.0)
    return np.stack([thrust / control["thrust_max"], turn / control["rate_max"]], axis=1)


def plan(seed: int, **others: object) -> FlightPlan:
    """A calm flight of a nominal rig."""
    calm = {"gusts": False, "jitter": False, "dropouts": False}
    return {"effects": {}, "manoeuvre": "policy", "seed": seed, **calm, **others}  # type: ignore[typeddict-item]


def test_both_observations_are_equal() -> None:
    """Written twice: the twin's and reality's observation agree in every column and in the integral."""
    rng = np.random.default_rng(0)
    pose, velocity, target = (rng.uniform(-4.0, 4.0, (50, 3)) for _ in range(3))
    integral, error = rng.standard_normal((50, 2)), (target - pose)[:, :2]
    ours = observe(pose.T, velocity.T[:2], velocity.T[2], target.T, integral.T)
    assert ours.dtype == np.float32
    np.testing.assert_array_equal(ours, trained.observe(pose, velocity, target, integral))

    seen = []
    pilot = PolicyPilot(lambda observation: seen.append(observation) or np.zeros((50, 2)), target.T[None])
    memory = np.zeros((50, 2))
    for tick in range(3):
        pilot.command(tick, pose.T, velocity.T[:2], velocity.T[2])
        memory = trained.accumulate_error(memory, error)
        np.testing.assert_array_equal(seen[-1], trained.observe(pose, velocity, target, memory))


def test_actions_are_scaled_with_the_nominal_limits() -> None:
    """Full action is vehicle.yaml's largest thrust and rate, and beyond it there is no more."""
    still = np.zeros((3, 2))
    pilot = PolicyPilot(lambda _: np.array([[1.0, -1.0], [0.5, 3.0]]), np.zeros((1, 3, 2)))
    thrust, rate = pilot.command(0, still, still[:2], still[2])
    np.testing.assert_allclose(thrust, [10.0, 5.0])
    np.testing.assert_allclose(rate, [-12.0, 12.0])
    with pytest.raises(ValueError, match=r"gives actions \(2,\), expected \(2, 2\)"):
        PolicyPilot(lambda _: np.zeros(2), np.zeros((1, 3, 2))).command(0, still, still[:2], still[2])


def test_a_policy_flies_either_way_up() -> None:
    """Loops that see only the observation hold upright and inverted targets within 2 cm, and the log has it all."""
    targets = np.array([[0.2, 1.3, 0.0], [-0.2, 1.2, math.pi]])[:, None].repeat(401, axis=1)
    initial = [[0.0, 1.2, 0.3, 0.5, 0.0, 1.0], [0.0, 1.3, math.pi - 0.3, 0.0, 0.5, -1.0]]
    flights = fly_policy(steer, targets, [plan(i, duration=4.0, initial=initial[i]) for i in range(2)])
    for flight, target in zip(flights, targets):
        np.testing.assert_allclose(flight.truth["position"][-500:], target[:1].repeat(500, 0), atol=0.02)
        assert len(flight.topics["/cmd/rate_thrust"].time) == 401
        assert flight.topics["/setpoint/pose"].columns["z"][0] == target[0, 1]
    np.testing.assert_array_equal([f.truth["position"][0] for f in flights], [state[:3] for state in initial])


def test_estimates_follow_a_flip() -> None:
    """Through a whole turn at 12 rad/s, dropouts and gyro noise included, what the policy sees stays near the truth."""
    seen: list[np.ndarray] = []

    def spin(observation: np.ndarray) -> np.ndarray:
        seen.append(observation)
        return np.column_stack([np.full(8, 0.5), np.ones(8)])

    starts = [plan(i, duration=0.6, dropouts=True, jitter=True, initial=[0, 2, 0, 0, 2, 12.0]) for i in range(8)]
    target = np.zeros((8, 61, 3))
    flights = fly_policy(spin, target, starts)
    truth = np.stack([f.truth["position"][::10] for f in flights], axis=1)
    speed = np.stack([f.truth["velocity"][::10] for f in flights], axis=1)
    assert (truth[-1, :, 2] > 2 * math.pi).all()
    observed = np.stack(seen)
    angle = np.arctan2(-observed[..., 4], observed[..., 5])
    off = np.abs(trained.wrap_angle(angle - truth[..., 2]))
    assert off.max() < 0.05  # gyro, 0.02 rad/s at 1 kHz, hardly counts; mocap 0.003 rad; 12 rad/s times 4 ms
    assert np.abs(-observed[..., :2] - truth[..., :2]).max() < 0.01
    assert np.abs(observed[..., 2:4] - speed[..., :2]).max() < 0.1


def test_targets_are_as_training_asks() -> None:
    """Upright or inverted, dwells within the task's, whole turns at its rate, and quiet at the end."""
    drawn = [draw_targets(FLIP, np.random.default_rng(i)) for i in range(60)]
    dwells, turns = [], 0
    for targets, turn in drawn:
        assert targets.shape == (601, 3)
        assert (targets[:, :2] == targets[0, :2]).all()
        jumps = np.flatnonzero((np.abs(np.diff(targets[:, 2])) > 1.0) | ((turn[1:] != 0.0) & (turn[:-1] == 0.0))) + 1
        dwells += list(np.diff(np.append(0, jumps)) * PERIOD)
        assert (jumps <= 401).all()
        assert turn[-1] == 0.0
        rates = np.abs(np.diff(targets[:, 2]))[turn[:-1] != 0.0] / PERIOD
        assert (rates <= FLIP.target.turn_rate + 1e-9).all()
        turns += int(((turn[1:] != 0.0) & (turn[:-1] == 0.0)).sum())
    assert min(dwells) > 0.79
    assert max(dwells) < 3.02
    assert 0.05 < turns / len(dwells) < 0.4  # the task's share is 0.2


def test_what_is_hidden_is_what_training_draws() -> None:
    """Every effect of the paper's randomization is there, inside the centre of its prior; flights differ."""
    flights = [assign(FLIP, Sky(), number, 3, CATALOGUE) for number in range(40)]
    assert all(tuple(flight.plan["effects"]) == PAPER_EFFECTS for flight in flights)
    assert set(PAPER_EFFECTS) <= set(EFFECTS)
    for effect in PAPER_EFFECTS:
        for p in CATALOGUE[effect].parameters:
            values = np.array([flight.plan["effects"][effect][p.name] for flight in flights])
            assert np.abs(values - p.prior.a).max() <= CENTRAL * p.prior.b + 1e-12
            assert np.std(values) > 0.3 * p.prior.b
    again = assign(FLIP, Sky(), 7, 3, CATALOGUE)
    assert again.plan == flights[7].plan
    np.testing.assert_array_equal(again.targets, flights[7].targets)


def test_flights_are_judged_by_the_task() -> None:
    """A craft that stays put succeeds; one that falls has failed, and one that is far off has neither."""
    task = replace(FLIP, episode=1.5)
    placed = assign(task, Sky(effects=()), 0, 0, CATALOGUE)
    targets = np.array([0.0, 1.2, math.pi]) + np.zeros((151, 3))
    (flight,) = fly_policy(steer, targets[None], [plan(0, duration=1.5, initial=[*targets[0], 0.0, 0.0, 0.0])])
    placed = replace(placed, targets=targets, turn=np.zeros(151))
    held = judge(placed, flight, task, VEHICLE)
    assert (held.failed, held.success, held.inverted, held.turns) == (False, True, True, (0, 0))
    far = judge(replace(placed, targets=targets + np.array([0.1, 0.0, 0.0])), flight, task, VEHICLE)
    assert (far.failed, far.success) == (False, False)
    assert far.position_error == pytest.approx(0.1, abs=0.02)
    (flight,) = fly_policy(
        lambda o: np.zeros((len(o), 2)), targets[None], [plan(0, duration=1.5, initial=[0, 1.2, 0, 0, 0, 0])]
    )
    fallen = judge(placed, flight, task, VEHICLE)
    assert (fallen.failed, fallen.success) == (True, False)
    result = summarise([held, far, fallen])
    assert (result["flights"], result["fail_rate"], result["success_share"]) == (
        3,
        pytest.approx(1 / 3),
        pytest.approx(1 / 3),
    )
    assert result["inverted_error_m"]["worst"] == far.position_error


def test_both_firmwares_allocate_alike() -> None:
    """Rate loop and allocation, written twice: blade pitches of both agree to a bit of the servo command."""
    rng, count = np.random.default_rng(0), 5
    theirs, ours = Firmware(load_nominal(), count), VpptwinFirmware(count, adaptive=False)
    for _ in range(20):
        thrust, rate = rng.uniform(-9.0, 9.0, count), rng.uniform(-12.0, 12.0, count)
        for _ in range(10):
            sensed = rng.normal(0.0, 3.0, count), rng.normal(471.0, 3.0, (2, count)), rng.uniform(1.0, 5.0, (2, count))
            pitch, wanted = (firmware.command(thrust, rate, *sensed)[0] for firmware in (ours, theirs))
            np.testing.assert_allclose(pitch, wanted, rtol=0.0, atol=PITCH_LSB)


@pytest.mark.slow
def test_the_adaptive_controller_flies_worn_actuators_better() -> None:
    """Play, trim and drag as on the thrust stand: the median error is four fifths of the map's or less."""
    policy, task = load_flyer("flip")
    outcomes = {
        controller: measure(policy, task, Sky(worn=True, gusts=False, controller=controller), 12, 5)
        for controller in ("map", "adaptive")
    }
    assert not any(o.failed for o in outcomes["adaptive"])
    errors = {name: np.median([o.position_error for o in each]) for name, each in outcomes.items()}
    assert errors["adaptive"] < 0.8 * errors["map"]
