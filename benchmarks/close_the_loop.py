"""The loop closed: train on the nominal twin, fly elsewhere, diagnose what the twin lacks, train on that, fly again.

    python benchmarks/close_the_loop.py --seed 0 --json loop_0.json
    python benchmarks/close_the_loop.py --report benchmarks/results/close_the_loop_*.json --picture loop.svg
    python benchmarks/close_the_loop.py --stuck flip --json stuck.json

For each of three rigs of the independent simulation (proving/drone, which shares no physics with vpptwin) with effects
hidden in it: (1) a policy is trained on the nominal twin, (2) exported to C and flown there, (3) two such flights are
diagnosed, and again with the manoeuvre that the first diagnosis suggests if it does, (4) a policy is trained on the
extended twin, its effects drawn from the identified intervals, (5) it flies. Beside it fly the nominal one, the same
under the adaptive controller of actuators, one with the paper's randomization, and an oracle trained on a twin of the
truth, all by the same recipe and seed. What the twin at hand predicts of the same flights (its own engine, filter,
gusts and noise) is compared with what was flown.

With --stuck a policy that is there, such as the one that ships, flies on a rig whose slider sticks and jams, which the
paper blames for its steady-state errors; besides it only that of the extended twin is trained and flown.

Everything is kept in --folder: an interrupted run goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from multiprocessing import get_context
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import torch  # noqa: E402
from loop.report import draw_picture, format_table  # noqa: E402
from loop.settings import SETTINGS, STUCK, Rig, draw_rig  # noqa: E402
from loop.steps import (  # noqa: E402
    COMPILE,
    Budget,
    adopt,
    diagnose,
    export,
    measure,
    read_verdict,
    train,
    write_truth,
)
from same_rig.report import describe_machine  # noqa: E402
from threadpoolctl import threadpool_limits  # noqa: E402
from tqdm import tqdm  # noqa: E402

from vpptwin.system.errors import InputError  # noqa: E402
from vpptwin.system.files import check_target, write_whole  # noqa: E402


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="of training, rigs and flights")
    parser.add_argument("--stuck", metavar="POLICY", help="one rig that sticks, flown by a policy that is there")
    parser.add_argument("--steps", type=int, default=Budget.steps, help="policy steps of every training")
    parser.add_argument("--flights", type=int, default=Budget.flights, help="of every policy on every rig")
    parser.add_argument("--jobs", type=int, default=2, help="processes side by side")
    parser.add_argument("--folder", type=Path, default=Path("runs/close_the_loop"), help="where everything is kept")
    parser.add_argument("--json", type=Path, help="write the results here")
    parser.add_argument("--report", type=Path, nargs="+", metavar="FILE", help="run nothing, report these results")
    parser.add_argument("--picture", type=Path, help="draw what came out, SVG")
    return parser.parse_args(argv)


def work(function: Callable[..., object], arguments: tuple[object, ...]) -> object:
    """One task of a worker, on one core."""
    torch.set_num_threads(1)
    with threadpool_limits(limits=1):
        return function(*arguments)


def side_by_side(tasks: Iterable[tuple[Any, ...]], jobs: int, title: str) -> list[Any]:
    """Results of (function, argument, ...) tasks, in their order."""
    given = list(tasks)
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool, tqdm(total=len(given), desc=title) as bar:
        futures = [pool.submit(work, task[0], task[1:]) for task in given]
        for future in futures:
            future.add_done_callback(lambda _: bar.update())
        return [future.result() for future in futures]


def run(args: argparse.Namespace) -> list[dict[str, Any]]:
    """The loop of one seed: a result for every rig."""
    seed, home = args.seed, (args.folder / f"seed_{args.seed}").resolve()
    budget = Budget(args.steps, args.flights, max((os.cpu_count() or 1) // args.jobs, 1))
    rigs = [draw_rig(setting, seed) for setting in ((STUCK,) if args.stuck else SETTINGS)]
    homes = [home / rig.setting.name for rig in rigs]
    for folder in homes:
        folder.mkdir(parents=True, exist_ok=True)
    given = (seed, budget)
    if args.stuck:
        runs = {"nominal": adopt(args.stuck, home / "stuck" / "given")}
    else:
        tasks: list[tuple[Any, ...]] = [
            (train, home / "nominal", "nominal", "[]", *given),
            (train, home / "randomized", "nominal", "paper", *given),
        ]
        nominal, randomized = side_by_side(tasks, args.jobs, "train")
        runs = {"nominal": nominal, "adaptive": nominal, "randomized": randomized}
    nominal = runs["nominal"]
    export(nominal)
    found = side_by_side([(diagnose, h, nominal, rig, seed) for h, rig in zip(homes, rigs)], args.jobs, "diagnose")
    tasks = []
    for h, rig, folder in zip(homes, rigs, found):
        named = "identified" if read_verdict(folder)["causes"] else "[]"
        tasks.append((train, h / "extended", folder / "twin.yaml", named, *given))
        if not args.stuck:
            tasks.append((train, h / "oracle", write_truth(rig, h / "truth.yaml"), "[]", *given))
    side_by_side(tasks, args.jobs, "train again")
    own = [name for name in ("extended", "oracle") if (homes[0] / name).exists()]
    flying: list[tuple[Any, ...]] = []
    for h, rig, folder in zip(homes, rigs, found):
        twins = {"extended": folder / "twin.yaml", "oracle": h / "truth.yaml"}
        for name, flown_run in (runs | {name: h / name for name in own}).items():
            export(flown_run)
            craft = replace(rig, controller="adaptive" if name == "adaptive" else "own")
            twin = twins.get(name, "nominal")
            flying.append((measure, h / f"{name}.json", flown_run, craft, twin, seed, budget.flights))
    flown = iter(side_by_side(flying, args.jobs, "fly"))
    names = [*runs, *own]
    return [
        describe(rig, read_verdict(folder), {name: next(flown) for name in names}, seed)
        for rig, folder in zip(rigs, found)
    ]


def describe(rig: Rig, verdict: dict[str, Any], flown: dict[str, dict[str, Any]], seed: int) -> dict[str, Any]:
    """The result of one rig as plain data; of single flights only whether they were lost and their errors."""
    for result in flown.values():
        for part in ("flown", "predicted"):
            each = result[part].pop("each")
            result[part]["failed"] = [int(f["failed"]) for f in each]
            result[part]["position_error"] = [round(f["position_error"], 5) for f in each]
    return {
        "setting": rig.setting.name, "title": rig.setting.title, "seed": seed, "hidden": rig.hidden,
        "session": rig.session, "diagnosis": verdict, "policies": flown,
    }  # fmt: skip


def check_tools(args: argparse.Namespace) -> None:
    """Refuse before an hour of work what would fail after it.

    Raises:
        InputError: if there is no compiler for the exported policies, or results cannot be written.
    """
    if shutil.which(COMPILE[0]) is None:
        raise InputError(f"no {COMPILE[0]}", "a C compiler for the exported policies", "apt install gcc libc6-dev")
    if args.json:
        check_target(args.json, json=True)


def read_rigs(path: Path) -> list[dict[str, Any]]:
    """Results that an earlier run wrote.

    Raises:
        InputError: if the file holds none.
    """
    try:
        rigs: list[dict[str, Any]] = json.loads(path.read_text())["rigs"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        found = f"{path}: no results ({type(error).__name__})"
        raise InputError(found, "a file that --json wrote", "run the loop first") from error
    return rigs


def main(argv: Sequence[str] | None = None) -> int:
    """Run the loop, or report on earlier ones."""
    args = parse(argv)
    try:
        if not args.report:
            check_tools(args)
        rigs = [rig for file in args.report for rig in read_rigs(file)] if args.report else run(args)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    if not args.report:
        about = {
            "date": datetime.now(UTC).isoformat(timespec="seconds"), "steps": args.steps,
            "flights": args.flights, **describe_machine(),
        }  # fmt: skip
        if args.json:
            write_whole(args.json, json.dumps(about | {"rigs": rigs}) + "\n")
    print(format_table(rigs))
    if args.picture:
        print(draw_picture(rigs, args.picture))
    return 0


if __name__ == "__main__":
    sys.exit(main())
