"""The thresholds of a diagnosis: each is explained, and those that are handed in are the only ones that count."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from pathlib import Path

import vpptwin.diagnosis
from tests.diagnosis.carts import FITTED, WINDOW, load_cart, measure_cart
from tests.diagnosis.rigs import FRICTION, drive_cart
from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.flights import build_bench
from vpptwin.diagnosis.judgement.errors import PredictionErrors
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.search.search import Search
from vpptwin.diagnosis.search.suspects import list_unknowns

KINDS = ("assumed", "proposed", "calibrated", "by hand")


def test_every_criterion_is_explained() -> None:
    """Unit, meaning, and an origin of a known kind that names a commit; defaults of the declared type."""
    for f in fields(Criteria):
        assert type(f.default).__name__ == f.type, f.name
        assert set(f.metadata) == {"unit", "meaning", "origin"}
        assert f.metadata["meaning"]
        assert f.metadata["origin"].startswith(KINDS), f.name
        assert re.search(r"\b[0-9a-f]{7}\b", f.metadata["origin"]), f.name


def test_every_criterion_is_used_and_none_is_read_from_the_module() -> None:
    """Each is somewhere in the rooms; `CRITERIA` is there only as what an argument is by default."""
    package = Path(vpptwin.diagnosis.__file__).parents[1]
    rooms = [f for room in ("diagnosis", "robots") for f in (package / room).rglob("*.py") if f.name != "criteria.py"]
    text = "\n".join(file.read_text() for file in rooms)
    assert [f.name for f in fields(Criteria) if not re.search(rf"criteria\.{f.name}\b", text)] == []
    uses = [line.strip() for line in text.splitlines() if "CRITERIA" in line]
    other = [u for u in uses if not u.startswith("from ") and "criteria: Criteria = CRITERIA" not in u]
    assert other == []


def test_what_is_handed_to_a_bench_decides_on_it(tmp_path: Path) -> None:
    """Whatever asks for a threshold asks those of its bench."""
    spec, flight = load_cart(tmp_path), measure_cart(drive_cart(FRICTION, 5), 7)
    strict = replace(CRITERIA, named=0.5)
    bench = build_bench(spec, [flight], [FITTED], WINDOW, False, criteria=strict)
    search = Search(bench, list_unknowns(spec))
    assert search.criteria is HeldOut(bench, bench).criteria is PredictionErrors(bench).criteria is strict
