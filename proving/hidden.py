"""What proving/quadrotor.py, proving/servo_arm.py and proving/leg.py have in common: files, and what may be hidden."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from proving.logs import Log, write_log

Hidden = Mapping[str, Mapping[str, float]]
"""Effect → parameter → value, in the catalogue's terms."""
Spans = Mapping[str, tuple[str, float, float]]
"""What may be hidden, a word behind it for what has either sign: strength, and its span from slight to strong."""


def save_twin(folder: Path, name: str, mjcf: str, twin: str) -> Path:
    """Write the nominal twin and its MJCF."""
    (folder / f"{name}.xml").write_text(mjcf)
    (folder / "twin.yaml").write_text(twin)
    return folder / "twin.yaml"


def record(mjcf: str, make: Callable[[Hidden, float, int], Log], duration: float) -> None:
    """Command line of a proving ground: the MJCF, named as in it, and logs, into the current folder."""
    parser = argparse.ArgumentParser(description=record.__doc__)
    parser.add_argument(
        "--effect", action="append", default=[], metavar="ID:NAME=VALUE", help="hidden; as in a verdict"
    )
    parser.add_argument("--logs", type=int, default=3, help="how many")
    parser.add_argument("--duration", type=float, default=duration, help="of each, s")
    parser.add_argument("--seed", type=int, default=1, help="of motions, gusts and noise")
    options = parser.parse_args()
    hidden: dict[str, dict[str, float]] = {}
    for effect, name, value in (re.split("[:=]", given) for given in options.effect):
        hidden.setdefault(effect, {})[name] = float(value)
    (name,) = re.findall(r'<mujoco model="(\w+)"', mjcf)
    Path(f"{name}.xml").write_text(mjcf)
    for i in range(options.logs):
        write_log(make(hidden, options.duration, 100 * options.seed + i), Path(f"log_{i}.mcap"))


def draw_one(seed: Sequence[int], spans: Spans) -> Hidden:
    """One effect, all equally likely, its strength log-uniform; in one of six sessions none."""
    rng = np.random.default_rng(seed)
    if rng.random() < 1.0 / 6.0:
        return {}
    effect = str(rng.choice(list(spans)))
    name, low, high = spans[effect]
    value = float(low * (high / low) ** rng.random())
    return {effect.split()[0]: {name: value * (rng.choice([-1.0, 1.0]) if " " in effect else 1.0)}}
