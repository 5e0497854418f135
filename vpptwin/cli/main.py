"""The command line: one entry point and its grammar; what commands do is in `vpptwin.cli.commands`."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from signal import SIGINT
from typing import NoReturn

from vpptwin import __version__
from vpptwin.cli import commands
from vpptwin.system.doubt import take_as_is
from vpptwin.system.errors import InputError, check_name, explain_missing, suggest
from vpptwin.system.files import check_own, check_target, discard_all
from vpptwin.system.resources import name_packages
from vpptwin.system.signals import heed_signals
from vpptwin.system.terminal import show_plainly
from vpptwin.system.trust import EVERY, trust

WRITTEN = ("out", "json", "html", "video", "pictures")
"""Options that name what a command writes: a file, or, where they have a metavar, what the command looks at itself."""
PARTS = "FILE+FILE is one recording in several files, LOG@600-900 a part of a log [s]"

Add = Callable[..., object]
"""Adds an argument, as `ArgumentParser.add_argument` does."""
Begin = Callable[[str, str, Callable[..., int | None]], Add]
"""Begins a command by its name, what it does in a line, and what runs it."""


class Parser(argparse.ArgumentParser):
    """A parser that refuses in one line, as every other part of vpptwin does."""

    def error(self, message: str) -> NoReturn:
        """Print what was wrong, what is close to it, what was expected and where to read more; exit with code 2."""
        choice, option = (re.search(text, message) for text in ("invalid choice: '([^']*)'", "arguments: (--[^ =]*)"))
        known = [action.choices or () if choice else action.option_strings for action in self._actions]
        wrong = choice or option
        near = suggest(wrong[1], map(str, chain.from_iterable(known)), "") if wrong else ""
        message += f"; {near}" if near else ""
        usage = " ".join(self.format_usage().removeprefix("usage: ").split())
        self.exit(2, f"vpptwin: {message}; expected {usage}; see `{self.prog} --help`\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Returns:
        Exit code: 0, 3 where `history` finds that something left its band, 2 with one line on stderr for bad input, or
        130 and the like with one for a signal.
    """
    parser = build_parser()
    given = list(sys.argv[1:] if arguments is None else arguments)
    # Hydra's own grammar takes everything after `train`.
    if given[:1] == ["train"]:
        if "--trust" in given:
            trust()
        return guard(lambda: commands.run_train([word for word in given[1:] if word != "--trust"]))
    if not given:
        parser.print_help()
        return 0
    with show_plainly():
        options, unknown = parser.parse_known_args(given)
        if unknown:
            options.parser.error(f"unrecognized arguments: {' '.join(unknown)}")
    trust([EVERY] if getattr(options, "trust", False) else getattr(options, "effects", ()))
    return guard(lambda: run(options, given))


def run(options: argparse.Namespace, given: Sequence[str]) -> int | None:
    """Run what was asked for, if its words can be shown; returns its exit code, if it has one of its own."""
    for word in given:
        check_name(word)
    targets = {name: path for name in options.written if (path := getattr(options, name)) is not None}
    if not getattr(options, "force", True):
        check_own(targets.values())
    for name, path in targets.items():
        check_target(path, json=name == "json")
    name_packages(getattr(options, "package", ()))
    with take_as_is(getattr(options, "as_is", False)):
        code: int | None = options.run(options)
    return code


def guard(action: Callable[[], int | None]) -> int:
    """Run an action, which may have a code; bad input becomes one line on stderr and 2, a signal one and its own."""
    with show_plainly(), heed_signals() as heard:
        try:
            code = action()
            sys.stdout.flush()
        except BaseException as error:
            if heard or isinstance(error, KeyboardInterrupt):  # whatever a library made of it
                discard_all()  # where tidying up was what it interrupted
                say("stopped")
                return 128 + (heard or [SIGINT])[0]
            if isinstance(error, BrokenPipeError):
                # The reader (head, less) went away; Python would complain again while closing stdout.
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                return 0
            problem = explain(error)
            if problem is None:
                raise
            say(str(problem))
            return 2
    return code or 0


def say(text: str) -> None:
    """A line on stderr, if there is anything behind it."""
    begin = "\n" if getattr(sys.stderr, "midline", False) else ""  # a bar that was not closed
    with suppress(OSError):
        print(f"{begin}vpptwin: {text}", file=sys.stderr)


