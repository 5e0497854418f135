"""A policy as a pilot: flies its task's targets on estimates, and its log is read like any other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vpptwin.cli import main
from vpptwin.errors import InputError
from vpptwin.logs.read import read_flight
from vpptwin.train.pilot import PolicyPilot, load_pilot
from vpptwin.train.tasks import Target, Task
from vpptwin.twin import load_twin
from vpptwin.vehicle import Vehicle


def drone() -> Vehicle:
    """The nominal vehicle."""
    vehicle = load_twin().vehicle
    assert vehicle is not None
    return vehicle


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
    pilot, again = (load_pilot(tiny_run, None, drone(), 6.0, 3) for _ in range(2))
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
    hover = load_pilot(tiny_run, None, drone(), None, 0)
    task = Task("turns", target=Target(angles=[0.0, np.pi], dwell=(1.0, 1.5)))
    turns = PolicyPilot(hover.policy, hover.trained, task, drone(), 6.0, 1)
    target = np.concatenate([turns.target(tick) for tick in range(turns.ticks)])
    changes = np.flatnonzero(np.diff(target[:, 2]))
    assert len(changes) >= 3
    assert (np.diff(changes) >= 99).all()
    assert (np.diff(changes) <= 151).all()
    assert (target[:, :2] == target[0, :2]).all()


def test_durations_and_tasks_that_cannot_be_flown_are_refused(tiny_run: Path) -> None:
    """Too short, too long, unknown."""
    for duration in (1.0, 1e6):
        with pytest.raises(InputError, match="a flight of"):
            load_pilot(tiny_run, None, drone(), duration, 0)
    with pytest.raises(InputError, match="unknown task 'waltz'"):
        load_pilot(tiny_run, "waltz", drone(), None, 0)
