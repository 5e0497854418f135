"""The golden set: what counts as a difference, what does not, and that everything it runs is there."""

from __future__ import annotations

import importlib
import json
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def golden(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The benchmark."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("golden")


def test_a_last_bit_is_a_difference(golden: ModuleType) -> None:
    """Its place and size are told, and so are signs of zeros, numbers of another kind and files that are missing."""
    old = {"verdict.json": json.dumps({"a": [1.0, 0.1 + 0.2], "b": float("nan")}), "twin.yaml": "a\nb"}
    assert golden.tell_difference(old, dict(old)) == ""
    new = old | {"verdict.json": old["verdict.json"].replace("0.30000000000000004", "0.3")}
    told = golden.tell_difference(old, new)
    assert told.startswith("verdict.json at .a[1]: 0.30000000000000004 -> 0.3; 1 places, floats by 1.9e-16")
    found = golden.walk({"x": 0.0, "y": 1, "z": 2}, {"x": -0.0, "y": 1.0})
    assert [place for place, _, _ in found] == [".x", ".y", ".z"]
    assert golden.tell_difference(old, {"verdict.json": old["verdict.json"]}) == "twin.yaml is missing"
    assert golden.tell_difference(old, old | {"twin.yaml": "a\nc"}) == "twin.yaml, line 2: b -> c"


def test_causes_are_told(golden: ModuleType) -> None:
    """Where something differs: whether the same are named in the same order; what else is inputs' fault."""
    stored = {"files": {"verdict.json": "1"}, "causes": [["a", 0.5], ["b", 0.4]], "inputs": "1"}
    same = golden.Done({}, stored | {"files": {"verdict.json": "2"}, "causes": [["a", 0.6], ["b", 0.4]]})
    assert golden.compare(golden.Done({}, stored), stored, None) == ""
    assert golden.compare(same, stored, None) == "verdict.json; same causes (a, b)"
    other = golden.Done({}, same.told | {"causes": [["b", 0.4]], "inputs": "2"})
    assert golden.compare(other, stored, None) == "verdict.json; CAUSES a, b -> b; INPUTS DIFFER"


def test_what_varies_is_dropped(golden: ModuleType, tmp_path: Path) -> None:
    """Paths, dates, versions, commits and the modules that things lie in; nothing else."""
    text = f"{tmp_path}/a {ROOT}/b on 2026-11-28T17:03:40+00:00 at {'ab' * 20}\n    numpy: 2.4.6\nDone in 85 s"
    assert golden.drop_varying(text, tmp_path) == "WORK/a ROOT/b on DATE at COMMIT\n    numpy: VERSION\nDone in TIME s"
    assert golden.drop_varying("from vpptwin.twin.step import x", tmp_path) == "from step import x"
    assert golden.drop_varying("force: 0.3012", tmp_path) == "force: 0.3012"


def test_everything_is_found(golden: ModuleType) -> None:
    """What moves with modules, and what is recorded in the repository: every item, its digests and its causes."""
    inputs = importlib.import_module("golden_set.inputs")
    for module, _, inside in (place.partition(":") for place in inputs.PLACES.values()):
        spec = find_spec(module)  # importing Warp and torch would take ten times as long
        assert spec is not None, module
        assert inside in Path(spec.origin or "").read_text(encoding="utf-8"), inside
    items = golden.list_items()
    stored = golden.read_summary(ROOT / "benchmarks/results/golden.json")["items"]
    assert set(stored) == set(items)
    assert all(("causes" in told) == ("verdict.json" in told["files"]) for told in stored.values())
