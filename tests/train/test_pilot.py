"""A policy as a pilot: flies its task's targets on estimates, and its log is read like any other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from vpptwin.cli.main import main
from vpptwin.logs.read import read_flight
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.errors import InputError
from vpptwin.train.env.observe import observe
from vpptwin.train.env.tasks import WALL_BACKTRACK, Target, Task
from vpptwin.train.evaluate.evaluate import load_policy
from vpptwin.train.evaluate.pilot import PolicyPilot, load_pilot, plan_targets
from vpptwin.train.learn.actor import Actor
from vpptwin.train.learn.checkpoint import make_policy
from vpptwin.twin import load_twin


def drone() -> Vehicle:
    """The nominal vehicle."""
    vehicle = load_twin().vehicle
    assert vehicle is not None
    return vehicle


def hire(run: Path, task: str | None = None, duration: float | None = 6.0, seed: int = 3) -> PolicyPilot:
    """The pilot of a run in the nominal twin."""
    return load_pilot(run, task, load_twin(), duration, seed)[0]


def test_a_policy_flies(tiny_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A checkpoint in place of a manoeuvre; its log has all topics, and its targets are the task's."""
    out = tmp_path / "policy.mcap"
    assert main(["fly", str(tiny_run), "--task", "hover", "--gusts", "--out", str(out)]) == 0
    assert f"log: {out}" in capsys.readouterr().out
    flight = read_flight(out)
    assert {"/mocap/pose", "/imu/data", "/rotor/command", "/rotor/state"} <= set(flight.streams)
    assert abs(float(flight.streams["/setpoint/pose"]["x"][0])) <= 0.4


def test_commands_are_the_policys_actions_in_si(tiny_run: Path) -> None:
    """Within the vehicle's limits, the integral of the error remembered; the same for the same seed."""
    pilot, again = (load_pilot(tiny_run, None, load_twin(), 6.0, 3)[0] for _ in range(2))
    assert pilot.ticks == 600
    pose, memory = np.array([[0.1, 1.2, 0.0]]), np.zeros((1, 2))
    command, memory = pilot.command(0, pose, np.zeros((1, 3)), memory)
    assert (np.abs(command) <= [drone().control.thrust_max, drone().control.rate_max]).all()
    np.testing.assert_allclose(memory, (pilot.target(0) - pose)[:, :2])
    _, memory = pilot.command(1, pose, np.zeros((1, 3)), memory)
    np.testing.assert_allclose(memory, 1.9 * (pilot.target(0) - pose)[:, :2])
    np.testing.assert_array_equal(pilot.target(5), again.target(5))
    np.testing.assert_array_equal(command, again.command(0, pose, np.zeros((1, 3)), np.zeros((1, 2)))[0])


def test_targets_change_as_the_task_says(tiny_run: Path) -> None:
    """A task that switches between upright and inverted does so while its place stays."""
    hover, _ = load_pilot(tiny_run, None, load_twin(), None, 0)
    task = Task("turns", target=Target(angles=[0.0, np.pi], dwell=(1.0, 1.5), quiet=0.0))
    turns = PolicyPilot(hover.policy, hover.trained, task, drone(), 6.0, 1)
    target = np.concatenate([turns.target(tick) for tick in range(turns.ticks)])
    changes = np.flatnonzero(np.diff(target[:, 2]))
    assert len(changes) >= 3
    assert (np.diff(changes) >= 99).all()
    assert (np.diff(changes) <= 151).all()
    assert (target[:, :2] == target[0, :2]).all()


def test_turns_are_planned_as_they_are_trained() -> None:
    """A full turn moves the planned angle by ±2π at its rate, step by step; in between the angle stands still."""
    task = Task("turns", target=Target(angles=[0.0, np.pi], dwell=(1.0, 1.5), turns=1.0, turn_rate=10.0, quiet=1.0))
    for seed in range(4):
        angle = plan_targets(task, 600, 0.01, np.random.default_rng(seed))[:, 0, 2]
        change = np.diff(angle)
        assert np.abs(change).max() <= 0.1 + 1e-12
        starts = np.flatnonzero((change[1:] != 0.0) & (change[:-1] == 0.0)) + 1
        ends = np.flatnonzero((change[1:] == 0.0) & (change[:-1] != 0.0)) + 1
        assert len(ends) >= 2
        for start, end in zip(starts, ends):
            assert abs(angle[end] - angle[start]) == pytest.approx(2.0 * np.pi, abs=1e-9)
            assert end - start == 63  # 2π / 0.1 rad, rounded up


