"""How often the diagnosis is right on kinds of logs that people bring: proving/kinds.py, drawn over sizes and seeds.

    python benchmarks/kinds.py --kinds all --seeds 0:5 --jobs 2 --json kinds.json
    python benchmarks/kinds.py --kinds step,decay --seeds 3 --keep cases
    python benchmarks/kinds.py --report kinds.json

Every diagnosis is `vpptwin diagnose` in a process of its own. A line tells each case, a table counts them by kind.

| measure | what |
|---|---|
| first | the first cause is an effect that is there |
| kind | the first cause, or a rival of it, is of the kind of what is there |
| sure | confidences of all effects of that kind add up to at least 0.7 |
| all | everything that is there is a cause, or a rival of one |
| wrong | a cause with at least 0.7 is neither of that kind nor there in small |
| holds | 90 % intervals of the causes that are there hold the truth |
| error | at the horizon that the owner feels, on held-out windows, before and after |
| refused | a refusal that gives the right scales of columns counts as right |
| silent | where nothing is wrong, nothing is named, nothing unexplained, and no misfit told |
"""

from __future__ import annotations

import argparse
import json
import math
import os
import queue
import re
import subprocess
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from same_rig.report import describe_machine  # noqa: E402

from proving.kinds import KINDS, Kind, write_kind  # noqa: E402
from proving.runner.campaign import THREADS, take_core  # noqa: E402
from proving.runner.commits import read_commit  # noqa: E402
from proving.runner.rates import Z_90  # noqa: E402
from vpptwin.system.files import write_json  # noqa: E402

SURE = 0.7
"""Confidence from which a kind is decided, and a wrong cause is wrong."""
MARKS = ("first", "kind", "sure", "all", "wrong", "silent")
NEAR = 0.1
"""So close has a scale to be that a refusal tells."""
GRACE = 180.0
"""Longer than its limit no diagnosis may take to end [s]."""

Scored = dict[str, Any]


