"""How fast the twin flies, against the engine alone: `python benchmarks/throughput.py [--quick] [--json out.json]`.

With `--device cuda` on a card too, beside mujoco_warp where it is installed; with `--device cpu` by Warp on the
processor.

Everything runs in one process, in interleaved rounds, from like starts with the same pilot; ratios are medians over
rounds of a round's time against that of the engine in the same round. On a machine that does other work too, the ratios
of processor time are steadier; they leave out how well threads share the work.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from same_rig.report import describe_machine, read_text
from throughput_rigs import CONTENDERS, FRICTION, PERIOD, SUBSTEPS, Rigs, Spent

REFERENCE = "raw"
MEMORY_OF = ("twin, all effects", "environment")
MOST = 8192
"""Rigs up to which the processor flies beside a device."""
LIVE = ("twin, all effects", "environment")
"""What is flown alone, for live viewing."""


def measure_rounds(envs: int, args: argparse.Namespace) -> list[dict]:
    """Time every contender in interleaved rounds; one row of results each."""
    far = list_far(args.device)
    beside = {name: CONTENDERS[name] for name in ((REFERENCE, *LIVE) if args.device else CONTENDERS)}
    chosen = (beside if envs <= MOST or not args.device else {}) | far
    rigs = {name: make(envs, args.threads, args.seed) for name, (_, make) in chosen.items()}
    steps = {name: choose_steps(flown, args.seconds) for name, flown in rigs.items()}
    rounds: dict[str, list[Spent]] = {name: [] for name in rigs}
    names = list(rigs)
    for k in range(args.rounds):
        for name in names[k % len(names) :] + names[: k % len(names)]:
            rounds[name].append(rigs[name].fly(steps[name]))
    return [summarize(name, chosen[name][0], envs, rounds) for name in names]


def list_far(device: str | None) -> dict:
    """What flies on a device; nothing without one."""
    if device is None:
        return {}
    from throughput_device import list_contenders  # which needs Warp

    return list_contenders(device)


def choose_steps(rigs: Rigs, seconds: float) -> int:
    """Control steps that take about so long [s]; flies a few."""
    rigs.fly(2)
    spent = rigs.fly(3)
    return max(2, round(3 * seconds / spent.wall))


def summarize(name: str, title: str, envs: int, rounds: dict[str, list[Spent]]) -> dict:
    """Medians over the rounds of one contender, and its ratios to the reference, round by round, if that flew."""
    own = rounds[name]
    reference = rounds.get(REFERENCE, [Spent(math.nan, math.nan, 1)] * len(own))
    wall = [s.steps / s.wall for s in own]
    processor = [s.processor / s.steps for s in own]
    ended = sum(s.ended for s in own)
    return {
        "name": name, "title": title, "environments": envs,
        "control_steps_per_s": statistics.median(wall),
        "processor_us_per_physics_step": 1e6 * statistics.median(processor) / SUBSTEPS,
        "ratio": statistics.median(a / (r.steps / r.wall) for a, r in zip(wall, reference, strict=True)),
        "processor_ratio": statistics.median((r.processor / r.steps) / a for a, r in zip(processor, reference)),
        "resets_share": ended / sum(s.steps for s in own),
        "failed_share_of_resets": sum(s.failed for s in own) / max(ended, 1),
        "rounds": wall,
    }  # fmt: skip


def measure_alone(name: str, seed: int, seconds: float) -> dict:
    """Simulated time against wall time of one rig alone, with one thread."""
    rigs = CONTENDERS[name][1](1, 1, seed)
    steps = choose_steps(rigs, seconds)
    spent, flown = rigs.fly(steps), PERIOD * steps
    return {"name": name, "times_real_time": flown / spent.wall, "processor_times_real_time": flown / spent.processor}


def measure_memory(name: str, envs: int, args: argparse.Namespace) -> dict:
    """Peak resident memory [MiB] of a process that makes and flies so many rigs, and what it had before."""
    command = [sys.executable, __file__, "--memory-of", name, "--envs", str(envs), "--threads", str(args.threads)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return {"name": name, "environments": envs} | json.loads(done.stdout)


def report_memory(name: str, envs: int, args: argparse.Namespace) -> dict:
    """Peak resident memory [MiB] of this process: with a single rig, which loads and compiles all, and with many."""
    CONTENDERS[name][1](1, 1, args.seed).fly(2)
    before = read_peak()
    CONTENDERS[name][1](envs, args.threads, args.seed).fly(20)
    return {"single_mib": before, "peak_mib": read_peak()}


def read_peak() -> float:
    """Peak resident memory of this process so far [MiB]."""
    (line,) = [line for line in read_text("/proc/self/status").splitlines() if line.startswith("VmHWM")]
    return int(line.split()[1]) / 1024.0


def describe_device(device: str) -> str:
    """Warp's words for it, with its driver."""
    from vpptwin.twin.warp.step import load_warp

    wp = load_warp()
    return f"{wp.get_device(device).name}, driver CUDA {wp.get_cuda_driver_version()}, Warp {wp.__version__}"


