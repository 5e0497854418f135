"""Command line of SimGap."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

WORLDS = (
    "drones", "carts", "pendula", "cart-poles", "double-pendula", "arms", "servos", "legs", "quadrotors", "pairs",
    "watched",
)  # fmt: skip
"""Of worlds.py, which takes seconds to import."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; errors are one line."""
    parser = argparse.ArgumentParser(
        prog="simgap", description="A benchmark for naming what a robot's simulation gets wrong."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    draw = commands.add_parser("draw", help="draw sessions from a seed")
    draw.add_argument("folder", type=Path)
    draw.add_argument("--seed", type=int, help="default: 1, the public one")
    draw.add_argument(
        "--secret", action="store_true", help="draw a seed too; it is printed once, and only its hash is kept"
    )
    draw.add_argument(
        "--numbers", default="0:12", metavar="NUMBERS",
        help=f"of sessions, of every world (0:12, the default) or of some (carts=0:6,arms=3), of {', '.join(WORLDS)}",
    )  # fmt: skip
    draw.add_argument("--lerobot", action="store_true", help="runs as LeRobot data sets too (needs pyarrow)")
    measured = commands.add_parser("measured", help="write the sessions with measured data, which are scored apart")
    measured.add_argument("folder", type=Path)
    measured.add_argument("--data", type=Path, help="where their files lie; by default they are fetched")
    check = commands.add_parser("check", help="check a set against its manifest, or one that was published")
    check.add_argument("folder", type=Path)
    check.add_argument("--published", type=Path, help="the manifest that was published")
    validate = commands.add_parser("validate", help="check an answer")
    validate.add_argument("session", type=Path)
    validate.add_argument("answer", type=Path)
    answer = commands.add_parser("answer", help="answer one session")
    answer.add_argument("entrant")
    answer.add_argument("session", type=Path)
    answer.add_argument("--out", type=Path, required=True)
    run = commands.add_parser("run", help="answer all sessions of a set")
    run.add_argument("folder", type=Path)
    run.add_argument("--entrants", default="", help="default: all of this package")
    run.add_argument("--command", default="", dest="external", help="of your own entrant: 'mytool {session} {answer}'")
    run.add_argument("--jobs", type=int, default=1)
    run.add_argument("--limit", type=float, default=900.0, help="time that a session may take [s]")
    tune = commands.add_parser("tune", help="set what turns evidence into probabilities, on public sessions")
    tune.add_argument("folder", type=Path)
    board = commands.add_parser("board", help="score all answers; write the board as JSON, Markdown and pictures")
    board.add_argument("folder", type=Path)
    board.add_argument("--out", type=Path, required=True, help="folder")
    board.add_argument("--seed", type=int, help="of a secret set, to publish it now that all have answered")
    given = parser.parse_args(arguments)
    try:
        return COMMANDS[given.command](given)
    except (ValueError, OSError) as error:
        print(f"simgap: {error}", file=sys.stderr)
        return 2


def run_draw(given: argparse.Namespace) -> int:
    """Draw a set."""
    from proving.simgap.sets import draw_seed, draw_set, hash_set, read_manifest

    seed = draw_seed() if given.secret else 1 if given.seed is None else given.seed
    draw_set(given.folder, seed, read_numbers(given.numbers), not given.secret, given.lerobot)
    manifest = read_manifest(given.folder)
    secret = f"; the seed is {seed}: keep it, it is written nowhere" if given.secret else ""
    print(f"{len(manifest['sessions'])} sessions in {given.folder}, hash {hash_set(manifest)}{secret}")
    return 0


def read_numbers(text: str) -> dict[str, list[int]]:
    """World → numbers of sessions.

    Raises:
        ValueError: where a world is unknown, or numbers are none.
    """
    found: dict[str, list[int]] = {}
    for part in text.split(","):
        world, _, numbers = part.rpartition("=")
        first, _, last = numbers.partition(":")
        if not first.isdigit() or not (last or first).isdigit():
            raise ValueError(f"numbers {part!r}: write 0:12 for all worlds, or carts=0:6,arms=3")
        if world and world not in WORLDS:
            raise ValueError(f"no world {world}: there are {', '.join(WORLDS)}")
        for name in [world] if world else WORLDS:
            found.setdefault(name, []).extend(range(int(first), int(last or int(first) + 1)))
    return found


def run_measured(given: argparse.Namespace) -> int:
    """Write the sessions with measured data."""
    from proving.simgap.measured import write_measured

    print(f"{', '.join(write_measured(given.folder, given.data))} in {given.folder}")
    return 0


def run_check(given: argparse.Namespace) -> int:
    """Check a set."""
    from proving.simgap.sets import check_set

    published = json.loads(given.published.read_text()) if given.published else None
    print(f"{check_set(given.folder, published)} sessions are as published")
    return 0


def run_validate(given: argparse.Namespace) -> int:
    """Check an answer."""
    from proving.simgap.answers import read_answer
    from proving.simgap.storage import read_session

    read_answer(given.answer, read_session(given.session))
    print(f"{given.answer} is a valid answer")
    return 0


def run_answer(given: argparse.Namespace) -> int:
    """Answer one session."""
    from proving.simgap.entrants import answer_session
    from proving.simgap.run import measure_self
    from proving.simgap.storage import read_session

    try:
        found = answer_session(given.entrant, read_session(given.session), given.session)
    except RuntimeError as error:  # of another program
        raise ValueError(str(error)) from None
    given.out.write_text(json.dumps(found | {"memory_mb": measure_self()}) + "\n")
    return 0


def run_all(given: argparse.Namespace) -> int:
    """Answer all sessions of a set."""
    from proving.simgap.entrants import ENTRANTS
    from proving.simgap.run import run_entrant
    from proving.simgap.sets import list_sessions

    names = given.entrants.split(",") if given.entrants else list(ENTRANTS)
    if not given.external and (strange := sorted(set(names) - set(ENTRANTS))):
        raise ValueError(f"no entrant {', '.join(strange)}: there are {', '.join(ENTRANTS)}, or give --command")
    for name in names:
        valid = run_entrant(name, given.folder, given.external, given.jobs, given.limit)
        print(f"{name}: {valid} of {len(list_sessions(given.folder))} answers are valid", flush=True)
    return 0


def run_tune(given: argparse.Namespace) -> int:
    """Tune what turns evidence into probabilities."""
    from proving.simgap.board import tune_entrants

    for name, score in tune_entrants(given.folder).items():
        print(f"{name}: log score {score:.3f} on these sessions")
    return 0


def run_board(given: argparse.Namespace) -> int:
    """Score and write the board."""
    from proving.simgap.board import write_board
    from proving.simgap.sets import publish_seed

    if given.seed is not None:
        publish_seed(given.folder, given.seed)
    for path in write_board(given.folder, given.out):
        print(path)
    return 0


COMMANDS = {
    "draw": run_draw, "measured": run_measured, "check": run_check, "validate": run_validate, "answer": run_answer,
    "run": run_all, "tune": run_tune, "board": run_board,
}  # fmt: skip


def run() -> None:
    """The command `simgap`."""
    sys.exit(main())


if __name__ == "__main__":
    run()
