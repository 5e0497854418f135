"""The benchmark of criteria: what changes is counted against the same sessions, and the page is the current one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import criteria

from vpptwin.diagnosis.criteria import CRITERIA

ROOT = Path(__file__).resolve().parents[2]


def run(
    number: int, name: str, change: str, *named: str, confidence: float = 0.95, left: bool = False
) -> dict[str, Any]:
    """A made-up diagnosis."""
    causes = [{"effect": e, "confidence": confidence, "gain": 0.5, "parameters": {}, "rivals": {}} for e in named]
    found = {"causes": causes, "unexplained": left, "channel": "", "chi2": [2.0, 1.0], "unseen": [], "experiment": "",
             "seconds": 1.0}  # fmt: skip
    hidden = {} if number == 3 else {"pitch.bias": {"force": 0.05}}
    plan = {"number": number, "kind": "single" if hidden else "none", "hidden": hidden}
    return {"number": number, "plan": plan, "name": name, "change": change, "found": found}


def test_counts_stay_counts() -> None:
    """Half of 6 impacts are 3; 2.5 becomes 5; nothing else changes."""
    assert criteria.vary(CRITERIA, "fewest_blows", 0.5).fewest_blows == 3
    doubled = criteria.vary(CRITERIA, "tolerances", 2.0)
    assert (doubled.tolerances, doubled.temper) == (5.0, CRITERIA.temper)


def test_changes_are_counted_on_the_same_sessions() -> None:
    """Session 3 hides nothing and 7 a torque: a low bar names in 3, a high one misses 7; 0 is left out.

    Session 0 has no diagnosis with the criterion as it is.
    """
    runs = [
        run(3, "", ""), run(7, "", "", "pitch.bias"),
        run(3, "even", "halved", "air.drag"), run(7, "even", "halved", "pitch.bias"), run(0, "even", "halved"),
        run(3, "even", "doubled"), run(7, "even", "doubled"),
        run(3, "temper", "halved"), run(7, "temper", "halved", "pitch.bias", confidence=0.96),
    ]  # fmt: skip
    table = criteria.compare(runs)
    assert criteria.tell_change(table["even", "halved"]) == "1 of 2 verdicts, wrong 0 → 1, false alarm 0 → 1"
    assert criteria.tell_change(table["even", "doubled"]) == "1 of 2 verdicts, detected 1 → 0, in a group 1 → 0"
    assert criteria.tell_change(table["temper", "halved"]) == "none of 2 verdicts"
    assert criteria.tell_change(table.get(("temper", "doubled"))) == "-"


def test_the_page_is_current() -> None:
    """docs/criteria.md is what `python benchmarks/criteria.py --page` prints."""
    assert (ROOT / "docs/criteria.md").read_text(encoding="utf-8") == criteria.write_page() + "\n"
