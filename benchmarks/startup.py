"""How long commands take to start, against Python with MuJoCo and NumPy: `python benchmarks/startup.py`.

Every command runs in a process of its own, in interleaved rounds, after one round that compiles what is missing. Ratios
are medians over rounds of a command's wall time against that of `python -c "import mujoco, numpy"` in the same round.
"""

from __future__ import annotations

import argparse
import json
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
VPPTWIN = ["-m", "vpptwin"]
COMMANDS = {
    REFERENCE: ["-c", "import mujoco, numpy"],
    "import vpptwin": ["-c", "import vpptwin"],
    "vpptwin --help": [*VPPTWIN, "--help"],
    "vpptwin effects": [*VPPTWIN, "effects"],
    "vpptwin plot LOG --twin nominal": [*VPPTWIN, "plot", FLIP, "--twin", "nominal", "--out", "flip.png"],
    "vpptwin play LOG --twin nominal --html": [*VPPTWIN, "play", FLIP, "--twin", "nominal", "--html", "flip.html"],
    "vpptwin fly flip": [*VPPTWIN, "fly", "flip", "--out", "flip.mcap"],
    "vpptwin export flip --format c": [*VPPTWIN, "export", "flip", "--format", "c"],
}
"""What is timed, by name: arguments of Python."""


def time_command(arguments: Sequence[str], folder: Path) -> float:
    """Wall time of a command that must succeed [s]."""
    begun = time.perf_counter()
    subprocess.run([sys.executable, *arguments], cwd=folder, check=True, capture_output=True)
    return time.perf_counter() - begun


def measure(names: Sequence[str], rounds: int) -> list[dict]:
    """Medians over the rounds, one row a command."""
    spent: dict[str, list[float]] = {name: [] for name in names}
    with TemporaryDirectory() as folder:
        for k in range(rounds + 1):
            for name in names:
                seconds = time_command(COMMANDS[name], Path(folder))
                spent[name] += [seconds] if k else []
    return [
        {
            "name": name, "seconds": statistics.median(times),
            "ratio": statistics.median(own / other for own, other in zip(times, spent[REFERENCE], strict=True)),
        }
        for name, times in spent.items()
    ]  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5, help="after the first (default 5)")
    parser.add_argument("--only", nargs="*", default=list(COMMANDS), metavar="NAME", help="commands by name")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args(arguments)
    rows = measure([REFERENCE, *(name for name in args.only if name != REFERENCE)], args.rounds)
    print("| command | s | ratio |\n|---|---:|---:|")
    for row in rows:
        print(f"| `{row['name']}` | {row['seconds']:.2f} | {row['ratio']:.1f} |")
    if args.json is not None:
        args.json.write_text(json.dumps({"machine": describe_machine(), "rounds": args.rounds, "rows": rows}, indent=2))


if __name__ == "__main__":
    main()
