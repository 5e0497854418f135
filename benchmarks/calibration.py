"""How often causes are right that a diagnosis is so sure of: the map that calibrates its confidence.

    python benchmarks/calibration.py collect FOLDER [--seed 4201] [--numbers carts=0:24,pendula=0:24] [--kinds 501:505]
    python benchmarks/calibration.py fit FOLDER

`collect` draws sessions of SimGap and of `proving.kinds` into FOLDER, diagnoses each, and
writes a line for every named cause into FOLDER/claims.jsonl; begun again, it goes on. `fit` writes the map that ships.
Seeds that calibrate must not judge.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from proving.kinds import KINDS, write_kind  # noqa: E402
from proving.simgap.__main__ import read_numbers  # noqa: E402
from proving.simgap.entrants.own import write_files  # noqa: E402
from proving.simgap.sets import draw_set, list_sessions  # noqa: E402
from proving.simgap.storage import read_session, read_truth  # noqa: E402
from vpptwin.diagnosis.judgement.diagnose import diagnose  # noqa: E402
from vpptwin.inference.calibrate import Calibration, fit_calibration  # noqa: E402
from vpptwin.report.sources import open_flights  # noqa: E402
from vpptwin.system.deadline import Deadline, Stopped  # noqa: E402
from vpptwin.system.errors import InputError  # noqa: E402
from vpptwin.system.files import write_json  # noqa: E402
from vpptwin.twin.spec import load_twin  # noqa: E402

MAP = ROOT / "vpptwin" / "diagnosis" / "judgement" / "calibration.json"
NUMBERS = "drones=0:3,carts=0:14,pendula=0:14,cart-poles=0:8,double-pendula=0:6,servos=0:3,pairs=0:8,quadrotors=0:3"
LIMIT = 240.0
"""Time of a diagnosis at most [s]."""
MOST = 20.0
"""Log odds that count as certain."""
BINS = (0.0, 0.3, 0.5, 0.7, 0.9, 1.0)
Case = Callable[[Path], tuple[Path, list[str], frozenset[str], frozenset[str]]]
"""Writes a case into a folder: twin, logs, ids that are right, and those that are neither right nor wrong."""


def list_cases(folder: Path, kinds: range) -> Iterator[tuple[str, Case]]:
    """Name and case of all sessions and kinds; those that need no twin file are left out."""
    for home in list_sessions(folder):
        yield home.name, lambda out, home=home: open_session(folder, home, out)
    for seed in kinds:
        for kind in KINDS:
            yield f"{kind}_{seed}", lambda out, kind=kind, seed=seed: open_kind(kind, seed, out)


def open_session(folder: Path, home: Path, out: Path) -> tuple[Path, list[str], frozenset[str], frozenset[str]]:
    """A session of SimGap. A payload may lie in the middle of its body, as more mass does."""
    truth = read_truth(folder, home)
    right = {name.split(":")[0] for name in (*truth.sizes, *truth.alike)}
    right |= {name.replace(".mass", ".payload") for name in right}
    logs = sorted(map(str, home.glob("run_*.mcap")))
    return write_files(read_session(home), out), logs, frozenset(right), frozenset()


def open_kind(kind: str, seed: int, out: Path) -> tuple[Path, list[str], frozenset[str], frozenset[str]]:
    """A case of `proving.kinds`."""
    case = write_kind(kind, seed, out)
    if case.twin is None:
        raise InputError("a case without a twin file", "one with it", "take another")
    return case.twin, [*map(str, case.logs)], case.effects | case.right, case.also


def judge_case(case: Case) -> list[dict[str, Any]] | None:
    """Causes of a verdict, each with whether it is right; None where there is no verdict."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            twin, logs, right, neither = case(Path(folder))
            spec = load_twin(twin)
            flights = open_flights(logs, signals=spec.robot.signals.entries)
            verdict = diagnose(spec, flights, deadline=Deadline(LIMIT)).verdict
        except (InputError, Stopped):
            return None
    return [
        {"effect": c.effect, "log_odds": c.log_odds, "right": c.effect in right, "chi2": verdict.after.chi2,
         "left": verdict.unexplained.significant, "confidence": c.confidence}
        for c in verdict.causes if c.effect not in neither
    ]  # fmt: skip


def collect(folder: Path, seed: int, numbers: str, kinds: str) -> None:
    """Diagnose all that is not done yet."""
    if not (folder / "manifest.json").exists():
        draw_set(folder, seed, read_numbers(numbers), True)
    claims = folder / "claims.jsonl"
    done = {json.loads(line)["session"] for line in claims.read_text().splitlines()} if claims.exists() else set()
    first, last = map(int, kinds.split(":"))
    cases = sorted(list_cases(folder, range(first, last)), key=lambda each: int(each[0][-3:]) % 500)
    for name, case in cases:
        if name not in done:
            causes = judge_case(case)
            with claims.open("a") as file:
                file.write(json.dumps({"session": name, "causes": causes}) + "\n")
            told = [(c["effect"], round(c["confidence"], 2), c["right"]) for c in causes or ()]
            print(name, "no verdict" if causes is None else told, flush=True)


def fit(folder: Path, seed: int, kinds: str) -> None:
    """Write the map, and print how often claims were right."""
    rows = [json.loads(line) for line in (folder / "claims.jsonl").read_text().splitlines()]
    claims = [claim for row in rows for claim in row["causes"] or () if claim["log_odds"] is not None]
    odds, right = [c["log_odds"] for c in claims], [c["right"] for c in claims]
    found = fit_calibration(odds, right, MOST)
    asked = ["git", "rev-parse", "--short=7", "HEAD"]
    commit = subprocess.run(asked, capture_output=True, text=True, cwd=ROOT, check=True).stdout.strip()
    told = {
        "intercept": round(found.intercept, 3), "slope": round(found.slope, 4), "highest": round(found.highest, 4),
        "sessions": len(rows), "claims": len(claims), "right": int(sum(right)),
        "seeds": {"simgap": seed, "kinds": kinds}, "commit": commit,
    }  # fmt: skip
    write_json(told, MAP)
    print(json.dumps(told))
    tell_bins(found, odds, right)


def tell_bins(found: Calibration, odds: Sequence[float], right: Sequence[bool]) -> None:
    """How often claims of every range of confidence were right."""
    sure, y = np.array([found.apply(each) for each in odds]), np.array(right)
    for low, high in pairwise(BINS):
        rows = (sure >= low) & (sure < high)
        if rows.any():
            print(f"{low:.1f} to {high:.1f}: {rows.sum()}, said {sure[rows].mean():.2f}, right {y[rows].mean():.2f}")
    print(f"Brier score {np.mean((sure - y) ** 2):.3f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("collect", "fit"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=4201)
    parser.add_argument("--numbers", default=NUMBERS)
    parser.add_argument("--kinds", default="501:503", help="first seed, and the one after the last")
    given = parser.parse_args()
    if given.what == "collect":
        collect(given.folder, given.seed, given.numbers, given.kinds)
    else:
        fit(given.folder, given.seed, given.kinds)
