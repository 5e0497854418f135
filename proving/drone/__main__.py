"""Fly one flight into a log: `python -m proving.drone --effect rail_x.coulomb:force=0.3 --out flight.mcap`."""

from __future__ import annotations

import argparse
from pathlib import Path

from .effects import parse_effect
from .flight import fly
from .gusts import KINDS, Wind
from .manoeuvres import MANOEUVRES
from .recording import write_mcap


def main() -> None:
    """Parse the command line, fly, write."""
    parser = argparse.ArgumentParser(prog="python -m proving.drone", description=__doc__)
    parser.add_argument("--effect", action="append", default=[], metavar="ID:NAME=VALUE[,NAME=VALUE]")
    parser.add_argument("--manoeuvre", choices=sorted(MANOEUVRES), default="aggressive")
    parser.add_argument("--duration", type=float, default=20.0, help="s")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--session", type=int, help="seed of the rig's tolerances; flights of one rig share it")
    parser.add_argument("--no-gusts", dest="gusts", action="store_false")
    parser.add_argument("--gust", choices=KINDS, default="ou", help="kind of gusts")
    parser.add_argument("--gust-strength", type=float, default=1.0, help="rms in %% of weight")
    parser.add_argument("--gust-time", type=float, default=0.3, help="s over which the force stays alike")
    parser.add_argument("--no-jitter", dest="jitter", action="store_false", help="nominal rig, exact mocap stamps")
    parser.add_argument("--no-dropouts", dest="dropouts", action="store_false")
    parser.add_argument("--distractors", action="store_true", help="thrust ripple and gyro wander, hardly noticeable")
    parser.add_argument("--outliers", action="store_true", help="0.5 %% of the mocap frames are far off")
    parser.add_argument("--out", type=Path, required=True)
    given = vars(parser.parse_args())
    out, effects = given.pop("out"), given.pop("effect")
    given["wind"] = Wind(given.pop("gust"), given.pop("gust_strength"), given.pop("gust_time"))
    try:
        hidden = dict(parse_effect(text) for text in effects)
    except ValueError as error:
        parser.error(str(error))
    print(write_mcap(fly(hidden, **given), out))


if __name__ == "__main__":
    main()
