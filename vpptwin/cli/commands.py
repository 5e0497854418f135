"""What each command does: thin functions of parsed options. Heavy packages load only where they are used."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from vpptwin.system.errors import InputError
from vpptwin.system.files import STDOUT, check_own, check_target, without_nan

if TYPE_CHECKING:
    from vpptwin.robots.planar_drone.pilot.flight import Pilot
    from vpptwin.train.evaluate.live import LiveFlight


def run_demo(options: argparse.Namespace) -> None:
    """`vpptwin demo`."""
    from vpptwin.cli.demo import show_arm, show_demo

    show = show_arm if options.robot == "so101" else show_demo
    show(options.out or Path("out") / (options.robot or "demo"), options.force)


def run_effects(options: argparse.Namespace) -> None:
    """`vpptwin effects`."""
    from vpptwin.effects.table import print_catalogue
    from vpptwin.twin.spec import load_twin

    spec = load_twin(options.twin, options.effects)
    if options.pictures:
        from vpptwin.robots.planar_drone.display.fingerprint import draw_catalogue

        files = draw_catalogue(spec, Path(options.pictures), options.force)
        print(f"{len(files)} pictures in {options.pictures}")
        return
    print_catalogue(spec.catalogue, options.markdown, spec.robot.pictures)


def run_diagnose(options: argparse.Namespace) -> int:
    """`vpptwin diagnose`."""
    from vpptwin.report.command import diagnose_logs
    from vpptwin.system.deadline import Deadline, read_limit

    deadline = Deadline(None if options.limit is None else read_limit(options.limit))
    only = [name for text in options.only for name in text.split(",") if name]
    given = (options.logs, choose_twin(options, [options.twin])[0], options.out, options.topic_map, options.json)
    without = [name for text in options.without for name in text.split(",") if name]
    chosen = (only, deadline, without, options.fix, options.revised)
    diagnose_logs(*given, options.effects, options.force, options.rrd, options.device, *chosen)
    return deadline.code


def run_compare(options: argparse.Namespace) -> None:
    """`vpptwin compare`."""
    from vpptwin.report.compare import compare_logs

    twins = choose_twin(options, options.twin or ["nominal"])
    compare_logs(options.logs, twins, options.json, options.topic_map, options.effects)


def run_history(options: argparse.Namespace) -> int:
    """`vpptwin history`."""
    from vpptwin.drift.history import follow_logs
    from vpptwin.system.jobs import read_jobs

    jobs, (twin, *_) = read_jobs(options.jobs), choose_twin(options, [options.twin])
    given = (options.parameters, options.band, jobs, options.topic_map, options.json, options.effects, options.force)
    return follow_logs(options.logs, twin, options.out, *given)


def choose_twin(options: argparse.Namespace, twins: Sequence[str]) -> Sequence[str]:
    """The twins that are named, or one made for a model."""
    if options.model is None:
        return twins
    if list(twins) != ["nominal"]:
        raise InputError(f"--twin {twins[0]} and --model {options.model}", "one of them", "leave one out")
    from vpptwin.mapping.inspect import make_twin

    return [str(make_twin(options.logs, options.model, options.yes))]


def run_play(options: argparse.Namespace) -> None:
    """`vpptwin play`."""
    from vpptwin.viz.command import LogSource, play_log

    elsewhere = {"--live": options.live, "--html": options.html, "--video": options.video}
    other = next((name for name, value in elsewhere.items() if value is not None), None)
    if options.viewer == "mujoco" and other is not None:
        raise InputError(f"--viewer mujoco and {other} {elsewhere[other]}", "one of them", "leave one out")
    if options.live is None:
        restart = None if options.free else options.restart
        first, *others = options.twin or [None]
        source = LogSource(options.log, first, restart, options.topic_map, options.effects)
        play_log(source, options.html, options.video, options.host, options.viewer == "mujoco", options.port, others)
        return
    if options.log:
        raise InputError(f"{options.log[0]} and --live {options.live}", "a log or a policy", "leave one out")
    from vpptwin.train.stored import need_checkpoint

    need_checkpoint(options.live)
    from vpptwin.robots.planar_drone.display.live import fly_live

    if find_spec("torch") is None:  # told before a page opens
        raise ModuleNotFoundError("torch", name="torch")
    fly_live(partial(begin_live, options.live), options.host, options.port)


def begin_live(checkpoint: Path) -> LiveFlight:
    """A policy that flies, once torch is loaded."""
    from vpptwin.train.evaluate.live import LiveFlight

    return LiveFlight(checkpoint)


def run_plot(options: argparse.Namespace) -> None:
    """`vpptwin plot`."""
    from vpptwin.logs.spelling import expand, stem_log
    from vpptwin.viz.command import LogSource, plot

    restart = None if options.free else options.restart
    out = options.out or Path(f"{stem_log(expand(options.source[0])[0])}.png")
    if not options.force:
        check_own([out])
    check_target(out)
    first, *others = options.twin or [None]
    source = LogSource(options.source, first, restart, options.topic_map, options.effects)
    plot(source, out, options.theme, others)


def run_convert(options: argparse.Namespace) -> None:
    """`vpptwin convert`."""
    from vpptwin.logs.transcribe import list_kept, transcribe

    if not options.force:
        check_own([options.out])
    recording = transcribe(options.log, options.out)
    for note in (note for file in recording.files for note in file.notes):
        print(note, file=sys.stderr)
    kept = list_kept(recording)
    print(f"{options.out}: {sum(channel.count for channel in kept)} messages on {len(kept)} topics")


def run_inspect(options: argparse.Namespace) -> None:
    """`vpptwin inspect`."""
    from vpptwin.mapping.inspect import inspect_logs

    inspect_logs(options.logs, options.model, options.out, options.force, options.yes)


def run_layouts(options: argparse.Namespace) -> None:
    """`vpptwin layouts`."""
    from vpptwin.viz.layouts import write_layouts

    for file in write_layouts(options.out, options.force):
        print(file)


def run_identify(options: argparse.Namespace) -> None:
    """`vpptwin identify`."""
    if options.parameters is not None:
        from vpptwin.drift.identify import identify_flights

        given = (options.logs, options.parameters, options.twin, options.out, options.topic_map, options.effects)
        identify_flights(*given)
        return
    from vpptwin.robots.planar_drone.thrust_stand.command import identify_bench

    identify_bench(options.logs, options.out, options.topic_map, options.vehicle, options.force)


def run_fly(options: argparse.Namespace) -> None:
    """`vpptwin fly`."""
    from vpptwin.robots.planar_drone.display.markers import describe_flight
    from vpptwin.robots.planar_drone.pilot.command import Sortie, check_out, fly_log, print_library
    from vpptwin.twin.spec import load_twin

    if options.list:
        print_library()
        return
    scripted = check_pilot(options)
    if options.seed < 0:
        raise InputError(f"--seed {options.seed}", "a number from 0 on", "choose another")
    spec = load_twin(options.twin, options.effects)
    vehicle, out = spec.vehicle, check_out(options.out)
    if options.controller is not None:
        spec = spec.with_controller(options.controller)
    pilot: Pilot
    if scripted:
        from vpptwin.robots.planar_drone.pilot.library import LIBRARY
        from vpptwin.robots.planar_drone.pilot.manoeuvre import find_manoeuvre, parse_settings
        from vpptwin.robots.planar_drone.pilot.scripted import ScriptedPilot

        manoeuvre, given = find_manoeuvre(LIBRARY, options.manoeuvre), parse_settings(options.set)
        pilot = ScriptedPilot(vehicle, [manoeuvre.plan(vehicle, given, options.duration)])
        chosen = " ".join(f"{name}={value:g}" for name, value in manoeuvre.choose(given).items())
        about = {"manoeuvre": manoeuvre.name, "settings": chosen}
    elif options.policy is not None:
        from vpptwin.deploy.load import load_exported_pilot

        pilot, spec = load_exported_pilot(options.policy, options.task, spec, options.duration, options.seed)
        about = {"policy": str(options.policy), "task": pilot.task}
    else:
        from vpptwin.train.evaluate.pilot import load_pilot

        pilot, spec = load_pilot(options.checkpoint, options.task, spec, options.duration, options.seed)
        about = {"policy": str(options.checkpoint), "task": pilot.task}
    fly_log(pilot, Sortie(spec, out, options.seed, options.gusts, about, describe_flight))


def check_pilot(options: argparse.Namespace) -> bool:
    """Whether the scripted pilot flies; refuse options that do not go together."""
    policy = options.checkpoint or options.policy
    if options.checkpoint is not None and options.policy is not None:
        raise InputError(f"{options.checkpoint} and --policy {options.policy}", "one of them", "leave one out")
    scripted = options.pilot == "scripted" or (options.pilot is None and policy is None)
    wrong = {"a checkpoint": policy, "--task": options.task}
    if not scripted:
        wrong = {"--manoeuvre": options.manoeuvre, "--set": options.set}
    given = [name for name, value in wrong.items() if value]
    who = "scripted pilot" if scripted else "policy"
    if given:
        raise InputError(f"{given[0]} for the {who}", "a checkpoint, or --manoeuvre NAME", "leave one out")
    if (options.manoeuvre if scripted else policy) is None:
        missing = "--manoeuvre" if scripted else "checkpoint"
        raise InputError(f"no {missing} for the {who}", "--manoeuvre NAME, or a checkpoint", "see `vpptwin fly --list`")
    return scripted


def run_export(options: argparse.Namespace) -> None:
    """`vpptwin export`."""
    from vpptwin.deploy.command import TWINS, export, export_twin

    if options.format in TWINS:
        if options.twin is not None:
            raise InputError(f"--twin {options.twin} for --format {options.format}", "the twin alone", "leave it out")
        file, lines = export_twin(str(options.source), options.format, options.out, options.effects, options.force)
        print("\n".join([*lines, str(file)]))
        return
    for file in export(options.source, options.format, options.out, options.twin, options.force):
        print(file)


def run_train(overrides: Sequence[str]) -> None:
    """`vpptwin train`."""
    from vpptwin.train.main import run_train as train

    print(train(list(overrides)))


def run_evaluate(options: argparse.Namespace) -> None:
    """`vpptwin evaluate`."""
    from vpptwin.train.stored import need_checkpoint

    need_checkpoint(options.checkpoint)
    from vpptwin.train.evaluate.evaluate import Conditions, describe
    from vpptwin.train.evaluate.evaluate import run_evaluate as evaluate

    names = [name for name in options.randomize.split(",") if name not in ("", "none")]
    conditions = Conditions(
        options.task, options.tracks, options.seed, options.twin, options.noise, names, options.thrust_to_weight,
        [str(file) for file in options.effects], options.estimator,
    )  # fmt: skip
    aside = None if options.json == STDOUT else options.json
    result = evaluate(options.checkpoint, conditions, aside)
    print(json.dumps(without_nan(result), indent=2) if options.json == STDOUT else describe(result))
