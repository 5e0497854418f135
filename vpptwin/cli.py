"""The command line: one entry point and its grammar; what commands do is in `vpptwin.commands`."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from vpptwin import __version__
from vpptwin.commands import (
    run_compare,
    run_diagnose,
    run_effects,
    run_evaluate,
    run_export,
    run_fly,
    run_identify,
    run_layouts,
    run_play,
    run_plot,
    run_train,
)
from vpptwin.errors import InputError


class Parser(argparse.ArgumentParser):
    """A parser that refuses in one line, as every other part of vpptwin does."""

    def error(self, message: str) -> NoReturn:
        """Print what was wrong, what was expected and where to read more; exit with code 2."""
        usage = " ".join(self.format_usage().removeprefix("usage: ").split())
        self.exit(2, f"vpptwin: {message}; expected {usage}; see `{self.prog} --help`\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Returns:
        Exit code: 0, or 2 with one line on stderr for bad input.
    """
    parser = build_parser()
    given = list(sys.argv[1:] if arguments is None else arguments)
    # Hydra's own grammar takes everything after `train`.
    if given[:1] == ["train"]:
        return guard(lambda: run_train(given[1:]))
    options = parser.parse_args(given)
    return guard(lambda: options.run(options))


def guard(action: object) -> int:
    """Run an action; bad input becomes one line on stderr and exit code 2."""
    assert callable(action)
    try:
        action()
    except InputError as error:
        print(f"vpptwin: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        # The reader (head, less) went away; Python would complain again while closing stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        # What no check foresaw: a full disk, a drive that went away.
        where = f"{error.filename}: " if error.filename else ""
        problem = InputError(f"{where}{error.strerror or error}", "a file to read or write", "check path and disk")
        print(f"vpptwin: {problem}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("vpptwin: stopped", file=sys.stderr)
        return 130
    return 0


def build_parser() -> argparse.ArgumentParser:
    """The grammar of all commands."""
    parser = Parser(prog="vpptwin", description="The simulation twin that tells you what it gets wrong.")
    parser.add_argument("--version", action="version", version=f"vpptwin {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    effects = commands.add_parser("effects", help="list the catalogue of effects")
    effects.add_argument("--twin", default="nominal", help="`nominal` or a twin YAML, whose rig's effects are listed")
    add_effects(effects)
    effects.add_argument("--markdown", action="store_true", help="as a Markdown table")
    effects.add_argument("--pictures", metavar="DIR", help="draw what each effect does into this folder")
    effects.set_defaults(run=run_effects)

    diagnose = commands.add_parser("diagnose", help="find what a twin gets wrong, from flight logs")
    add_logs(diagnose)
    diagnose.add_argument("--out", type=Path, required=True, help="folder for verdict.json, report.html and twin.yaml")
    diagnose.add_argument(
        "--json", type=Path, help="write the verdict here as well; - prints it instead of the summary"
    )
    diagnose.set_defaults(run=run_diagnose)

    compare = commands.add_parser("compare", help="measure a twin's prediction error on flight logs")
    add_logs(compare)
    compare.add_argument("--json", type=Path, help="write the figures here as well; - prints them instead")
    compare.set_defaults(run=run_compare)

    play = commands.add_parser("play", help="watch a log in meshcat, the twin beside it")
    play.add_argument(
        "log", type=Path, nargs="*", metavar="LOG", help="an MCAP file, or the split files of one recording"
    )
    add_beside(play)
    play.add_argument("--html", type=Path, help="write one self-contained page instead of opening a server")
    play.add_argument("--video", type=Path, help="write an animation, .gif or .webp, instead of opening a server")
    play.add_argument(
        "--live", type=Path, metavar="CKPT", help="instead of a log, a policy in real time; flip and push it"
    )
    play.set_defaults(run=run_play)

    plot = commands.add_parser("plot", help="draw a log over time, the twin beside it, or training curves")
    plot.add_argument(
        "source", type=Path, nargs="+", metavar="SOURCE", help="a log (or its split files), or folders of training runs"
    )
    add_beside(plot)
    plot.add_argument("--out", type=Path, help="picture, .png or .svg, or interactive page, .html (default SOURCE.png)")
    plot.add_argument("--theme", choices=["light", "dark"], default="light", help="of PNG and page (default light)")
    plot.set_defaults(run=run_plot)

    layouts = commands.add_parser("layouts", help="write layouts of Foxglove and PlotJuggler for our logs")
    layouts.add_argument("folder", type=Path, help="where to write foxglove.json and plotjuggler.xml")
    layouts.set_defaults(run=run_layouts)

    add_fly(commands.add_parser("fly", help="fly a manoeuvre or a policy in a twin and write its log"))

    identify = commands.add_parser("identify", help="fit an actuator to thrust-stand runs, or a twin to flights")
    identify.add_argument(
        "logs", type=Path, nargs="+", metavar="LOG", help="MCAP logs of thrust-stand runs, or flights"
    )
    identify.add_argument("--parameters", metavar="IDS", help="of flights: effects to fit, e.g. air.drag,servo.lag")
    identify.add_argument("--twin", default="nominal", help="of flights: `nominal` (default) or a twin YAML")
    add_effects(identify)
    identify.add_argument(
        "--out", type=Path, required=True, help="actuator YAML to write, a page goes beside it; or twin"
    )
    identify.add_argument("--vehicle", type=Path, help="vehicle YAML that gives governed speed and inner rate")
    add_topic_map(identify)
    identify.set_defaults(run=run_identify)

    train = commands.add_parser("train", help="train a policy with PPO", add_help=False)
    train.set_defaults(run=lambda options: run_train([]))

    export = commands.add_parser("export", help="write a policy and the cascade below it as C99 source, or as ONNX")
    export.add_argument("checkpoint", type=Path, help="a checkpoint, a run's folder or the name of a shipped policy")
    export.add_argument("--format", choices=["c", "onnx"], required=True)
    export.add_argument("--twin", help="whose vehicle the cascade is for (default: that of training)")
    export.add_argument("--out", type=Path, help="folder for C (default NAME_c), file for ONNX (default NAME.onnx)")
    export.set_defaults(run=run_export)

    evaluate = commands.add_parser("evaluate", help="measure a trained policy")
    evaluate.add_argument("checkpoint", type=Path, help="a checkpoint, a run's folder or the name of a shipped policy")
    evaluate.add_argument("--task", help="what to fly (default: the task of training)")
    evaluate.add_argument("--tracks", type=int, default=1000, help="flights (default 1000)")
    evaluate.add_argument("--seed", type=int, default=0, help="of everything random about the flights (default 0)")
    evaluate.add_argument("--twin", default="nominal", help="`nominal` (default) or a twin YAML")
    evaluate.add_argument("--noise", type=float, default=1.0, help="times the noise of vehicle.yaml (default 1)")
    evaluate.add_argument(
        "--randomize", default="paper", metavar="NAMES",
        help="effects drawn from their priors, separated by commas, or paper (default), all, none",
    )  # fmt: skip
    evaluate.add_argument("--thrust-to-weight", type=float, help="rotors of this strength (default: the task's)")
    evaluate.add_argument(
        "--estimator", choices=["sensors", "kalman"], help="what it is shown (default: as in training)"
    )
    add_effects(evaluate)
    evaluate.add_argument("--json", type=Path)
    evaluate.set_defaults(run=run_evaluate)
    return parser


def add_fly(fly: argparse.ArgumentParser) -> None:
    """Arguments of `vpptwin fly`."""
    fly.add_argument("checkpoint", type=Path, nargs="?", help="a checkpoint, a run's folder, or the shipped `flip`")
    fly.add_argument("--policy", type=Path, metavar="FILE", help="instead, an exported controller, .so or .onnx")
    fly.add_argument("--task", help="whose targets the policy flies (default: that of its training)")
    fly.add_argument("--pilot", choices=["scripted", "policy"], help="by default the one that the rest implies")
    fly.add_argument("--manoeuvre", metavar="NAME", help="what the scripted pilot flies; --list shows all")
    fly.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of the manoeuvre")
    fly.add_argument("--list", action="store_true", help="list manoeuvres with their settings, fly nothing")
    fly.add_argument("--twin", default="nominal", help="`nominal` (default) or a twin YAML")
    add_effects(fly)
    fly.add_argument("--controller", choices=["map", "adaptive"], help="of the actuators; by default the twin's own")
    fly.add_argument("--duration", type=float, help="s; by default the manoeuvre's or the task's own")
    fly.add_argument("--seed", type=int, default=0, help="of noise, gusts and a task's targets (default 0)")
    fly.add_argument("--gusts", action="store_true", help="let gusts of 1 %% of the weight blow")
    fly.add_argument("--out", type=Path, help="log to write, MCAP")
    fly.set_defaults(run=run_fly)


def add_logs(parser: argparse.ArgumentParser) -> None:
    """Arguments of commands that compare logs with a twin."""
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="MCAP flight logs, one a flight")
    parser.add_argument("--twin", default="nominal", help="`nominal` (default) or a twin YAML")
    add_effects(parser)
    add_topic_map(parser)


def add_beside(parser: argparse.ArgumentParser) -> None:
    """Arguments of commands that show the twin beside a log."""
    parser.add_argument("--twin", help="`nominal` or a twin YAML, driven by the log's commands")
    add_effects(parser)
    parser.add_argument("--restart", type=float, default=0.5, help="seconds between the twin's restarts (default 0.5)")
    parser.add_argument("--free", action="store_true", help="let the twin run freely from the start")
    add_topic_map(parser)


def add_effects(parser: argparse.ArgumentParser) -> None:
    """The argument that adds effects of the user's own."""
    parser.add_argument(
        "--effects", type=Path, action="append", default=[], metavar="FILE",
        help="a Python file with effects of your own, which is run; may be given several times",
    )  # fmt: skip


def add_topic_map(parser: argparse.ArgumentParser) -> None:
    """The argument that renames topics and fields of other people's bags."""
    parser.add_argument("--topic-map", type=Path, help="YAML that renames topics and fields of other people's bags")


if __name__ == "__main__":
    sys.exit(main())
