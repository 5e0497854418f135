"""How long a diagnosis takes, how much memory, and how much of that is the twin's steps.

    python benchmarks/diagnosis_time.py
    python benchmarks/diagnosis_time.py --rigs arm --profile --json time.json

A minute of logs or so, one effect hidden, of each of the proving grounds without MuJoCo: the drone (three flights of
16 s), a quadrotor (five of 12 s, 2 ms steps) and arms of six joints (three logs of 20 s at 100 Hz, 1 ms steps), of
which `--arms` are drawn. Every diagnosis is a process of its own, which compiles what is missing before its clock
starts.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402
from same_rig.report import describe_machine  # noqa: E402

from proving.logs import write_log  # noqa: E402
from proving.mechanisms.session import draw_session  # noqa: E402
from proving.runner.costs import format_costs, profile_diagnosis  # noqa: E402
from proving.runner.crafts import GROUNDS  # noqa: E402
from proving.runner.draw import draw_plans  # noqa: E402
from proving.runner.session import fly_sessions  # noqa: E402
from vpptwin.diagnosis.judgement.diagnose import diagnose  # noqa: E402
from vpptwin.logs.read import read_flight  # noqa: E402
from vpptwin.system.files import write_json  # noqa: E402
from vpptwin.twin import Twin, load_twin  # noqa: E402

MINUTE = 60.0
"""How long logs of a quadrotor and of an arm are together [s]."""


def record_drone(seed: int, folder: Path) -> Path | None:
    """The first session of the seed that hides one effect; three flights."""
    plan = next(draw_plans(seed, kinds=["single"]))
    fly_sessions([plan], folder)
    return None


def record_quadrotor(seed: int, folder: Path) -> Path:
    """Five flights of a quadrotor whose first motor is weak."""
    craft = GROUNDS["quadrotor"]
    for i in range(5):
        write_log(craft.fly({"m1.gain": {"gain": 0.9}}, MINUTE / 5, 10 * seed + i), folder / f"log_{i}.mcap")
    return craft.write_twin(folder)


def record_arm(seed: int, folder: Path) -> Path:
    """Three logs of the seed's first arm that hides one effect."""
    drawn = (draw_session(seed, number) for number in range(1000))
    session = next(s for s in drawn if s.family == "arm" and s.kind == "single")
    motion = session.motions[0]
    motions = tuple(replace(motion, duration=MINUTE / 3, seed=motion.seed + i) for i in range(3))
    return replace(session, motions=motions, rate=100).record(folder).twin


RECORD: dict[str, Callable[[int, Path], Path | None]] = {
    "drone": record_drone, "quadrotor": record_quadrotor, "arm": record_arm,
}  # fmt: skip


def watch_steps() -> list[float]:
    """Have twins count: inner steps of all simulations, and seconds spent in them."""
    counted, run = [0.0, 0.0], Twin._run

    def timed(self: Twin, state: Any, steps: int, *rest: Any, **named: Any) -> None:  # noqa: ANN401
        begun = time.perf_counter()
        run(self, state, steps, *rest, **named)
        counted[0] += steps * self.num_sims
        counted[1] += time.perf_counter() - begun

    Twin._run = timed  # type: ignore[method-assign]
    return counted


def measure(folder: Path, twin: Path | None, profile: bool) -> dict[str, Any]:
    """One diagnosis in this process."""
    logs = sorted(folder.rglob("*.mcap"))
    spec = load_twin(twin) if twin else load_twin()
    flights = [read_flight(log) for log in logs]
    ready = Twin(spec, 2)
    ready.replay_commands(ready.initial_state(), np.zeros((2, 1, spec.model.nu)))  # compiles
    counted, begun, worked = watch_steps(), time.perf_counter(), time.process_time()
    verdict = diagnose(spec, flights).verdict
    wall = time.perf_counter() - begun
    told = {
        "seconds": wall, "processor_seconds": time.process_time() - worked,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "steps": counted[0], "share_of_steps": counted[1] / wall,
        "causes": {cause.effect: cause.confidence for cause in verdict.causes},
    }  # fmt: skip
    return told | ({"stages": profile_diagnosis(spec, flights)} if profile else {})


def main(argv: Sequence[str] | None = None) -> None:
    """Record, diagnose and tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", nargs="+", choices=list(RECORD), default=list(RECORD), help="all by default")
    parser.add_argument("--arms", type=int, default=3, help="arms drawn, by seeds that follow each other")
    parser.add_argument("--seed", type=int, default=1, help="of rigs, motions and noise")
    parser.add_argument("--profile", action="store_true", help="diagnose again under a profiler: seconds by stage")
    parser.add_argument("--json", type=Path, help="where results go")
    parser.add_argument("--one", nargs=2, metavar=("DIR", "TWIN"), help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.one:
        folder, twin = options.one
        print(json.dumps(measure(Path(folder), Path(twin) if twin else None, options.profile)))
        return
    found = []
    print("| rig | s | processor s | peak MB | million steps | µs a step | share of steps | named |")
    print("|---|---:|---:|---:|---:|---:|---:|---|")
    for rig in options.rigs:
        for seed in range(options.seed, options.seed + (options.arms if rig == "arm" else 1)):
            with tempfile.TemporaryDirectory() as folder:
                twin = RECORD[rig](seed, Path(folder))
                command = [sys.executable, __file__, "--one", folder, str(twin or "")]
                done = subprocess.run(
                    command + ["--profile"] * options.profile, stdout=subprocess.PIPE, text=True, check=True
                )
            row = {"rig": rig, "seed": seed, **json.loads(done.stdout.splitlines()[-1])}
            found.append(row)
            each = 1e6 * row["share_of_steps"] * row["seconds"] / row["steps"]
            named = "; ".join(f"`{effect}` {100 * sure:.0f} %" for effect, sure in row["causes"].items())
            print(
                f"| {rig}, {seed} | {row['seconds']:.0f} | {row['processor_seconds']:.0f} | {row['peak_mb']:.0f} |"
                f" {row['steps'] / 1e6:.1f} | {each:.2f} | {100 * row['share_of_steps']:.0f} % | {named} |",
                flush=True,
            )
    for row in found if options.profile else []:
        print(f"\n{row['rig']}, {row['seed']}\n\n{format_costs(row['stages'])}")
    if options.json:
        write_json({**describe_machine(), "results": found}, options.json)


if __name__ == "__main__":
    main()