def test_the_end_of_a_plan_is_quiet() -> None:
    """No trigger comes in the last 2 s, however long the flight."""
    task = Task("turns", target=Target(angles=[0.0, np.pi], dwell=(0.2, 0.4), quiet=2.0))
    for ticks in (500, 900):
        angle = plan_targets(task, ticks, 0.01, np.random.default_rng(0))[:, 0, 2]
        changes = np.flatnonzero(np.diff(angle)) + 1
        assert ticks - 200 - 41 <= changes[-1] < ticks - 200
        assert (np.diff(changes) <= 41).all()


def test_a_pilot_gets_the_rotors_that_its_task_wants(tiny_run: Path) -> None:
    """For wall-backtrack the twin and what is believed of it have a thrust-to-weight of 2.5; for hover it stays."""
    pilot, spec = load_pilot(tiny_run, "wall-backtrack", load_twin(), 6.0, 3)
    assert spec.vehicle.control.thrust_max == pytest.approx(2.5 * 0.5 * 9.81)
    pose, still, blank = np.array([[1.0, 1.2, 0.0]]), np.zeros((1, 3)), np.zeros((1, 2))
    command, integral = pilot.command(0, pose, still, blank)
    seen = observe(pose, still, pilot.target(0), integral, pilot.trained.observation)
    action = load_policy(tiny_run)(torch.from_numpy(seen)).detach().numpy()
    np.testing.assert_allclose(command, action * [12.2625, 12.0], rtol=1e-6)  # N and rad/s
    assert load_pilot(tiny_run, None, load_twin(), 6.0, 3)[1].vehicle == drone()


def test_angles_in_order_are_planned_once() -> None:
    """Wall-backtrack goes up after 1 to 2 s, comes down after another 0.4 to 0.7 s, and that is all, however long."""
    ways = set()
    for seed in range(20):
        angle = plan_targets(WALL_BACKTRACK, 1200, 0.01, np.random.default_rng(seed))[:, 0, 2]
        up, down = np.flatnonzero(np.diff(angle)) + 1
        assert (angle[0], angle[up], angle[-1]) == (0.0, 0.5 * np.pi, 0.0)
        assert 100 <= up <= 201
        assert 39 <= down - up <= 71
        ways.add((int(up), int(down)))
    assert len(ways) > 15


def test_a_pilot_sees_the_setup_it_was_trained_on(tiny_run: Path) -> None:
    """Its observation is that of the setup of training: a policy of six inputs gets those six."""
    hover, _ = load_pilot(tiny_run, None, load_twin(), 6.0, 3)
    trained = replace(hover.trained, setup="VA", paper_inputs=True)
    policy = Actor(make_policy(trained).state_dict())
    pilot = PolicyPilot(policy, trained, trained.task, drone(), 6.0, 3)
    pose, velocity = np.array([[0.1, 1.2, 0.7]]), np.array([[0.2, -0.1, 1.0]])
    command, integral = pilot.command(0, pose, velocity, np.zeros((1, 2)))
    seen = observe(pose, velocity, pilot.target(0), integral, trained.observation)
    assert seen.shape == (1, 6)
    expected = policy(seen) * [10.0, 12.0]  # N and rad/s
    np.testing.assert_allclose(command, expected, rtol=1e-6)


def test_durations_and_tasks_that_cannot_be_flown_are_refused(tiny_run: Path) -> None:
    """Too short, too long, unknown."""
    for duration in (1.0, 1e6):
        with pytest.raises(InputError, match="a flight of"):
            load_pilot(tiny_run, None, load_twin(), duration, 0)
    with pytest.raises(InputError, match="unknown task 'waltz'"):
        load_pilot(tiny_run, "waltz", load_twin(), None, 0)
