"""`vpptwin inspect`: a log as a table, and a twin YAML with what its signals may be.

`--model` in place of `--twin` makes one where there is no doubt.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml
from rich.table import Table as RichTable

from vpptwin.estimation.checks.efforts import judge_efforts
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.channels import SPATIAL
from vpptwin.logs.formats.raw import LARGE
from vpptwin.logs.read import read_flight
from vpptwin.logs.spelling import list_flights, list_sources
from vpptwin.logs.topic_map import LOG_TIME, slash
from vpptwin.mapping.free_body import guess_all
from vpptwin.mapping.guess import Guess
from vpptwin.mapping.models import find_model
from vpptwin.mapping.survey import Signal, survey
from vpptwin.system.errors import InputError
from vpptwin.system.files import check_own, check_target, is_same, write_whole
from vpptwin.system.terminal import open_console, print_warnings
from vpptwin.twin.robot.model import compile_model
from vpptwin.twin.spec import load_twin

WHAT = {"joints": "joint", "bodies": "body", "sites": "site", "actuators": "actuator"}
WANTED = {"joints": "position", "bodies": "position: , attitude", "sites": "rate", "actuators": "effort"}
MAX_ROWS = 1000
"""Signals that a table shows; more are lines."""

ROS_VECTORS = {f"{path}.{c}" for columns in SPATIAL.values() for path in columns.values() for c in "xyzw"}
"""Components that are read without being named, in messages of poses, of odometry and of an IMU."""


def inspect_logs(
    logs: Sequence[Path], model: str | None, out: Path | None, force: bool = False, yes: bool = False
) -> list[Guess]:  # fmt: skip
    """Show what is in logs and, with a model, which of the first one's signals is what; write a twin that says so.

    Args:
        logs: each a flight, or a folder of them.
        model: as of `find_model`.
        out: twin YAML to write; None for one called as the model, in the current folder.
        force: overwrite one that says something else, as somebody may have corrected it.
        yes: take for right what would be asked.

    Returns:
        What was guessed, [] without a model.

    Raises:
        InputError: if a log or the model cannot be read, or the twin not be written.
    """
    if model is None and out is not None:
        raise InputError(f"--out {out} without --model", "a model to write a twin of", "name it, or leave --out out")
    flights = [flight for log in logs for flight in list_flights(log)]
    path = None if model is None else find_model(model)
    target = out or Path(f"{path.stem if path else ''}_twin.yaml")
    if path is not None:
        read = [path, *(file for flight in flights for file in list_sources(flight))]
        if is_same(target, read):
            raise InputError(f"{target} is what was read", "another file to write", "name one with --out")
        check_target(target)
    first: list[Signal] = []
    for flight in flights:
        recording, signals = survey(flight)
        first = first or signals
        print_signals(str(flight), signals, [note for file in recording.files for note in file.notes])
    if path is None:
        return []
    compiled = compile_model(path)
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers beyond all measure, which reading leaves out
        guesses = guess_all(compiled, first)
    doubt_efforts(path, flights[0], guesses)
    guesses = ask(guesses, yes) if yes or (sys.stdin.isatty() and sys.stdout.isatty()) else guesses
    print_guesses(guesses)
    content = compose_twin(path, target, str(flights[0]), guesses)
    there = target.read_text(errors="replace") if target.is_file() else ""
    if not force and list_entries(there) != list_entries(content):
        check_own([target])
    write_whole(target, content)
    print(f"wrote {target}")
    return guesses


def make_twin(logs: Sequence[Path], model: str, yes: bool = False) -> Path:
    """Write MODEL_twin.yaml into the current folder, and show the mapping.

    Args:
        logs: of which the first tells what is what.
        model: as of `find_model`.
        yes: go on with the likeliest mapping, whatever is in doubt.

    Returns:
        The twin.

    Raises:
        InputError: if anything about the first log is in doubt, or another twin of that name is there.
    """
    path = find_model(model)
    log = list_flights(logs[0])[0]
    compiled, signals = compile_model(path), survey(log)[1]
    guesses = guess_all(compiled, signals)
    print_guesses(guesses)
    doubts = [f"{guess.target}: {doubt}" for guess in guesses for doubt in guess.doubts]
    if yes and guesses:
        print_warnings(doubts)
    elif doubts or not guesses:
        first = (
            f"{len(doubts)} doubts about {log} ({doubts[0]})" if doubts else f"{path} has no hinge, slide or actuator"
        )
        action = f"run `vpptwin inspect {log} --model {model}`, correct what it writes, and give that as --twin"
        raise InputError(first, "none, to go on without a twin YAML", action)
    out = Path(f"{path.stem}_twin.yaml")
    content = compose_twin(path, out, str(log), guesses)
    if not out.exists():
        return write_whole(out, content, force=False)
    if list_entries(out.read_text()) != list_entries(content):
        raise InputError(f"{out} is there already, and says something else", "none", f"give --twin {out}, or move it")
    return out


def doubt_efforts(model: Path, log: Path, guesses: Sequence[Guess]) -> None:
    """Doubt efforts that are no forces, with the scale to write; where a twin of the guesses reads the log at all."""
    named = {guess.target: guess for guess in guesses if guess.group == "actuators" and guess.fields}
    if not named or sum(file.stat().st_size for file in list_sources(log)) > LARGE:
        return
    with suppress(InputError), TemporaryDirectory() as folder:
        twin = Path(folder) / "twin.yaml"
        twin.write_text(compose_twin(model, twin, str(log), guesses), encoding="utf-8")
        spec = load_twin(str(twin))
        flight = read_flight(log, None, spec.robot.signals.entries)
        for effort in judge_efforts(spec, [read_measurements(spec, flight)]):
            named[effort.actuator].doubts.append(f"{effort}: write scale: {effort.scale:.4g}")
            named[effort.actuator].sure = False


def list_entries(text: str) -> object:
    """What a twin YAML says, without its comments; its only topic goes unnamed, as it is called as the log."""
    try:
        content = yaml.safe_load(text)
        entries = [e for group in content["signals"].values() for e in group.values() if isinstance(e, dict)]
        if len({entry["topic"] for entry in entries}) == 1:
            for entry in entries:
                entry["topic"] = ""
    except (yaml.YAMLError, KeyError, TypeError, AttributeError):
        return text
    return content


def print_signals(title: str, signals: Sequence[Signal], notes: Sequence[str]) -> None:
    """One row a signal."""
    end = (max(s.whole.end for s in signals) - min(s.whole.start for s in signals)) / 1e9
    title = f"{title}: {len(signals)} signals over {end:.4g} s"
    console = open_console()
    if len(signals) > MAX_ROWS:  # of which no terminal is wide enough for a table, nor patient enough
        print("\n".join([title, *("  ".join(filter(None, describe_signal(signal))) for signal in signals)]))
    else:
        table = RichTable(title=title, title_justify="left")
        for head in ("signal", "type", "rate", "range", "unit", "odd"):
            table.add_column(head, justify="right" if head == "rate" else "left", overflow="fold")
        for signal in signals:
            table.add_row(*describe_signal(signal))
        console.print(table)
    for note in notes:
        console.print(note)


def describe_signal(signal: Signal) -> tuple[str, ...]:
    """Name, type, rate, range, unit and what is odd of a signal, for a table."""
    low, high = signal.whole.low, signal.whole.high
    span = f"{low:.6g}" if low == high else f"{low:.4g} to {high:.4g}" if low < high else "no number"
    rate = f"{signal.rate:.4g} Hz" if np.isfinite(signal.rate) else ""
    return signal.title, signal.kind, rate, span, signal.unit, "; ".join(signal.list_oddities())


def print_guesses(guesses: Sequence[Guess]) -> None:
    """One row for each joint, actuator, body and IMU."""
    table = RichTable(title="what they may be", title_justify="left")
    for head in ("of the model", "in the log", "confidence", "why"):
        table.add_column(head, overflow="fold")
    for guess in guesses:
        titles = {quantity: signal.title for quantity, signal in guess.fields.items()} | {
            quantity: " ".join(signal.label for signal in signals) for quantity, signals in guess.vectors.items()
        }
        sure = "sure" if guess.sure else "a doubt" if titles else "missing"
        said = "; ".join([*guess.reasons, *(f"BUT {doubt}" for doubt in guess.doubts)])
        shown = ", ".join(f"{quantity}: {title}" for quantity, title in titles.items())
        table.add_row(f"{guess.target} ({WHAT[guess.group]})", shown or "-", sure, said)
    open_console().print(table)


def ask(guesses: Sequence[Guess], yes: bool = False) -> list[Guess]:
    """Ask on the terminal about each doubt that a person can settle; those about the order of columns all at once."""
    ordered = [guess for guess in guesses if guess.doubts and all(d.startswith("only the order") for d in guess.doubts)]
    if ordered:
        pairs = ", ".join(f"{s.label} = {g.target}" for g in ordered for s in list(g.fields.values())[:1])
        if yes or input(f"Is this the order of the columns: {pairs}? [y/n] ").strip().lower() in ("y", "yes"):
            for guess in ordered:
                guess.reasons.append("order confirmed")
                guess.doubts, guess.sure = [], True
    return list(guesses)


def compose_twin(model: Path, target: Path, log: str, guesses: Sequence[Guess]) -> str:
    """A twin YAML with a comment at each guess; what is unknown is commented out."""
    relative = os.path.relpath(model.resolve(), target.parent.resolve())
    lines = [f"# Written by vpptwin inspect from {one_line(log)}; check the lines with DOUBT.",
             f"model: {yaml.safe_dump(relative).splitlines()[0]}"]  # fmt: skip
    lines += ["signals:"] * bool(guesses)
    for group in WHAT:
        members = [guess for guess in guesses if guess.group == group]
        empty = " {}" if not any(guess.fields or guess.vectors for guess in members) else ""
        if members:
            lines += [f"  {group}:{empty}", *(compose_line(guess) for guess in members)]
    return "\n".join(lines) + "\n"


def compose_line(guess: Guess) -> str:
    """One entry of `signals`, with what speaks for it and against it."""
    said = "; ".join([*guess.reasons, *(f"DOUBT: {doubt}" for doubt in guess.doubts)])
    name = yaml.safe_dump(guess.target).splitlines()[0]
    if not (guess.fields or guess.vectors):
        return f"    # {name}: {{topic: , {WANTED[guess.group]}: }}  # {one_line(said)}"
    signals = [*guess.fields.values(), *(signal for vector in guess.vectors.values() for signal in vector)]
    (topic,) = {signal.topic for signal in signals}
    named = not guess.vectors and all(s.name == guess.target and s.field == q for q, s in guess.fields.items())
    # Components that are read of messages of poses, of odometry and of an IMU, in that order.
    known = (all(s.field in ROS_VECTORS for s in vector) and "wxyz".endswith("".join(s.field[-1] for s in vector))
             for vector in guess.vectors.values())  # fmt: skip
    plain = not guess.units and not guess.more and all(known)
    if named or (guess.vectors and plain):
        return f"    {name}: {yaml.safe_dump(topic).splitlines()[0]}  # {one_line(said)}"
    if any(signal.name for signal in signals):
        return f"    # {name}: {topic}  # called {signals[0].name} in the log; rename it in the MJCF; {one_line(said)}"
    entry: dict[str, object] = {"topic": slash(topic).removeprefix("/")}
    paths: dict[str, str | list[str]] = {quantity: signal.field for quantity, signal in guess.fields.items()}
    paths |= {quantity: [signal.field for signal in vector] for quantity, vector in guess.vectors.items()}
    for quantity, path in paths.items():
        more = ({"unit": unit} if (unit := guess.units.get(quantity)) else {}) | guess.more.get(quantity, {})
        entry[quantity] = {"path": path, **more} if more else path
    if signals[0].headless:
        entry["stamp"] = LOG_TIME
    text = yaml.safe_dump(entry, default_flow_style=True, sort_keys=False, width=10_000, allow_unicode=True).strip()
    return f"    {name}: {text}  # {one_line(said)}"


def one_line(text: str) -> str:
    """Text for a comment."""
    return re.sub(r"\s+", " ", text)