def format_results(result: dict) -> str:
    """The tables, in Markdown."""
    lines = [
        "| environments | what | control steps/s | ratio to raw | in processor time | processor µs per physics step |",
        "|---:|---|---:|---:|---:|---:|",
    ]
    for row in result["rows"]:
        lines.append(
            f"| {row['environments']} | {row['title']} | {row['control_steps_per_s']:,.0f} | {row['ratio']:.2f} "
            f"| {row['processor_ratio']:.2f} | {row['processor_us_per_physics_step']:.2f} |"
        )
    lines.append("")
    for row in result["rows"]:
        if row["name"] == "environment":
            lines.append(
                f"- {row['environments']} environments: {row['resets_share']:.2%} of all steps end an episode "
                f"and reset its row, {row['failed_share_of_resets']:.0%} of them by a failure."
            )
    for alone in result["alone"]:
        lines.append(
            f"- One rig alone, {CONTENDERS[alone['name']][0]}: {alone['times_real_time']:.0f} x real time "
            f"({alone['processor_times_real_time']:.0f} x by processor time)."
        )
    for m in result["memory"]:
        more = m["peak_mib"] - m["single_mib"]
        lines.append(
            f"- Peak memory with {m['environments']} rigs, {CONTENDERS[m['name']][0]}: {m['peak_mib']:.0f} MiB, "
            f"{more:.0f} MiB of it for the rigs."
        )
    return "\n".join(lines)


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--envs", type=int, nargs="+", help="rigs; 1024, 4096 and 8192 by default")
    parser.add_argument("--rounds", type=int, help="interleaved rounds; 7 by default")
    parser.add_argument("--seconds", type=float, help="length of a round, about; 0.7 by default")
    parser.add_argument("--threads", type=int, default=2, help="of the engine; 2 by default")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="fly on Warp's device too")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="a few rigs, two short rounds")
    parser.add_argument("--json", type=Path, help="write the results here")
    parser.add_argument("--memory-of", choices=CONTENDERS, help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    full = [1024, 8192, 65536] if args.device == "cuda" else [1024, 4096, 8192]
    args.envs = args.envs or ([16] if args.quick else full)
    args.rounds = args.rounds or (2 if args.quick else 7)
    args.seconds = args.seconds or (0.05 if args.quick else 0.7)
    return args


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmark."""
    args = parse(argv)
    if args.memory_of:
        print(json.dumps(report_memory(args.memory_of, max(args.envs), args)))
        return 0
    rows = []
    for envs in args.envs:
        print(f"{envs} environments ...", file=sys.stderr, flush=True)
        rows += measure_rounds(envs, args)
    result = describe_machine() | {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": args.seed, "threads": args.threads, "rounds": args.rounds, "seconds": args.seconds,
        "friction_n": FRICTION, "rows": rows,
        "device": args.device and describe_device(args.device),
        "alone": [] if args.device else [measure_alone(name, args.seed, args.seconds) for name in LIVE],
        "memory": [] if args.device else [measure_memory(name, max(args.envs), args) for name in MEMORY_OF],
    }  # fmt: skip
    print(format_results(result))
    if args.json:
        args.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
