"""An hour of random commands with random inputs from a seed, valid, broken and hostile: what ends badly is counted.

    python benchmarks/soak.py --seconds 3600 --seed 1

A third of the commands are killed at a random moment, by SIGTERM, SIGINT or SIGKILL; what was in the folder of results
before has to be whole. Exit status 1 if anything ended in a traceback, hung, left a process or a file behind, or took
too much memory.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import psutil

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.fuzzers import DRAW  # noqa: E402

DEMO = ROOT / "demo" / "flights"
HANG = 240.0
"""Longest time that a command may take [s]: a diagnosis of one flight takes 60 to 120 on a busy core."""
MOST_MB = 4000
ENDS = {0, 2, 130, -signal.SIGTERM, -signal.SIGKILL, -signal.SIGINT}
"""How a command may end: well, with a line, or as it was killed."""


def draw_command(rng: np.random.Generator, folder: Path) -> list[str]:
    """A command with its inputs, which lie in a folder; results go to `out` there."""

    def pick(kind: str, sound: str, share: float = 0.5) -> str:
        return sound if rng.random() < share else str(DRAW[kind](rng, folder))

    flights = ("flip", "steps", "mixed", "aggressive")
    log = pick("log", str(DEMO / f"{flights[rng.integers(4)]}.mcap"))
    twin = pick("twin", "nominal", 0.6) if rng.random() < 0.7 else pick("model", "nominal", 0.3)
    policy = pick("checkpoint", "flip")
    commands = (
        ["diagnose", log, "--twin", twin, "--out", "out"],
        ["compare", log, "--twin", twin, "--json", "out/compare.json"],
        ["play", log, "--twin", twin, "--html", "out/page.html"],
        ["plot", log, "--twin", twin, "--out", "out/plot.svg"],
        ["fly", policy, "--twin", twin, "--duration", "5", "--out", "out/flight.mcap"],
        ["fly", "--manoeuvre", "x_steps", "--twin", twin, "--duration", "6", "--out", "out/flight.mcap"],
        ["evaluate", policy, "--twin", twin, "--tracks", "4", "--json", "out/evaluate.json"],
        ["export", policy, "--format", "c", "--out", "out/c"],
        ["export", policy, "--format", "onnx", "--out", "out/policy.onnx"],
        ["effects", "--twin", twin],
    )
    weights = np.array([1.0, *(len(commands) - 1) * [3.0]])
    return commands[rng.choice(len(commands), p=weights / weights.sum())]


def judge_files(folder: Path) -> list[str]:
    """What in the folder of results is not whole, or left behind."""
    wrong = [f"left behind: {path.name}" for path in folder.rglob(".*") if path.exists()]
    for path in folder.rglob("*.json"):
        try:
            json.loads(path.read_text())
        except ValueError:
            wrong.append(f"no JSON: {path.name}")
    for pattern, end in (("*.html", b"</html>"), ("*.mcap", b"\x89MCAP0")):
        files = folder.rglob(pattern)
        wrong += [f"not whole: {path.name}" for path in files if not path.read_bytes().rstrip().endswith(end)]
    return wrong


def run_one(rng: np.random.Generator, folder: Path) -> tuple[str, list[str]]:
    """Run a command; its name with how it ended, and what was bad about it."""
    arguments = draw_command(rng, folder)
    killed = rng.random() < 1 / 3
    after = float(rng.exponential(8.0)) if killed else HANG
    how = (signal.SIGTERM, signal.SIGINT, signal.SIGKILL)[rng.integers(3)]
    out, err = folder / "stdout", folder / "stderr"
    with out.open("w") as to_out, err.open("w") as to_err:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
        command = [sys.executable, "-m", "vpptwin.cli", *arguments]
        child = subprocess.Popen(
            command, stdout=to_out, stderr=to_err, cwd=folder, env=environment, start_new_session=True
        )
    problems = []
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    try:
        code = child.wait(after)
    except subprocess.TimeoutExpired:
        problems += [] if killed else ["hung"]
        child.send_signal(how if killed else signal.SIGKILL)
        try:
            code = child.wait(20.0)
        except subprocess.TimeoutExpired:
            problems.append(f"does not end by {how.name}")
            child.kill()
            code = child.wait()
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    if peak > before and peak > MOST_MB * 1024:
        problems.append(f"{peak / 1024:.0f} MB")
    said = err.read_text(errors="replace")
    problems += [said[-1500:]] if "Traceback" in said else []
    problems += [] if code in ENDS else [f"exit code {code}: {said[-300:]}"]
    lines = [line for line in said.splitlines() if line.startswith("vpptwin: ")]
    problems += [f"{len(lines)} lines for exit code 2: {said[-500:]}"] if code == 2 and len(lines) != 1 else []
    problems += [f"control characters: {said!r}"] if any(ord(c) < 32 and c not in "\n\r\t" for c in said) else []
    for process in psutil.process_iter(["pid"]):
        try:
            if os.getsid(process.pid) == child.pid and process.status() != psutil.STATUS_ZOMBIE:
                problems.append(f"left running: {process.cmdline()}")
                process.kill()
        except (psutil.Error, OSError):
            continue
    if killed and how == signal.SIGKILL:  # which nothing can clean up after: old results must be whole all the same
        for path in (folder / "out").rglob(".*"):
            subprocess.run(["rm", "-rf", str(path)], check=True)
    problems += judge_files(folder / "out")
    return f"{arguments[0]} {code}", [f"{' '.join(arguments)}: {problem}" for problem in problems]


def main() -> int:
    """Run for so long, print what happened."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    counted: Counter[str] = Counter()
    problems: list[str] = []
    began, number = time.monotonic(), 0
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "out").mkdir()
        while time.monotonic() < began + options.seconds:
            rng = np.random.default_rng([options.seed, number])
            name, found = run_one(rng, Path(folder))
            counted[name] += 1
            problems += [f"{number}: {problem}" for problem in found]
            for path in Path(folder).glob("fuzz_*"):
                path.unlink()
            number += 1
            print(f"\r{number} commands, {len(problems)} problems", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    report = {
        "commands": number,
        "seconds": round(time.monotonic() - began),
        "peak_MB": round(peak),
        "ends": dict(counted),
    }
    print(json.dumps({**report, "problems": problems}, indent=2))
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
