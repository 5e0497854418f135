"""Writes docs/benchmarks.md: tables of recorded results, each with the command that prints it.

    python benchmarks/tables.py > docs/benchmarks.md

How to read the tables stands on docs/reading_benchmarks.md. A test compares the page with what this program prints.
"""

from __future__ import annotations

import json
import re
import runpy
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from glob import glob
from io import StringIO
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))
sys.path.insert(0, str(ROOT))

from real_logs import print_table  # noqa: E402
from throughput import format_results  # noqa: E402

RESULTS = "benchmarks/results"
HEAD = """\
# Results

Written by `python benchmarks/tables.py` from the records in `benchmarks/results`. [How to read these
tables](reading_benchmarks.md) says what a session is, what counts as right, and how to run them again. Every record
names the commit that it measured. All rates below are of earlier versions of the diagnosis; [how hypotheses are
compared](inference.md#what-was-measured) has first counts of the present one.
"""
DRONE = """\
## The drone

200 sessions of seed 51959, drawn after commit 67b5697 was frozen. Each has three flights of 16 s with gusts of 0.3 to
3 % of weight.

    python benchmarks/hidden_effects.py --cases 200 --seed 51959 --jobs 2 --no-oracle --json hidden.json
    python benchmarks/hidden_effects.py --report benchmarks/results/hidden_51959.json --pictures docs/pictures
"""
PICTURES = """\
![Confusion by family](pictures/hidden_confusion.svg)

![Detection against strength, and what confidences are worth](pictures/hidden_detection.svg)
"""
STUCK = """\
## A slider that sticks, and unequal rotors

31 sessions of seed 40417 at commit 9592637, each with one of these: breakaway friction or jamming on either rail, or
unequal rotors.

    python benchmarks/hidden_effects.py --report benchmarks/results/stuck_40417.json
"""
OTHER = """\
## Carts, pendula and arms

914 sessions of seventeen seeds, each drawn after the commit that it measured was frozen. What one seed showed was
mended before the next one was drawn, so the sums are of many versions. The command prints a table by commit too.

    python benchmarks/hidden_effects.py --rigs other --cases 200 --seed 1 --json other.json
    python benchmarks/hidden_effects.py --rigs other --mixed --report benchmarks/results/other_*.json
"""
SMALL = """\
## A quadrotor, and an arm with servos

A simulated quadrotor of 30 g (three flights of 12 s), and an arm with two position servos (two runs of 16 s). These
are first counts of few sessions.

    python benchmarks/hidden_effects.py --rigs quadrotor --seed 5587 --cases 10 --jobs 1 --no-oracle
    python benchmarks/hidden_effects.py --rigs servo --seed 44349 --cases 8 --jobs 1 --no-oracle
"""
MEASURED = """\
## Measured logs

What `vpptwin diagnose` says of logs of real robots, beside what fits by hand say of them without MuJoCo. The READMEs
of `examples` tell where the logs come from and how they were fitted. *Right*: fits by hand find every cause too. *In
part*: they find some of them. *Not so by hand*: they find none, and none is claimed with more than 90 %. *Wrong*: a
cause with more than 90 % that fits by hand do not find.

    python benchmarks/real_logs.py DATA --json real_logs.json
"""
SPEED = """\
## Throughput

Control steps of 10 ms (ten physics steps) of many rigs side by side, against MuJoCo's own batch with the same rig and
friction.

    python benchmarks/throughput.py --envs 1024 4096 --json benchmarks/results/throughput.json
"""
SMALL_RECORDS = {
    "quadrotor, seed 5587": "quadrotor_5587",
    "quadrotor, seed 61713": "quadrotor_61713",
    "arm with servos, seed 44349": "servo_44349",
    "arm with servos, seed 45564": "servo_45564",
}
SMALL_MEASURES = {
    "named first": "one effect: named first",
    "in the group": "one effect: named or in the group",
    "confidently wrong": "confidently wrong",
    "silent where nothing is hidden": "nothing hidden: silent",
    "size inside the 90 % interval": "strength of named effects: inside the 90 % interval",
}


def replay(script: str, *words: str) -> str:
    """What a script prints about records."""
    given = [found for word in words for found in (sorted(glob(word, root_dir=ROOT)) if "*" in word else [word])]
    before, sys.argv = sys.argv, [f"benchmarks/{script}", *given]
    try:
        with redirect_stdout(StringIO()) as said:
            runpy.run_path(str(ROOT / "benchmarks" / script), run_name="__main__")
    except SystemExit as ended:
        if ended.code:
            raise
    finally:
        sys.argv = before
    return said.getvalue()


def report_sessions(record: str, *options: str) -> list[str]:
    """The tables that hidden_effects.py prints of a record, without rows that measure nothing."""
    said = replay("hidden_effects.py", *options, "--report", f"{RESULTS}/{record}.json")
    tables = re.findall(r"(?:^\|.*\n)+", said, flags=re.MULTILINE)
    return [
        "".join(f"{line}\n" for line in table.splitlines() if not re.search(r"\| - \| ?(?:-? ?\|)", line))
        for table in tables
    ]


def find_cell(tables: Sequence[str], measure: str) -> str:
    """The result of a measure, as a table has it."""
    for line in "".join(tables).splitlines():
        if line.startswith(f"| {measure} |"):
            return line.split("|")[2].strip()
    return "-"


def write_small() -> str:
    """A row for each record of few sessions."""
    lines = [f"| | {' | '.join(SMALL_MEASURES)} |\n", f"|---|{'---:|' * len(SMALL_MEASURES)}\n"]
    for name, record in SMALL_RECORDS.items():
        tables = report_sessions(record, "--rigs", record.split("_")[0])
        cells = [find_cell(tables, measure) for measure in SMALL_MEASURES.values()]
        lines.append(f"| {name} | {' | '.join(cells)} |\n")
    return "".join(lines)


def write_measured() -> str:
    """The table of measured logs."""
    record = json.loads((ROOT / RESULTS / "real_logs.json").read_text())
    with redirect_stdout(StringIO()) as said:
        print_table(record["logs"])
    return f"At commit {record['commit'][:7]}.\n\n{said.getvalue()}"


def write_throughput() -> str:
    """The table of throughput, and on what machine it was measured."""
    record = json.loads((ROOT / RESULTS / "throughput.json").read_text())
    machine = record["machine"]
    where = f"{machine['cores']} cores of an {machine['cpu']}, load average {machine['load_average']:.1f}"
    table = "\n".join(line for line in format_results(record).split("\n\n")[0].splitlines() if "| 1024 |" not in line)
    return f"At commit {record['commit'][:7]}, on {where}, beside other work: read the ratios.\n\n{table}\n"


def write_page() -> str:
    """The whole page."""
    drone = report_sessions("hidden_51959")
    other = report_sessions("other_*", "--rigs", "other", "--mixed")
    parts = [
        HEAD, DRONE, drone[0], drone[2], PICTURES, drone[4],
        STUCK, report_sessions("stuck_40417")[0],
        OTHER, other[0], other[2], other[4],
        SMALL, write_small(), MEASURED, write_measured(), SPEED, write_throughput(),
    ]  # fmt: skip
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


if __name__ == "__main__":
    sys.stdout.write(write_page())