def list_shares(causes: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Confidence of every effect that is a cause or a rival of one, the largest where it is both."""
    shares: dict[str, float] = {}
    for cause in causes:
        for told in (cause, *cause["also_explained_by"]):
            shares[told["effect"]] = max(shares.get(told["effect"], 0.0), told["confidence"])
    return shares


def read_error(verdict: Mapping[str, Any], horizon_s: float, unit: str) -> tuple[float, float] | None:
    """Errors on held-out windows before and after, at the horizon that is nearest, in `unit`; None where not told."""
    at = int(np.argmin(np.abs(np.array(verdict["horizons_s"]) - horizon_s)))
    key = {"m": "position_rmse_m", "rad": "angle_rmse_rad"}[unit]
    found = [verdict[when][key] and verdict[when][key][at] for when in ("before", "after")]
    return None if None in found else (found[0], found[1])


def check_intervals(causes: Sequence[Mapping[str, Any]], truth: Mapping[str, float]) -> dict[str, bool]:
    """Of every true parameter whose effect is a cause, whether the 90 % interval holds it."""
    found = {f"{cause['effect']}.{name}": told for cause in causes for name, told in cause["parameters"].items()}
    return {
        name: abs(found[name]["value"] - value) <= Z_90 * found[name]["std"]
        for name, value in truth.items()
        if name in found
    }


def score(case: Kind, verdict: Mapping[str, Any]) -> Scored:
    """What a verdict is worth; marks that make no sense of a case are None."""
    causes, there = verdict["causes"], case.effects
    shares = list_shares(causes)
    first = causes[0] if causes else None
    group: Collection[str] = list_shares([first]) if first else ()
    wrong = [c["effect"] for c in causes if c["confidence"] >= SURE and c["effect"] not in case.right | case.also]
    left = bool(verdict["unexplained"]["significant"]) or bool(verdict["misfit"])
    asked = bool(there)
    return {
        "first": first is not None and first["effect"] in there if asked else None,
        "kind": bool(case.right & set(group)) if asked else None,
        "share": round(min(sum(shares.get(effect, 0.0) for effect in case.right), 1.0), 4) if asked else None,
        "sure": sum(shares.get(effect, 0.0) for effect in case.right) >= SURE - 1e-9 if asked else None,
        "all": there <= set(shares) if asked else None, "wrong": bool(wrong), "wrong_causes": wrong,
        "holds": check_intervals(causes, case.truth), "error": read_error(verdict, case.horizon_s, case.unit),
        "silent": None if asked else not causes and not left,
        "causes": [(cause["effect"], cause["confidence"]) for cause in causes], "stopped": verdict["stopped"],
        "found": causes,
    }  # fmt: skip


def score_refusal(case: Kind, said: str) -> Scored | None:
    """A refusal that gives every true gain as the `scale` of its column, within `NEAR`, is as right as a verdict."""
    scales = {f"{name}.gain.gain": float(scale) for scale, name in re.findall(r"`scale: (\S+)` for (\w+)", said)}
    if not case.truth or any(abs(scales.get(name, 0.0) / value - 1.0) > NEAR for name, value in case.truth.items()):
        return None
    marks = dict.fromkeys(("first", "kind", "sure", "all"), True)
    return {**marks, "share": 1.0, "wrong": False, "wrong_causes": [], "holds": {}, "error": None, "silent": None,
            "causes": [], "stopped": None, "found": [], "refused": said}  # fmt: skip


def run_case(kind: str, seed: int, limit: str, keep: Path | None) -> Scored:
    """Write a case, diagnose it as its owner would, and score the verdict; a diagnosis that fails is a result too."""
    with TemporaryDirectory() as temporary:
        folder = keep / f"{kind}_{seed}" if keep else Path(temporary)
        case, out = write_kind(kind, seed, folder), folder / "out"
        rig = ["--twin", str(case.twin)] if case.twin else ["--model", str(case.model)]
        command = [sys.executable, "-m", "vpptwin", "diagnose", *map(str, case.logs), *rig, "--out", str(out)]
        about = {"case": f"{kind}_{seed}", "kind_of_log": kind, "seed": seed, "truth": case.truth,
                 "horizon_s": case.horizon_s, "unit": case.unit}  # fmt: skip
        place = {**os.environ, "PYTHONPATH": str(ROOT)}
        begun = time.perf_counter()
        try:
            run = subprocess.run(
                [*command, "--limit", limit, "--force"], capture_output=True, text=True, cwd=folder, env=place,
                check=False, timeout=read_seconds(limit) + GRACE,
            )  # fmt: skip
            said = (run.stderr.strip().splitlines() or ["no verdict"])[-1]
        except subprocess.TimeoutExpired:
            said = f"did not end {GRACE:.0f} s after its limit"
        about["seconds"] = round(time.perf_counter() - begun, 1)
        if not (out / "verdict.json").exists():
            said = said.split("\r")[-1]
            return about | (score_refusal(case, said) or {"failed": said})
        return about | score(case, json.loads((out / "verdict.json").read_text()))


def read_seconds(limit: str) -> float:
    """Of `90s`, `10m`, `1h` or a number."""
    return float(limit.rstrip("smh")) * {"m": 60.0, "h": 3600.0}.get(limit[-1], 1.0)


def tell_case(found: Scored) -> str:
    """A line of one case."""
    truth = ", ".join(f"{name} {value:.3g}" for name, value in found["truth"].items()) or "nothing"
    head = f"{found['case']}: {truth} -> "
    if "failed" in found:
        return f"{head}FAILED {found['failed']} ({found['seconds']:.0f} s)"
    causes = ", ".join(f"{effect} {sure:.2f}" for effect, sure in found["causes"]) or "nothing"
    marks = [mark for mark in MARKS if found[mark] and mark != "wrong"]
    marks += [f"WRONG {', '.join(found['wrong_causes'])}"] * found["wrong"] + ["stopped"] * bool(found["stopped"])
    marks += [f"misses {name}" for name, held in found["holds"].items() if not held]
    error = found["error"]
    causes = "refused with the right scales" if found.get("refused") else causes
    felt = f"{error[0]:.3g} → {error[1]:.3g} {found['unit']}" if error else "error not told"
    return (
        f"{head}{causes} | {felt} at {found['horizon_s']} s | {', '.join(marks) or 'none'} ({found['seconds']:.0f} s)"
    )


def count_marks(name: str, cases: Sequence[Scored]) -> str:
    """A row of the table: of how many every mark is."""
    done = [case for case in cases if "failed" not in case]

    def rate(outcomes: Sequence[bool | None]) -> str:
        told = [outcome for outcome in outcomes if outcome is not None]
        return f"{sum(told)}/{len(told)}" if told else "-"

    # what failed has named nothing
    of = {mark: [case.get(mark, False if case["truth"] else None) for case in cases] for mark in MARKS[:4]}
    wrong, silent = [case["wrong"] for case in done], [case.get("silent", False) for case in cases if not case["truth"]]
    holds = [held for case in done for held in case["holds"].values()]
    ratios = [case["error"][1] / case["error"][0] for case in done if case["truth"] and case["error"]]
    left = f"{100.0 * math.exp(float(np.mean(np.log(np.maximum(ratios, 1e-9))))):.0f} %" if ratios else "-"
    cells = [
        name, str(len(cases)), *(rate(of[mark]) for mark in MARKS[:4]), rate(wrong), rate(holds), left, rate(silent),
        str(len(cases) - len(done)), f"{np.median([case['seconds'] for case in cases]):.0f}",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def format_table(cases: Sequence[Scored]) -> str:
    """All kinds and their total, in Markdown."""
    kinds = [kind for kind in KINDS if any(case["kind_of_log"] == kind for case in cases)]
    rows = [count_marks(kind, [case for case in cases if case["kind_of_log"] == kind]) for kind in kinds]
    names = ["kind", "cases", "first", "kind right", "sure of it", "all", "wrong", "90 % holds", "error left", "silent",
             "failed", "median s"]  # fmt: skip
    head = f"| {' | '.join(names)} |\n|---|{(len(names) - 1) * '---:|'}"
    return "\n".join([head, *rows, count_marks("**all**", cases)])


def list_seeds(text: str) -> list[int]:
    """Of `3`, `1,4` or `0:5`, the last left out."""
    if ":" in text:
        first, last = text.split(":")
        return list(range(int(first), int(last)))
    return [int(part) for part in text.split(",")]


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default="all", help=f"all, or some of {','.join(KINDS)}")
    parser.add_argument("--seeds", type=list_seeds, default=list_seeds("0:5"), help="0:5 is 0 to 4; 1,4 are these")
    parser.add_argument("--jobs", type=int, default=1, help="diagnoses at once, a core each where there are several")
    parser.add_argument("--limit", default="5m", help="of every diagnosis")
    parser.add_argument("--json", type=Path, help="write results here, after every case")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="leave cases and verdicts here")
    parser.add_argument("--report", type=Path, metavar="FILE", help="run nothing, report these results")
    options = parser.parse_args(argv)
    options.kinds = list(KINDS) if options.kinds == "all" else options.kinds.split(",")
    if unknown := set(options.kinds) - set(KINDS):
        parser.error(f"no kind {', '.join(sorted(unknown))}; expected some of {', '.join(KINDS)}")
    return options


def run_all(options: argparse.Namespace) -> list[Scored]:
    """Diagnose every case, tell each as it ends, and keep the results."""
    cores: queue.Queue[int] = queue.Queue()
    for i in range(options.jobs):
        cores.put(sorted(os.sched_getaffinity(0))[i % len(os.sched_getaffinity(0))])
    os.environ.update(dict.fromkeys(THREADS, "1") if options.jobs > 1 else {})
    keep = options.keep.resolve() if options.keep else None
    about, done = {"commit": read_commit(), "machine": describe_machine(), "limit": options.limit}, []
    pin = take_core if options.jobs > 1 else lambda _: None
    with ThreadPoolExecutor(options.jobs, initializer=pin, initargs=(cores,)) as pool:
        wanted = [(kind, seed) for seed in options.seeds for kind in options.kinds]
        for future in as_completed([pool.submit(run_case, *each, options.limit, keep) for each in wanted]):
            done.append(future.result())
            print(tell_case(done[-1]), flush=True)
            if options.json:
                write_json(about | {"cases": done}, options.json)
    return done


def main(argv: Sequence[str] | None = None) -> int:
    """Run or read the cases, print the table."""
    options = parse(argv)
    if options.report:
        cases = json.loads(options.report.read_text())["cases"]
        print("\n".join(map(tell_case, cases)))
    else:
        cases = run_all(options)
    print("\n" + format_table(cases))
    return 0


if __name__ == "__main__":
    sys.exit(main())
