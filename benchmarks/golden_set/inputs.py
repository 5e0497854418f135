"""What goes into items: each function here gives one that writes into a folder.

All that is imported of proving grounds, examples and modules of the package is looked up in `PLACES`.
"""

from __future__ import annotations

import importlib
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"
PLACES = {
    "crafts": "proving.hidden", "draw_session": "proving.mechanisms:draw_session",
    "draw_wind": "proving.drone:draw_wind",
    "fly_many": "proving.drone:fly_many", "leg": "proving.leg", "quadrotor": "proving.quadrotor",
    "servo": "proving.servo_arm", "write_mcap": "proving.drone:write_mcap",
    "weigh_hovers": "examples.crazypad.by_hand:compare",
    "vpptwin": "vpptwin", "collect_content": "vpptwin.deploy.content:collect_content",
    "Given": "vpptwin.twin.warp.replay:Given", "WarpReplay": "vpptwin.twin.warp.replay:WarpReplay",
    "WarpStep": "vpptwin.twin.warp.step:WarpStep",
}  # fmt: skip
"""Where things are that are no command: all that has to follow when modules move."""
SEED = 94065
"""Of the sessions of other rigs."""
Effects = Mapping[str, Mapping[str, float]]
Prepare = Callable[[Path], None]


def take(name: str) -> Any:  # noqa: ANN401
    """A thing of `PLACES`, imported when it is needed."""
    module, _, inside = PLACES[name].partition(":")
    found = importlib.import_module(module)
    return getattr(found, inside) if inside else found


def fly_drone(effects: Effects, seed: int, duration: float, *manoeuvres: str) -> Prepare:
    """Flights of the drone's independent simulation, so long each [s], all realism on."""

    def prepare(folder: Path) -> None:
        wind = take("draw_wind")(np.random.default_rng(seed), most=1.5)
        plan = {"effects": effects, "duration": duration, "session": seed, "wind": wind, "distractors": True}
        flights = [plan | {"manoeuvre": name, "seed": seed + 1 + i} for i, name in enumerate(manoeuvres)]
        for flight in take("fly_many")(flights):
            take("write_mcap")(flight, folder / f"{flight.manoeuvre}.mcap")

    return prepare


def move_rig(number: int, duration: float = 0.0) -> Prepare:
    """A session of another rig; with a duration [s] its first log only, so long."""

    def prepare(folder: Path) -> None:
        session = take("draw_session")(SEED, number)
        motions = tuple(replace(m, duration=duration) for m in session.motions[:1]) if duration else session.motions
        replace(session, motions=motions).record(folder)

    return prepare


def move_craft(name: str, effects: Effects, duration: float) -> Prepare:
    """A log of the quadrotor, the arm with servos or the leg, so long [s]."""

    def prepare(folder: Path) -> None:
        ground = take(name)
        ground.write_twin(folder)
        move = ground.fly if name == "quadrotor" else ground.move
        take("crafts").write_log(move(effects, duration, 5), folder / "log.mcap")

    return prepare


def copy_example(rig: str, *logs: str, converted: Sequence[str] = ()) -> Prepare:
    """Models, twins, effects and logs of an example, and measured logs; `converted` is what its convert.py is told."""

    def prepare(folder: Path) -> None:
        for file in sorted((ROOT / "examples" / rig).iterdir()):
            if file.suffix in (".xml", ".yaml", ".mcap") or file.name == "cogging.py":
                shutil.copyfile(file, folder / file.name)
        for log in logs:
            shutil.copyfile(DATA / rig / log, folder / log)
        if converted:
            source, *options = converted
            command = [sys.executable, "-m", f"examples.{rig}.convert", DATA / rig / source, folder / "log.mcap"]
            subprocess.run([*command, *options], check=True, cwd=ROOT)

    return prepare


def copy_files(*files: Path) -> Prepare:
    """Files as they are."""

    def prepare(folder: Path) -> None:
        for file in files:
            shutil.copyfile(file, folder / file.name)

    return prepare
