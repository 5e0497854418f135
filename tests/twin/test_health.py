"""Simulations that diverge: found, taken down whole or not at all, and flown again bit-equal."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.twin.hover import assert_states
from vpptwin.system.errors import InputError
from vpptwin.train.env.randomize import Priors, randomize
from vpptwin.twin import Twin, TwinState, load_twin
from vpptwin.twin.health import (
    MAX_FAULTS,
    Fault,
    describe_replay,
    find_diverged,
    read_fault,
    replay_fault,
    save_faults,
    take_fault,
    write_fault,
)

SPEC = load_twin()
COUNT, BROKEN = 5, 2


def make_twin() -> Twin:
    """Five simulations with every effect drawn from its prior."""
    twin = Twin(SPEC, COUNT, active=[e.id for e in SPEC.catalogue], num_threads=1)
    randomize(twin, Priors.of(SPEC.catalogue), np.arange(COUNT), np.random.default_rng(3))
    return twin


def provoke(twin: Twin, way: str) -> tuple[TwinState, np.ndarray]:
    """A state in mid-flight and commands, of which one row will not survive the next step."""
    command = np.tile([5.0, 1.0], (COUNT, 1))
    state = twin.step_policy(twin.initial_state(np.array([0.0, 1.4, 0.1])), command, 0.05)
    if way == "command":
        command[BROKEN] = [np.nan, 0.0]
    elif way == "velocity":
        state.qvel[BROKEN, 2] = 1e180
    elif way == "fast":
        state.qvel[BROKEN, 2] = 1e6
    else:
        state.actuators["rotor_speed"][BROKEN] = np.inf
    return state, command


def fly_fault(way: str) -> tuple[Twin, Fault]:
    """A twin, and what broke one of its simulations."""
    twin = make_twin()
    state, command = provoke(twin, way)
    after = twin.step_policy(state, command)
    return twin, take_fault(twin, state, after, command, 0.01, BROKEN)


WAYS = ("command", "velocity", "fast", "rotor")


@pytest.mark.parametrize("way", WAYS)
def test_one_that_diverges_is_found_and_the_others_do_not_notice(way: str) -> None:
    """Its row alone is named, and every other row is bit-equal to a flight in which nothing broke."""
    twin = make_twin()
    state, command = provoke(twin, way)
    assert not find_diverged(twin.initial_state()).any()
    after = twin.step_policy(twin.step_policy(state, command), command)
    assert np.flatnonzero(find_diverged(after)).tolist() == [BROKEN]
    healthy = twin.step_policy(twin.initial_state(np.array([0.0, 1.4, 0.1])), np.tile([5.0, 1.0], (COUNT, 1)), 0.07)
    others = np.array([i for i in range(COUNT) if i != BROKEN])
    assert_states(after.take(others), healthy.take(others))


@pytest.mark.parametrize("way", WAYS)
def test_fault_is_replayed_bit_equal(way: str, tmp_path: Path) -> None:
    """From its file alone the one simulation is rebuilt, with its parameters, and breaks as it did.

    A command that is no number shows after one inner step of 1 ms: in the throttle, not yet behind the delay.
    """
    _, fault = fly_fault(way)
    write_fault(tmp_path / "fault.npz", fault)
    replay = replay_fault(tmp_path / "fault.npz")
    assert replay.equal
    assert find_diverged(replay.after).all()
    assert replay.first is not None
    assert 0.0 <= replay.first <= 0.01
    assert replay.fault.effects == fault.effects
    assert replay.fault.effects["airframe.mass"]["mass"] != 0.0
    assert "bit-equal" in describe_replay(replay)
    if way == "command":
        assert replay.first == 0.001
        assert "actuators.throttle" in replay.fields
        assert "actuators.horn" not in replay.fields


def test_healthy_step_replays_without_onset(tmp_path: Path) -> None:
    """A step in which nothing broke is replayed bit-equal too, and said never to diverge; a changed one is told."""
    twin, state = make_twin(), make_twin().initial_state()
    command = np.tile([5.0, 1.0], (COUNT, 1))
    fault = take_fault(twin, state, twin.step_policy(state, command), command, 0.01, 0)
    write_fault(tmp_path / "one.npz", fault)
    replay = replay_fault(tmp_path / "one.npz")
    assert (replay.equal, replay.first, replay.fields) == (True, None, ())
    fault.command[0] += 1e-9
    write_fault(tmp_path / "other.npz", fault)
    changed = replay_fault(tmp_path / "other.npz")
    assert not changed.equal
    assert "differs" in describe_replay(changed)


def test_only_the_first_faults_are_kept(tmp_path: Path) -> None:
    """Files are numbered as the faults are, and there are never more than the limit, nor any leftovers."""
    _, fault = fly_fault("command")
    save_faults(tmp_path / "faults", dict.fromkeys(range(1, 4), fault))
    save_faults(tmp_path / "faults", dict.fromkeys(range(4, MAX_FAULTS + 9), fault))
    names = sorted(path.name for path in (tmp_path / "faults").iterdir())
    assert names == [f"fault-{k:04d}.npz" for k in range(1, MAX_FAULTS + 1)]


def test_refused_write_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that fills up halfway leaves no partial file and is warned of; a folder that cannot be made likewise."""
    _, fault = fly_fault("command")

    def fill_up(path: Path, content: bytes) -> None:
        with path.open("wb") as file:
            file.write(content[:2])
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", fill_up)
        with pytest.warns(RuntimeWarning, match="fault 1 is not saved: .*No space"):
            save_faults(tmp_path / "faults", {1: fault})
    assert not list(tmp_path.glob("faults/*"))
    (tmp_path / "file").touch()
    with pytest.warns(RuntimeWarning, match="fault 2 is not saved"):
        save_faults(tmp_path / "file", {2: fault})


def test_files_that_are_no_fault(tmp_path: Path) -> None:
    """Missing, foreign, cut short, of another kind: one line each, and no pickle is ever loaded."""
    _, fault = fly_fault("command")
    write_fault(tmp_path / "whole.npz", fault)
    whole = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.npz").touch()
    np.savez(tmp_path / "other.npz", about=np.array('{"kind": "other", "format": 3}'))
    np.savez(tmp_path / "pickle.npz", about=np.array([{}], dtype=object))
    for name in ("missing.npz", "half.npz", "empty.npz", "other.npz", "pickle.npz"):
        with pytest.raises(InputError, match=name) as caught:
            read_fault(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_command_line(tmp_path: Path) -> None:
    """`python -m vpptwin.twin.health FILE` tells what broke, when and where; bad input is one line."""
    _, fault = fly_fault("velocity")
    write_fault(tmp_path / "fault.npz", fault)
    command = [sys.executable, "-m", "vpptwin.twin.health"]
    result = subprocess.run([*command, str(tmp_path / "fault.npz")], capture_output=True, text=True, check=True)
    assert "diverges  after" in result.stdout
    assert "bit-equal" in result.stdout
    refused = subprocess.run([*command, "nowhere.npz"], capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
