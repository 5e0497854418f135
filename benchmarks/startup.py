"""How long commands take to start, against Python with MuJoCo and NumPy: `python benchmarks/startup.py`.

Every command runs in a process of its own, in interleaved rounds, after one round that compiles what is missing. Ratios
are medians over rounds of a command's time against that of `python -c "import mujoco, numpy"` in the same round, wall
time and, which tells more where others share the machine, processor time.
"""

from __future__ import annotations

import argparse
import json
import resource
import shlex
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from same_rig.report import describe_machine

REFERENCE = 'python -c "import mujoco, numpy"'
FLIP = str(Path(__file__).resolve().parents[1] / "demo/flights/flip.mcap")
COMMANDS = (
    REFERENCE,
    'python -c "import vpptwin"',
    "vpptwin --help",
    "vpptwin effects",
    "vpptwin plot LOG --twin nominal",
    "vpptwin play LOG --twin nominal --html flip.html",
    "vpptwin fly flip --out flown.mcap",
    "vpptwin export flip --format c",
)
"""What is timed."""


def time_command(command: str, folder: Path) -> tuple[float, float]:
    """Wall and processor time of a command that must succeed [s]."""
    words = shlex.split(command.replace("LOG", FLIP))
    arguments = words[1:] if words[0] == "python" else ["-m", *words]
    begun, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], cwd=folder, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    worked = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - begun, worked


def measure(names: Sequence[str], rounds: int) -> list[dict]:
    """Medians over the rounds, one row a command."""
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    with TemporaryDirectory() as folder:
        for k in range(rounds + 1):
            for name in names:
                times = time_command(name, Path(folder))
                spent[name] += [times] if k else []
    rows = []
    for name, times in spent.items():
        row: dict = {"name": name}
        for i, kind in enumerate(("wall", "processor")):
            row[f"{kind}_s"] = statistics.median(own[i] for own in times)
            row[f"{kind}_ratio"] = statistics.median(
                own[i] / other[i] for own, other in zip(times, spent[REFERENCE], strict=True)
            )
        rows.append(row)
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5, help="after the first (default 5)")
    parser.add_argument("--only", nargs="*", default=COMMANDS, metavar="NAME", help="commands by name")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args(arguments)
    rows = measure([REFERENCE, *(name for name in args.only if name != REFERENCE)], args.rounds)
    print("| command | wall s | ratio | processor s | ratio |\n|---|---:|---:|---:|---:|")
    for row in rows:
        figures = (row["wall_s"], row["wall_ratio"], row["processor_s"], row["processor_ratio"])
        print("| `{}` | {:.2f} | {:.1f} | {:.2f} | {:.1f} |".format(row["name"], *figures))
    if args.json is not None:
        args.json.write_text(json.dumps({"machine": describe_machine(), "rounds": args.rounds, "rows": rows}, indent=2))


if __name__ == "__main__":
    main()
