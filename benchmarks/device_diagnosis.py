"""A diagnosis on a device beside the processor's: `python benchmarks/device_diagnosis.py --device cuda`.

The flights that `vpptwin demo` diagnoses, in interleaved rounds in one process, the first of which compiles what is
missing. Told are wall and processor time of every round, whether both name the same causes, and by how much, as shares,
numbers of the verdicts differ.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from same_rig.report import describe_machine

from vpptwin import diagnose
from vpptwin.cli.demo import DIAGNOSED
from vpptwin.system.resources import flights_dir


def list_numbers(data: Any, where: str = "") -> Iterator[tuple[str, float]]:  # noqa: ANN401
    """Every number in a verdict, with where it stands."""
    if isinstance(data, dict | list):
        parts = data.items() if isinstance(data, dict) else enumerate(data)
        for key, part in parts:
            yield from list_numbers(part, f"{where}/{key}")
    elif isinstance(data, int | float) and not isinstance(data, bool):
        yield where, float(data)


def compare(one: dict, other: dict) -> dict:
    """Whether two verdicts name the same causes, and the number that differs most, as a share."""
    causes = [[cause["effect"] for cause in verdict["causes"]] for verdict in (one, other)]
    first, second = dict(list_numbers(one)), dict(list_numbers(other))
    worst, share = "", 0.0 if first.keys() == second.keys() else math.inf
    for where in first.keys() & second.keys():
        apart = abs(first[where] - second[where]) / max(abs(first[where]), 1e-12)
        worst, share = (where, apart) if apart > share else (worst, share)
    return {"causes": causes[0], "same_causes": causes[0] == causes[1], "largest_difference": share, "where": worst}


def measure(device: str, logs: list[Path], rounds: int) -> dict:
    """Times of every round by where it ran, and how the last verdicts compare."""
    seconds: dict[str, list[float]] = {"processor": [], device: []}
    worked: dict[str, list[float]] = {"processor": [], device: []}
    verdicts = {}
    for _ in range(rounds):
        for name, where in (("processor", None), (device, device)):
            begun, before = time.perf_counter(), time.process_time()
            verdicts[name] = diagnose(logs, device=where, progress=False).verdict.as_dict()
            seconds[name].append(round(time.perf_counter() - begun, 2))
            worked[name].append(round(time.process_time() - before, 2))
    told = compare(verdicts["processor"], verdicts[device])
    return {"seconds": seconds, "processor_seconds": worked, **told}


def main() -> None:
    """Measure, and write down."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda", help="cuda, or cpu, Warp's processor device (default cuda)")
    parser.add_argument("--logs", type=Path, nargs="+", help="flights of the drone (default: those of the demo)")
    parser.add_argument("--rounds", type=int, default=2, help="of both, one after the other (default 2)")
    parser.add_argument("--json", type=Path, help="where results go")
    options = parser.parse_args()
    logs = options.logs or [flights_dir() / f"{name}.mcap" for name in DIAGNOSED]
    result = measure(options.device, logs, options.rounds) | {"machine": describe_machine()}
    text = json.dumps(result, indent=1) + "\n"
    if options.json:
        options.json.write_text(text)
    print(text, end="")


if __name__ == "__main__":
    main()
