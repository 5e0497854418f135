"""How a trained policy flies in the independent simulation, which it was not trained in.

    python benchmarks/policy_in_reality.py flip --flights 200 --seed 1 --json flip.json
    python benchmarks/policy_in_reality.py runs/flip --effects none --no-gusts --flights 50
    python benchmarks/policy_in_reality.py flip --effects worn --controller own map adaptive
    python benchmarks/policy_in_reality.py wall-backtrack --thrust-to-weight 2.0
    python benchmarks/policy_in_reality.py wall-backtrack --flights 1 --log wall.mcap      (a flight to look at)

Wide random initial states and targets as the task draws them; hidden in every flight all the effects that training
randomizes by default, drawn from the central 95 % of their priors (with `--effects worn` besides actuators with
0.02 rad of play, up to 0.02 rad off in trim and 20 % in drag, as on the thrust stand); gusts, sensor noise, dropouts,
a mocap that is 8 to 17 ms late, the rig off nominal within its tolerance (proving/drone, which shares no physics with
vpptwin, nor the state estimate or the observation; unless `--controller` has vpptwin's firmware fly there). Several
controllers fly the same flights, a column each.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import torch  # noqa: E402
from same_rig.report import describe_machine  # noqa: E402
from tqdm import tqdm  # noqa: E402

from proving.drone import write_mcap  # noqa: E402
from proving.policy_flights import Sky, fly_assignments, load_flyer, measure, summarise  # noqa: E402
from proving.runner.rates import Rate  # noqa: E402
from vpptwin.robots.planar_drone.vehicle import load_vehicle  # noqa: E402
from vpptwin.system.errors import InputError  # noqa: E402
from vpptwin.system.files import check_target, write_whole  # noqa: E402
from vpptwin.train.env.randomize import PAPER_EFFECTS  # noqa: E402
from vpptwin.train.env.tasks import TASKS  # noqa: E402
from vpptwin.train.evaluate.evaluate import arm  # noqa: E402
from vpptwin.train.learn.checkpoint import read_checkpoint  # noqa: E402

EFFECTS = {"none": (), "paper": PAPER_EFFECTS, "worn": PAPER_EFFECTS}
"""What is hidden in every flight."""
HIDDEN = {
    "none": "nothing hidden",
    "paper": "its randomized effects hidden",
    "worn": "its randomized effects hidden, actuators worn",
}
CONTROLLERS = {"own": "its own firmware", "map": "vpptwin's firmware", "adaptive": "vpptwin's adaptive firmware"}
"""Of the actuators."""


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", help="file, folder of a run, or name of a shipped policy")
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1, help="flight i is the same for any --flights")
    parser.add_argument("--task", choices=list(TASKS), help="by default that of training")
    parser.add_argument("--effects", choices=list(EFFECTS), default="paper", help="hidden in every flight")
    parser.add_argument("--controller", choices=CONTROLLERS, nargs="+", default=["own"], help="of the actuators")
    parser.add_argument(
        "--thrust-to-weight", type=float, help="of the rotors, commanded as trained (default: the task's)"
    )
    parser.add_argument("--no-gusts", dest="gusts", action="store_false")
    parser.add_argument("--no-dropouts", dest="dropouts", action="store_false")
    parser.add_argument("--json", type=Path, help="write the results and every flight here")
    parser.add_argument("--log", type=Path, help="write the first flight here, MCAP")
    return parser.parse_args(argv)


def run(options: argparse.Namespace, controller: str) -> dict:
    """Fly; results and where they come from, as plain data."""
    content = read_checkpoint(options.checkpoint)
    policy, task = load_flyer(options.checkpoint, options.task)
    if options.thrust_to_weight is not None:
        task = arm(task, options.thrust_to_weight, load_vehicle())
    sky = Sky(
        EFFECTS[options.effects],
        gusts=options.gusts,
        dropouts=options.dropouts,
        worn=options.effects == "worn",
        controller=controller,
    )
    if options.log:
        _, recording = next(fly_assignments(policy, task, sky, 1, options.seed))
        write_mcap(recording, options.log)
    bar = tqdm(total=options.flights, unit="flight", desc=task.name)
    with bar:
        outcomes = measure(policy, task, sky, options.flights, options.seed, tell=lambda _: bar.update())
    return {
        "task": task.name, "hidden": options.effects, "gusts": options.gusts, "dropouts": options.dropouts,
        "controller": controller, "thrust_to_weight": task.thrust_to_weight,
        "seed": options.seed, "window_s": task.success.window, "success_distance_m": task.success.position,
        "success_angle_rad": task.success.angle, "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "checkpoint": {"path": options.checkpoint, "steps": content["steps"], "commit": content["commit"]},
        **describe_machine(), **summarise(outcomes),
    }  # fmt: skip


def list_cells(result: dict) -> dict[str, str]:
    """What became of the flights under one controller, in words and numbers."""
    flights, turns = result["flights"], result["full_turns"]
    success, failed = (Rate("", round(result[key] * flights), flights) for key in ("success_share", "fail_rate"))
    goal = f"within {100 * result['success_distance_m']:.0f} cm and {result['success_angle_rad']:g} rad at the end"
    return {
        f"success: {goal}": f"{success.text}, 95 % interval {success.spread}",
        "failed: floor, end of travel or speed limit": failed.text,
        "full turns": f"{turns['made']} of {turns['asked']}",
        "position error upright, median / mean / worst [mm]": show(result["upright_error_m"]),
        "position error inverted": show(result["inverted_error_m"]),
        "angle error [mrad]": show(result["angle_error_rad"]),
    }  # fmt: skip


def format_table(results: list[dict]) -> str:
    """The results as Markdown, a column for each, and below them where they come from."""
    result, columns = results[0], [list_cells(result) for result in results]
    calm = "" if result["gusts"] else ", no gusts"
    ratio = f" at thrust-to-weight {result['thrust_to_weight']:g}" if result["thrust_to_weight"] else ""
    head = f"| {result['task']}{ratio}, {result['flights']} flights, {HIDDEN[result['hidden']]}{calm}"
    lines = [
        " | ".join([head, *(CONTROLLERS[r["controller"]] for r in results)]) + " |",
        "|---" + "|---:" * len(results) + "|",
    ]
    lines += [" | ".join([f"| {name}", *(cells[name] for cells in columns)]) + " |" for name in columns[0]]
    checkpoint, machine = result["checkpoint"], result["machine"]
    return "\n".join([
        *lines, "",
        f"Errors: mean over the last {result['window_s']:g} s, of flights that did not fail. Seed {result['seed']}, "
        f"commit {str(result['commit'])[:7]}, {machine['cores']} cores of {machine['cpu']}; {checkpoint['path']}: "
        f"{checkpoint['steps']:,} steps, commit {checkpoint['commit'][:7]}.",
    ])  # fmt: skip


def show(errors: dict[str, float | None]) -> str:
    """Median, mean and worst in thousandths."""
    known = [value for value in errors.values() if value is not None]
    return " / ".join(f"{1e3 * value:.1f}" for value in known) if known else "none left"


def main(argv: Sequence[str] | None = None) -> int:
    """Fly and report; 2 for bad input."""
    options = parse(argv)
    torch.set_num_threads(1)  # a policy is too small to share
    try:
        for path in (options.json, options.log):
            if path:
                check_target(path, json=True)
        results = [run(options, controller) for controller in options.controller]
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    if options.json:
        write_whole(options.json, json.dumps(results[0] if len(results) == 1 else results) + "\n")
    print(format_table(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
