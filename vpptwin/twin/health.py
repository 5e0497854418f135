"""Simulations that diverge: finding them, taking down what broke them, and flying that again.

python -m vpptwin.twin.health runs/hover/faults/fault-0001.npz
"""

from __future__ import annotations

import io
import json
import sys
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from vpptwin.system.errors import InputError
from vpptwin.system.files import write_whole
from vpptwin.twin.spec import EffectValues, load_twin, locate_twin
from vpptwin.twin.state import TwinState
from vpptwin.twin.twin import Twin

FASTEST = 1e4
"""A joint faster than this [m/s, rad/s] has left physics, if its numbers are still finite."""
KIND, FORMAT = "vpptwin fault", 2
MAX_FAULTS = 20
"""Faults that are kept of a run; the first tell most."""
RECORDED = ("mujoco", "numba", "numpy")


def find_diverged(state: TwinState) -> np.ndarray:
    """Which simulations hold numbers that are not finite, or joints faster than `FASTEST`, (N,) bool."""
    return ~state.finite() | (np.abs(state.qvel) > FASTEST).any(axis=1)


@dataclass(frozen=True)
class Fault:
    """One simulation's step that ended in nonsense."""

    twin: str  # `nominal` or the path of a twin YAML
    effects: EffectValues  # every effect that was switched on, with its values
    command: np.ndarray  # of the policy, held during the step, (2,) N, rad/s
    duration: float  # of the step [s]
    before: TwinState  # state at its start, one row
    after: TwinState  # state at its end, one row
    about: Mapping[str, Any] = field(default_factory=dict)  # where it happened and with which versions


@dataclass(frozen=True)
class FaultReplay:
    """A fault flown again."""

    fault: Fault  # as it was taken down
    after: TwinState  # state at the end of the step, one row
    equal: bool  # whether it is bit-equal to the one taken down
    first: float | None  # when a number first was not finite or absurd, s after the start of the step; None if none was
    fields: tuple[str, ...]  # which arrays of the state held such numbers then


def take_fault(
    twin: Twin, before: TwinState, after: TwinState, command: np.ndarray, duration: float, row: int
) -> Fault:
    """What row `row` of a step from `before` to `after` under commands (N, 2) [N, rad/s] went through."""
    name = twin.spec.name
    effects = {
        effect.id: {p.name: float(twin.parameter(effect.id, p.name)[row]) for p in effect.parameters}
        for effect in twin.effects.values()
    }
    rows = np.array([row])
    return Fault(
        twin=locate_twin(name), effects=effects, command=command[row].copy(),
        duration=duration, before=before.take(rows), after=after.take(rows),
        about={"row": int(row), "versions": {package: version(package) for package in RECORDED}},
    )  # fmt: skip


def save_faults(folder: Path, faults: Mapping[int, Fault]) -> None:
    """Write faults by their number in a run, 1 the first, up to `MAX_FAULTS`; a disk that refuses is only warned of."""
    for number, fault in faults.items():
        if number > MAX_FAULTS:
            return
        try:
            write_fault(folder / f"fault-{number:04d}.npz", fault)
        except InputError as error:
            warnings.warn(f"fault {number} is not saved: {error}", RuntimeWarning, stacklevel=2)


def write_fault(path: Path, fault: Fault) -> None:
    """Write a fault as an npz of numbers and JSON text; the file appears whole or not at all."""
    about = {
        "kind": KIND, "format": FORMAT, "twin": fault.twin, "effects": fault.effects, "duration_s": fault.duration,
        **fault.about,
    }  # fmt: skip
    arrays: dict[str, Any] = {f"before.{name}": values for name, values in fault.before.arrays().items()}
    arrays |= {f"after.{name}": values for name, values in fault.after.arrays().items()}
    content = io.BytesIO()
    np.savez(content, about=np.array(json.dumps(about)), command=fault.command, **arrays)
    write_whole(path, content.getvalue())


def read_fault(path: Path | str) -> Fault:
    """A fault from its file.

    Raises:
        InputError: if there is none, it is damaged, or something else.
    """
    if not Path(path).is_file():
        raise InputError(f"no fault {path}", "a file of a run's folder faults", "check the path")
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {name: file[name] for name in file.files}
        about = json.loads(str(content["about"]))
        found, wanted = (about["kind"], about["format"]), (KIND, FORMAT)
        if found != wanted:
            raise InputError(f"{path}: {found[0]}, format {found[1]}", f"{KIND}, format {FORMAT}", "use that version")
        known = {key: about.pop(key) for key in ("twin", "effects", "duration_s")}
        before, after = (
            TwinState.from_arrays({k.removeprefix(part): v for k, v in content.items() if k.startswith(part)})
            for part in ("before.", "after.")
        )
        return Fault(
            known["twin"], known["effects"], content["command"], float(known["duration_s"]), before, after, about
        )
    except InputError:
        raise
    except Exception as error:  # numpy and zipfile raise half a dozen unrelated types on foreign bytes
        raise InputError(f"{path} is not a fault", "a file of a run's folder faults", "check the path") from error


def replay_fault(path: Path | str, twin: str | Path | None = None) -> FaultReplay:
    """Fly a fault again, in a twin with that one simulation.

    Args:
        path: its file.
        twin: `nominal` or a twin YAML in the place of the one named there, if that has moved.

    Raises:
        InputError: if the file is no fault or the twin cannot be made.
    """
    fault = read_fault(path)
    flown = Twin(load_twin(twin or fault.twin).with_effects(fault.effects), 1, num_threads=1)
    first, state, parts = None, fault.before.copy(), tuple[str, ...]()
    for k in range(round(fault.duration / flown.dt) + 1):
        if find_diverged(state).any():
            wrong = tuple(name for name, v in state.arrays().items() if not np.isfinite(v).all())
            first, parts = k * flown.dt, wrong or ("qvel",)
            break
        flown.advance_policy(state, fault.command, flown.dt)
    after = flown.step_policy(fault.before, fault.command, fault.duration)
    pairs = zip(after.arrays().values(), fault.after.arrays().values(), strict=True)
    equal = all(np.array_equal(one, other, equal_nan=True) for one, other in pairs)
    return FaultReplay(fault, after, equal, first, parts)


def describe_replay(replay: FaultReplay) -> str:
    """What a replay showed, in a few lines."""
    fault, start = replay.fault, replay.fault.before
    thrust, rate = fault.command
    lines = [
        f"twin      {fault.twin}, {len(fault.effects)} effects",
        f"at        {start.time[0]:.3f} s, row {fault.about.get('row', '?')}",
        f"position  {np.array2string(start.qpos[0], precision=4)} m, rad",
        f"velocity  {np.array2string(start.qvel[0], precision=4)} m/s, rad/s",
        f"command   {thrust:.4g} N, {rate:.4g} rad/s for {fault.duration:.3g} s",
        "diverges  never"
        if replay.first is None
        else f"diverges  after {1e3 * replay.first:.0f} ms: {', '.join(replay.fields)}",
    ]
    written = ", ".join(f"{name} {number}" for name, number in fault.about.get("versions", {}).items())
    lines.append("replay    bit-equal" if replay.equal else f"replay    differs; the file is of {written}")
    return "\n".join(lines)


if __name__ == "__main__":
    try:
        print(describe_replay(replay_fault(*sys.argv[1:3])))
    except (InputError, TypeError) as error:
        print(f"{error}; usage: python -m vpptwin.twin.health FAULT.npz [TWIN]", file=sys.stderr)
        sys.exit(2)