def explain(error: BaseException) -> InputError | None:
    """What was wrong with the input, or the machine; None for a mistake of ours."""
    if isinstance(error, OSError):  # what no check foresaw: a full disk, a drive that went away
        where = f"{error.filename}: " if error.filename else ""
        return InputError(f"{where}{error.strerror or error}", "a file to read or write", "check path and disk")
    if isinstance(error, RuntimeError) and str(error).startswith("Symlink loop"):  # Python's of before 3.13
        return InputError(f"{str(error).rpartition(' ')[2]} is a link to itself", "a file", "name another")
    if isinstance(error, MemoryError):
        return InputError("memory ran out", "input that this machine can hold", "give less, or a larger machine")
    if isinstance(error, ModuleNotFoundError):
        return explain_missing(error)
    return error if isinstance(error, InputError) else None


def build_parser() -> argparse.ArgumentParser:
    """The grammar of all commands."""
    parser = Parser(prog="vpptwin", description="A simulation twin that finds what your simulation gets wrong.")
    parser.add_argument("--version", action="version", version=f"vpptwin {__version__}")
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    def begin(name: str, summary: str, run: Callable[..., int | None]) -> Add:
        command = subparsers.add_parser(name, help=summary, add_help=name != "train")
        command.set_defaults(run=run, parser=command)
        return command.add_argument

    describe_logs(begin)
    describe_pilots(begin)
    for command in subparsers.choices.values():
        written = [action for action in command._actions if action.dest in WRITTEN]
        if written:
            command.add_argument("--force", action="store_true", help="overwrite files that vpptwin did not write, too")
        command.set_defaults(written=[action.dest for action in written if action.metavar is None])
    return parser


def describe_logs(begin: Begin) -> None:
    """Commands about logs, and their arguments."""
    add = begin("demo", "diagnose logs that ship with vpptwin", commands.run_demo)
    robots = "a robot whose measured logs ship, the arm so101; without it, the drone in an independent simulation"
    add("robot", nargs="?", choices=["so101"], help=robots)
    add("--out", type=Path, metavar="DIR", help="folder for report and pages (default out/demo, or out/so101)")

    add = begin("effects", "list the catalogue of effects", commands.run_effects)
    add("--twin", default="nominal", help="`nominal`, `typical` or a twin YAML, whose rig's effects are listed")
    add_effects(add)
    add("--markdown", action="store_true", help="as a Markdown table")
    add("--pictures", metavar="DIR", help="draw what each effect does into this folder")

    add = begin("diagnose", "find what a twin gets wrong, from logs", commands.run_diagnose)
    add_logs(add, "*")
    add("--twin", default="nominal", help="`nominal` (default), `typical` or a twin YAML")
    add("--out", type=Path, metavar="DIR", required=True, help="folder for verdict.json, report.html and twin.yaml")
    add("--json", type=Path, help="write the verdict here as well; - prints it instead of the summary")
    add("--rrd", action="store_true", help="write the twins' predictions for Rerun as well as for Foxglove")
    only = "effects that are candidates, by id or pattern, e.g. elbow.*,wrist.viscous; may be repeated (default: all)"
    add("--only", action="append", default=[], metavar="IDS", help=only)
    add("--without", action="append", default=[], metavar="IDS", help="effects that are no candidates, likewise")
    fixed = "an effect that is known, EFFECT.PARAMETER=VALUE (or EFFECT=VALUE where it has one); may be repeated"
    add("--fix", action="append", default=[], metavar="EFFECT=VALUE", help=fixed)
    revised = "fit the causes of an earlier diagnosis in this folder anew, but for those --without; looks for no others"
    add("--from", type=Path, dest="revised", metavar="DIR", help=revised)
    add("--limit", metavar="TIME", help="stop after so long, e.g. 90s, 10m, 1h, with what was found so far")
    add("--device", help="simulate on a GPU, `cuda`, or on Warp's processor device, `cpu` (default: numba, all cores)")

    add = begin("compare", "measure a twin's prediction error on logs", commands.run_compare)
    add_logs(add)
    add("--twin", action="append", help="`nominal` (default), `typical` or a twin YAML; several times for several")
    add("--json", type=Path, help="write the figures here as well; - prints them instead")

    add = begin("history", "report how parameters change from log to log", commands.run_history)
    add_logs(add)
    add("--twin", default="nominal", help="twin YAML whose named causes are followed; or `nominal`, `typical`")
    add("--parameters", metavar="IDS", help="effects to follow instead, e.g. rail_x.coulomb,battery.sag")
    band = "EFFECT.PARAMETER=LOW:HIGH, where a parameter belongs: exit code 3 if it is not; may be repeated"
    add("--band", action="append", default=[], metavar="BAND", help=band)
    add("--jobs", default="1", help="processes that share the logs, or `ray` for a cluster's (default 1)")
    add("--out", type=Path, metavar="DIR", required=True, help="folder for history.html and history.json")
    add("--json", type=Path, help="write the data here as well; - prints it instead of the sentences")

    add = begin("play", "watch a log in meshcat, the twin beside it", commands.run_play)
    add("log", type=Path, nargs="*", metavar="LOG", help="a log of any kind, or the split files of one")
    add_beside(add)
    add("--html", type=Path, help="write one self-contained page instead of opening a server")
    add("--video", type=Path, help="write an animation, .gif, .webp or .mp4, instead of opening a server")
    viewers = "meshcat in the browser (default), or a window of MuJoCo's own viewer"
    add("--viewer", choices=["meshcat", "mujoco"], default="meshcat", help=viewers)
    add("--live", type=Path, metavar="CKPT", help="instead of a log, a policy in real time; flip and push it")
    add("--host", default="127.0.0.1", help="address to serve on; by default only this machine can connect")
    add("--port", type=int, default=0, help="port to serve on; the default is any that is free")

    add = begin("plot", "draw a log over time, the twin beside it, or training curves", commands.run_plot)
    sources = "a log (or its split files), or folders of training runs"
    add("source", type=Path, nargs="+", metavar="SOURCE", help=sources)
    add_beside(add)
    add("--out", type=Path, help="picture, .png or .svg, or interactive page, .html (default SOURCE.png)")
    add("--theme", choices=["light", "dark"], default="light", help="of PNG and page (default light)")

    add = begin("convert", "write a log of any kind as MCAP", commands.run_convert)
    add("log", type=Path, metavar="LOG", help=f"a log of any kind; {PARTS}")
    add("out", type=Path, metavar="OUT", help="MCAP file to write")

    add = begin("inspect", "list the signals of a log, and map them to joints and actuators", commands.run_inspect)
    add("logs", type=Path, nargs="+", metavar="LOG", help=f"logs of any kind; {PARTS}")
    add_yes(add)
    add("--model", metavar="NAME", help="MJCF, URDF, xacro or menagerie name; map signals to its joints and actuators")
    add_packages(add)
    add("--out", type=Path, metavar="YAML", help="twin to write with the mapping (default MODEL_twin.yaml)")

    add = begin("layouts", "write layouts of Foxglove and PlotJuggler for our logs", commands.run_layouts)
    add("out", type=Path, metavar="DIR", help="where to write foxglove.json and plotjuggler.xml")


