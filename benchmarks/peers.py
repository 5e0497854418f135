"""How fast the same rig flies in other simulators: `python benchmarks/peers.py [--quick] [--json out.json]`.

Everything runs in one process tree on the same machine in interleaved rounds; a row is the median of its rounds. A
simulator is timed only if it first flies like the twin.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from same_rig.report import describe_machine, format_table
from same_rig.rig import FRICTION, SUBSTEPS, draw_actions, write_rig
from same_rig.simulator import SIMULATORS, Simulator, find_simulator

from vpptwin.robots.planar_drone.vehicle import Vehicle, load_vehicle

CHECK_STEPS = 20
"""Control steps of the flight that is compared, 0.2 s: long enough for an error of 10 % in any number to show."""
POSITION_TOLERANCE = 5e-4
"""Largest difference in x and z from the twin [m].

MuJoCo's dry friction is a soft constraint, the twin's is exact. With solreffriction 4 ms MuJoCo reaches the full force
F only above a speed of 2 ms F/m = 1.2 mm/s and creeps below it. Coming to rest and starting again a slider may so be
1.2 mm/s off, each, over 0.2 s 0.5 mm. An error of 10 % in friction moves the craft by 1.2 mm, in mass by 18 mm.
"""
ANGLE_TOLERANCE = 2e-5
"""Largest difference in θ [rad]. Rails push at the craft's centre of mass and don't turn it, so only rounding is left:
200 additions to an angle below 1 rad in float32, which MJX computes in, at 6e-8 each."""
ENVS = {"gymnasium": 8, "torchrl-serial": 8, "torchrl-parallel": 2, "mjx": 1024}
"""Rigs where not `--envs`: what served each best on two cores; those with a process per rig get slower with more."""
QUICK_ENVS = {"gymnasium": 2, "torchrl-serial": 2, "torchrl-parallel": 2, "mjx": 16}


def compare_flight(simulator: Simulator, actions: np.ndarray, expected: np.ndarray) -> tuple[float, float]:
    """Largest differences from positions expected after every step, over all rigs: of x and z [m], of θ [rad]."""
    simulator.start()
    error = np.zeros(3)
    for action, position in zip(actions, expected, strict=True):
        simulator.step(np.tile(action, (simulator.envs, 1)))
        error = np.maximum(error, np.abs(simulator.positions() - position).max(axis=0))
    return float(error[:2].max()), float(error[2])


def agrees(position_error: float, angle_error: float) -> bool:
    """Whether these differences [m], [rad] are within tolerance; not when one is not a number."""
    return position_error <= POSITION_TOLERANCE and angle_error <= ANGLE_TOLERANCE


def time_round(simulator: Simulator, actions: np.ndarray, steps: int, seconds: float) -> float:
    """Control steps a second, over at least `steps` steps of all rigs and at least `seconds`."""
    done, start = 0, time.perf_counter()
    while done < steps or time.perf_counter() - start < seconds:
        simulator.step(actions[done % len(actions)])
        done += 1
    return done * simulator.envs / (time.perf_counter() - start)


def prepare(
    names: Sequence[str], envs: dict[str, int], rig: Path, vehicle: Vehicle, seed: int, stack: ExitStack
) -> tuple[dict[str, Simulator], list[dict]]:
    """Build and check every simulator: those to be timed, and a row for each with what is known so far."""
    from same_rig.vpptwin_env import fly_twin  # here, as worker processes import this file and need no torch

    flight = draw_actions(vehicle, seed, CHECK_STEPS)
    expected = fly_twin(flight)
    ready: dict[str, Simulator] = {}
    rows = []
    for name in names:
        row: dict = {"name": name, "title": name, "environments": envs[name], "skipped": None, "agrees": None}
        rows.append(row)
        try:
            cls = find_simulator(name)
        except ImportError as error:
            row["skipped"] = f"{error}"
            continue
        print(f"{cls.title}: {envs[name]} rigs ...", file=sys.stderr, flush=True)
        simulator = cls(rig, vehicle, envs[name], seed)
        stack.callback(simulator.close)
        row |= {"title": cls.title, "workers": simulator.workers, "leaves_out": cls.leaves_out}
        if cls.controlled:
            position, angle = compare_flight(simulator, flight, expected)
            row |= {"position_error_m": position, "angle_error_rad": angle, "agrees": agrees(position, angle)}
            if not row["agrees"]:
                row["skipped"] = (
                    f"flies differently: {1e3 * position:.2g} mm and {angle:.1e} rad from the twin in 0.2 s"
                )
                continue
        ready[name] = simulator
    return ready, rows


def run_rounds(ready: dict[str, Simulator], rows: list[dict], vehicle: Vehicle, args: argparse.Namespace) -> None:
    """Time the simulators in interleaved rounds and write the medians into their rows."""
    actions = {name: draw_actions(vehicle, args.seed + 1, 16, s.envs) for name, s in ready.items()}
    rates: dict[str, list[float]] = {name: [] for name in ready}
    for _ in range(args.rounds):
        for name, simulator in ready.items():
            rates[name].append(time_round(simulator, actions[name], args.steps, args.seconds))
    for row in rows:
        if not (own := rates.get(row["name"])):
            continue
        rate = statistics.median(own)
        row |= {"control_steps_per_s": rate, "us_per_physics_step": 1e6 / (SUBSTEPS * rate), "rounds": own}
        if raw := rates.get("raw"):
            row["ratio_to_raw"] = statistics.median(a / b for a, b in zip(own, raw, strict=True))


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--envs", type=int, help="rigs of raw and vpptwin, 4096 by default; the others have their own")
    parser.add_argument("--steps", type=int, default=5, help="control steps of all rigs in a round, at least")
    parser.add_argument("--seconds", type=float, help="length of a round, at least; 1 by default")
    parser.add_argument("--rounds", type=int, help="interleaved rounds; 5 by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--without", nargs="*", default=[], choices=SIMULATORS, metavar="NAME", help="leave these out")
    parser.add_argument("--quick", action="store_true", help="a few rigs, two rounds of a tenth of a second")
    parser.add_argument("--json", type=Path, help="write the results here")
    args = parser.parse_args(argv)
    args.rounds = args.rounds or (2 if args.quick else 5)
    args.seconds = args.seconds or (0.1 if args.quick else 1.0)
    args.envs = args.envs or (16 if args.quick else 4096)
    return args


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmark; 1 if a simulator flies differently, else 0."""
    args = parse(argv)
    vehicle, circumstances = load_vehicle(), describe_machine()  # before this process adds to the load
    names = [name for name in SIMULATORS if name not in args.without]
    envs = dict.fromkeys(SIMULATORS, args.envs) | (QUICK_ENVS if args.quick else ENVS)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        rig = write_rig(Path(folder) / "rig.xml")
        ready, rows = prepare(names, envs, rig, vehicle, args.seed, stack)
        run_rounds(ready, rows, vehicle, args)
    print(format_table(rows))
    machine = circumstances["machine"]
    print(f"\n{machine['cpu']}, {machine['cores']} cores; load average before the start {machine['load_average']:.1f}")
    if args.json:
        tolerance = {"position_m": POSITION_TOLERANCE, "angle_rad": ANGLE_TOLERANCE, "after_s": CHECK_STEPS / 100}
        result = circumstances | {
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "seed": args.seed, "rounds": args.rounds, "seconds": args.seconds, "friction_n": FRICTION,
            "tolerance": tolerance, "rows": rows,
        }  # fmt: skip
        args.json.write_text(json.dumps(result, indent=1) + "\n")
    return 1 if any(row["agrees"] is False for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
