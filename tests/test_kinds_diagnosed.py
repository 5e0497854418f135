"""Verdicts on kinds of logs that people bring, and on the inputs of ../shared/cases."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from proving.kinds import write_kind
from tests.conftest import SHARED
from vpptwin import diagnose
from vpptwin.cli.main import main
from vpptwin.report.result import Result

CASES = SHARED / "cases"
DRAWN = [("step", 7), ("two_steps", 8), ("decay", 9), ("relay", 7)]
"""Kinds with seeds for development, of which some have no twin YAML: then the next that has one."""


def diagnose_kind(kind: str, seed: int, folder: Path) -> tuple[Result, dict[str, float], frozenset[str]]:
    """The verdict on the first case from a seed on that has a twin YAML, what is true, and ids that may be named."""
    case = next(c for n in range(seed, seed + 20) if (c := write_kind(kind, n, folder / str(n))).twin)
    result = diagnose([str(log) for log in case.logs], str(case.twin), progress=False)
    return result, case.truth, frozenset(case.right | case.also)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), DRAWN)
def test_what_is_missing_is_named_first_and_sized(kind: str, seed: int, tmp_path: Path) -> None:
    """With at least 0.7, nothing else as sure, and most of the error half a second ahead goes."""
    result, truth, allowed = diagnose_kind(kind, seed, tmp_path)
    verdict = result.verdict
    effects = {name.rsplit(".", 1)[0] for name in truth}
    first = verdict.causes[0]
    assert first.effect in effects
    assert first.confidence >= 0.7
    assert not [c.effect for c in verdict.causes if c.effect not in allowed and c.confidence >= 0.7]
    for name, value in truth.items():
        effect, parameter = name.rsplit(".", 1)
        if effect == first.effect:
            assert first.parameters[parameter].value == pytest.approx(value, rel=0.2)
    assert verdict.after.chi2 < 0.1 * verdict.before.chi2
    before, after = verdict.before.position_rmse_m, verdict.after.position_rmse_m
    if before is not None and after is not None:
        assert after[3] < 0.1 * before[3]


def test_nothing_is_named_where_nothing_is_wrong(tmp_path: Path) -> None:
    """An imperfect rail of a per cent and noise are no cause."""
    result, _, _ = diagnose_kind("nothing", 6, tmp_path)
    assert not result.verdict.causes
    assert not result.verdict.unexplained.significant


def run_case(script: str, model: str, log: str, folder: Path) -> dict[str, float]:
    """Write a case of ../shared with the twin that `inspect` writes for it; what is true of it."""
    if not (CASES / script).exists():
        pytest.skip(f"no {CASES / script}")
    subprocess.run([sys.executable, str(CASES / script), str(folder)], check=True)
    assert main(["inspect", str(folder / log), "--model", str(folder / model), "--out", str(folder / "twin.yaml")]) == 0
    truth: dict[str, float] = json.loads((folder / "truth.json").read_text())
    return truth


@pytest.mark.slow
def test_one_step_tells_the_damping(tmp_path: Path) -> None:
    """Viscous friction first, the error half a second ahead smaller by far, and said to be of this log alone."""
    run_case("short_step.py", "cart.xml", "step.csv", tmp_path)
    result = diagnose([str(tmp_path / "step.csv")], str(tmp_path / "twin.yaml"), progress=False)
    first = result.verdict.causes[0]
    assert (first.effect, first.confidence >= 0.7) == ("slide.viscous", True)
    assert 4.7 <= first.parameters["damping"].value <= 5.7
    before, after = result.verdict.before.position_rmse_m, result.verdict.after.position_rmse_m
    assert before is not None
    assert after is not None
    assert after[3] < 0.05 * before[3]
    assert "held-out stretches of this log" in result.summary.error
    assert not {"motor.gain", "motor.delay", "slide.inertia"} & {c.effect for c in result.verdict.causes}


def test_a_quiet_decay_tells_dry_from_viscous_friction(tmp_path: Path) -> None:
    """Both, with intervals that hold what is true."""
    truth = run_case("quiet_decay.py", "pend.xml", "a.csv", tmp_path)
    logs = [str(tmp_path / name) for name in ("a.csv", "b.csv")]
    verdict = diagnose(logs, str(tmp_path / "twin.yaml"), progress=False).verdict
    found = {c.effect: next(iter(c.parameters.values())) for c in verdict.causes if c.confidence >= 0.7}
    assert set(found) == set(truth)
    for effect, value in truth.items():
        low, high = found[effect].interval
        assert low <= value <= high
    assert found["hinge.coulomb"].value == pytest.approx(truth["hinge.coulomb"], rel=0.1)
    assert found["hinge.viscous"].value == pytest.approx(truth["hinge.viscous"], rel=0.2)
    assert not verdict.unexplained.significant