def describe_pilots(begin: Begin) -> None:
    """Commands about pilots, actuators and policies, and their arguments."""
    add = begin("fly", "fly a manoeuvre or a policy in a twin and write its log", commands.run_fly)
    add("checkpoint", type=Path, nargs="?", help="a checkpoint, a run's folder, or the shipped `flip`")
    add("--policy", type=Path, metavar="FILE", help="instead, an exported controller, .so or .onnx")
    add("--task", help="whose targets the policy flies (default: that of its training)")
    add("--pilot", choices=["scripted", "policy"], help="by default the one that the other options imply")
    add("--manoeuvre", metavar="NAME", help="what the scripted pilot flies; --list shows all")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of the manoeuvre")
    add("--list", action="store_true", help="list manoeuvres with their settings, fly nothing")
    add("--twin", default="nominal", help="`nominal` (default), `typical` or a twin YAML")
    add_effects(add)
    add("--controller", choices=["map", "adaptive"], help="of the actuators; by default the twin's own")
    add("--duration", type=float, help="s; by default the manoeuvre's or the task's own")
    add("--seed", type=int, default=0, help="of noise, gusts and a task's targets (default 0)")
    add("--gusts", action="store_true", help="add gusts of 1 %% of the weight")
    add("--out", type=Path, help="log to write, MCAP")

    add = begin("identify", "fit an actuator to thrust-stand runs, or a twin to logs", commands.run_identify)
    add("logs", type=Path, nargs="+", metavar="LOG", help="MCAP logs of thrust-stand runs, or other logs")
    add("--parameters", metavar="IDS", help="effects to fit to logs, e.g. air.drag,servo.lag")
    add("--twin", default="nominal", help="with --parameters: `nominal` (default), `typical` or a twin YAML")
    add_effects(add)
    add("--out", type=Path, required=True, help="actuator YAML to write, a page goes beside it; or twin")
    add("--vehicle", type=Path, help="vehicle YAML that gives governed speed and inner rate")
    add_topic_map(add)
    add_as_is(add)

    begin("train", "train a policy with PPO", lambda options: commands.run_train([]))  # Hydra takes its arguments

    add = begin("export", "write a policy as C99 source or ONNX, a twin as MJCF or for mjlab", commands.run_export)
    add("source", type=Path, help="a checkpoint, a run's folder or the name of a shipped policy; or a twin YAML")
    formats = "a policy as c or onnx; a twin as mjcf, or as a randomization for mjlab"
    add("--format", choices=["c", "onnx", "mjcf", "mjlab"], required=True, help=formats)
    add("--twin", help="whose vehicle the cascade is for (default: that of training)")
    add_effects(add)
    add("--out", type=Path, metavar="PATH", help="folder for C (default NAME_c), else file (default NAME.onnx, .xml)")

    add = begin("evaluate", "measure a trained policy", commands.run_evaluate)
    add("checkpoint", type=Path, help="a checkpoint, a run's folder or the name of a shipped policy")
    add("--task", help="what to fly (default: the task of training)")
    add("--tracks", type=int, default=200, help="flights, flown side by side (default 200)")
    add("--seed", type=int, default=0, help="of everything random (default 0)")
    add("--twin", default="nominal", help="`nominal` (default), `typical` or a twin YAML")
    add("--noise", type=float, default=1.0, help="times the noise of vehicle.yaml (default 1)")
    randomized = "effects drawn from their priors, separated by commas, or paper (default), all, none"
    add("--randomize", default="paper", metavar="NAMES", help=randomized)
    add("--thrust-to-weight", type=float, help="rotors of this strength (default: the task's)")
    add("--estimator", choices=["sensors", "kalman"], help="what the policy observes (default: as in training)")
    add_effects(add)
    add("--json", type=Path, help="write all figures here as well; - prints them instead of the sentence")


