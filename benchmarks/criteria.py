"""What halving and doubling the criteria of a diagnosis does to its verdicts, and the page that lists them all.

    python benchmarks/criteria.py --seed 1 --numbers 0,1,2,3 --json criteria.json               (all of them: hours)
    python benchmarks/criteria.py --seed 8001 --logs logs --names bar,temper --minutes 15 --json criteria.json
    python benchmarks/criteria.py --report criteria.json
    python benchmarks/criteria.py --page > docs/criteria.md

Each session is diagnosed as it is, then once more for every criterion and factor. What is reported first is which
criteria a set of sessions is sensitive to at all: the others need no more sessions like these. A rerun goes on.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from same_rig.report import describe_machine  # noqa: E402

from proving.runner.campaign import read_results  # noqa: E402
from proving.runner.case import Case, Finding  # noqa: E402
from proving.runner.draw import Plan, draw_plan  # noqa: E402
from proving.runner.rates import count, leaves_something  # noqa: E402
from proving.runner.session import find, fly_sessions  # noqa: E402
from vpptwin.diagnosis.criteria import CRITERIA, Criteria  # noqa: E402
from vpptwin.logs.read import read_flight  # noqa: E402
from vpptwin.system.files import write_json  # noqa: E402

FACTORS = {"halved": 0.5, "doubled": 2.0}
Run = dict[str, Any]
"""One diagnosis: session `number`, its `plan`, criterion `name` ("" for none), `change` and what was `found`."""
TEXT = """# Thresholds

Every threshold that decides what a [diagnosis](diagnose.md) says. `diagnose(..., criteria=Criteria(named=0.2))` uses
others. `python benchmarks/criteria.py --page > docs/criteria.md` writes this page from
`vpptwin/diagnosis/criteria.py`, where the origin of each value stands too.

None is derived from theory. Most were changed by hand while development sessions were inspected; others are beliefs
about rigs, or calibrated with simulated sessions.