def add_logs(add: Add, number: str = "+") -> None:
    """Arguments of commands that compare logs with a twin."""
    add("logs", type=Path, nargs=number, metavar="LOG", help=f"logs of any kind; {PARTS}")
    add(
        "--model",
        metavar="NAME",
        help="instead of --twin, an MJCF, URDF, xacro or menagerie name, if the mapping leaves no doubt",
    )
    add_yes(add)
    add_effects(add)
    add_topic_map(add)
    add_as_is(add)


def add_beside(add: Add) -> None:
    """Arguments of commands that show twins beside a log."""
    twin = "`nominal`, `typical` or a twin YAML, driven by the log's commands; may be repeated"
    add("--twin", action="append", help=twin)
    add_effects(add)
    add("--restart", type=float, default=0.5, help="seconds between the twin's restarts (default 0.5)")
    add("--free", action="store_true", help="let the twin run freely from the start")
    add_topic_map(add)
    add_as_is(add)


def add_yes(add: Add) -> None:
    """The argument that accepts what a mapping leaves in doubt."""
    add("-y", "--yes", action="store_true", help="accept the doubts of a mapping without asking")


def add_as_is(add: Add) -> None:
    """The argument that overrules what looks misread."""
    add("--as-is", action="store_true", help="take columns as they are that look as if in another unit, sign or order")


def add_effects(add: Add) -> None:
    """The argument that adds effects of the user's own."""
    add(
        "--effects", type=Path, action="append", default=[], metavar="FILE",
        help="a Python file with effects of your own, or a name of installed ones, which is run; may be repeated",
    )  # fmt: skip
    add_packages(add)
    add("--trust", action="store_true", help="run the Python files that a twin or checkpoint names too")


def add_packages(add: Add) -> None:
    """The argument that tells where ROS packages are."""
    packages = "where a ROS package is that a URDF names, if ROS does not say; may be repeated"
    add("--package", action="append", default=[], metavar="NAME=DIR", help=packages)


def add_topic_map(add: Add) -> None:
    """The argument that renames topics and fields of other people's bags."""
    add("--topic-map", type=Path, help="YAML that renames topics and fields of other people's bags")


if __name__ == "__main__":
    sys.exit(main())