What halving and doubling them does, `python benchmarks/criteria.py --report benchmarks/results/criteria_8001.json`
prints for three sessions of a development seed.
"""


def vary(criteria: Criteria, name: str, factor: float) -> Criteria:
    """The same with one criterion times a factor; counts are rounded and at least 1."""
    value = getattr(criteria, name)
    return replace(criteria, **{name: max(round(value * factor), 1) if isinstance(value, int) else value * factor})


def list_runs(numbers: Iterable[int], names: Sequence[str]) -> list[tuple[int, str, str]]:
    """Session by session, as it is and then changed, so that what is finished can be compared."""
    changes = [("", ""), *((name, change) for name in names for change in FACTORS)]
    return [(number, *change) for number in numbers for change in changes]


def measure(options: argparse.Namespace, names: Sequence[str]) -> list[Run]:
    """Diagnose what is not there yet, until the time is up."""
    runs: list[Run] = read_results(options.json)["runs"] if options.json.exists() else []
    done = {(run["number"], run["name"], run["change"]) for run in runs}
    numbers = [int(number) for number in options.numbers.split(",")]
    if others := [n for n in {r["number"] for r in runs} if find_plan(runs, n) != draw_plan(options.seed, n)]:
        sys.exit(f"{options.json} has sessions {others} of another generator or seed: name another file")
    began, criteria, flights = time.monotonic(), CRITERIA, {}
    with tempfile.TemporaryDirectory() as folder:
        for number, name, change in list_runs(numbers, names):
            if (number, name, change) in done or time.monotonic() - began > 60.0 * options.minutes:
                continue
            plan = draw_plan(options.seed, number)
            if number not in flights:
                logs = sorted((options.logs / f"case_{number:04d}").glob("*.mcap")) if options.logs else None
                flights = {number: [read_flight(p) for p in logs or fly_sessions([plan], Path(folder))[0]]}
            criteria = vary(CRITERIA, name, FACTORS[change]) if name else CRITERIA
            found = asdict(find(flights[number], criteria=criteria))
            runs.append({"number": number, "plan": asdict(plan), "name": name, "change": change, "found": found})
            write_json({"seed": options.seed, **describe_machine(), "runs": runs}, options.json)
            print(number, name, change, [c["effect"] for c in found["causes"]], f"{found['seconds']} s", flush=True)
    return runs


def find_plan(runs: Iterable[Run], number: int) -> Plan:
    """What was hidden in a session that ran."""
    return next(Plan.from_dict(run["plan"]) for run in runs if run["number"] == number)


def tell_verdict(found: Finding) -> tuple[object, ...]:
    """What of a verdict counts: causes with their rivals, which are claimed, and whether something is left."""
    return {(c.effect, frozenset(c.rivals), c.confidence > 0.9) for c in found.causes}, found.unexplained


def compare(runs: Sequence[Run]) -> dict[tuple[str, str], tuple[int, int, dict[str, tuple[int, int]]]]:
    """(Criterion, change) → sessions tried both ways, verdicts that change, and measures as (before, after).

    Measures: all hidden effects named; named or in a group; something wrong claimed; something named that is not there.
    """
    cases = {(r["number"], r["name"], r["change"]): Case(Plan.from_dict(r["plan"]), Finding.from_dict(r["found"]))
             for r in runs}  # fmt: skip
    table = {}
    for name, change in dict.fromkeys((r["name"], r["change"]) for r in runs if r["name"]):
        pairs = [(cases[n, "", ""], case) for (n, *which), case in cases.items()
                 if which == [name, change] and (n, "", "") in cases]  # fmt: skip
        changed = sum(tell_verdict(a.found) != tell_verdict(b.found) for a, b in pairs if a.found and b.found)
        rows = [summarise([pair[i] for pair in pairs]) for i in (0, 1)]
        table[name, change] = len(pairs), changed, {key: (rows[0][key], rows[1][key]) for key in rows[0]}
    return table


def summarise(cases: Sequence[Case]) -> dict[str, int]:
    """Sessions in which it was so."""
    known = [case for case in cases if case.plan.known]
    rows = (
        count("detected", (case.all_named for case in known)),
        count("in a group", (case.all_suspected for case in known)),
        count("wrong", (bool(case.wrong) for case in cases)),
        count("false alarm", (bool(case.first) for case in cases if case.plan.kind == "none")),
        count("false remainder", (leaves_something(case) for case in cases if case.plan.kind != "alien")),
        count("alien flagged", (leaves_something(case) for case in cases if case.plan.kind == "alien")),
    )
    return {row.name: row.hits for row in rows}


def tell_change(entry: tuple[int, int, dict[str, tuple[int, int]]] | None) -> str:
    """What a change did, in a few words."""
    if entry is None:
        return "-"
    sessions, changed, rows = entry
    moved = [f"{name} {before} → {after}" for name, (before, after) in rows.items() if before != after]
    return ", ".join([f"{changed} of {sessions} verdicts", *moved]) if changed else f"none of {sessions} verdicts"


def report(runs: Sequence[Run]) -> None:
    """Print which criteria the sessions are sensitive to, and the rates."""
    table = compare(runs)
    sensitive = sorted({name for (name, _), (_, changed, _) in table.items() if changed})
    print(f"sensitive to: {', '.join(sensitive) or 'none of those tried'}\n")
    for (name, change), entry in table.items():
        print(f"{name} {change}: {tell_change(entry)}")


def write_page() -> str:
    """The page of all criteria."""
    lines = [TEXT, "| criterion | value | unit | meaning |", "|---|---:|---|---|"]
    for f in fields(Criteria):
        m = f.metadata
        lines.append(f"| `{f.name}` | {f.default:g} | {m['unit']} | {m['meaning']} |")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, report, or print the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of the sessions, as in hidden_effects.py")
    parser.add_argument("--numbers", default="0,1,2,3", help="sessions, separated by commas")
    parser.add_argument("--names", help="criteria, separated by commas; by default all")
    parser.add_argument(
        "--logs", type=Path, metavar="DIR", help="what hidden_effects.py --keep left; else they are flown"
    )
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no diagnosis after so many")
    parser.add_argument(
        "--json", type=Path, default=Path("criteria.json"), help="results, written after every diagnosis"
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="run nothing, report these results")
    parser.add_argument("--page", action="store_true", help="print docs/criteria.md")
    options = parser.parse_args(argv)
    if options.page:
        print(write_page())
        return
    if options.report:
        report(read_results(options.report)["runs"])
        return
    names = options.names.split(",") if options.names else [f.name for f in fields(Criteria)]
    if unknown := set(names) - {f.name for f in fields(Criteria)}:
        sys.exit(f"no such criterion: {', '.join(sorted(unknown))}; docs/criteria.md lists all")
    report(measure(options, names))


if __name__ == "__main__":
    main()
