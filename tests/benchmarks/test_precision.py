"""What keeps a policy off its target: the benchmark that takes its last second apart."""

from __future__ import annotations

import argparse

import numpy as np
import pytest

from benchmarks import precision
from vpptwin.train.evaluate.evaluate import Conditions, evaluate


@pytest.fixture(scope="module")
def result() -> dict:
    """The shipped policy over 24 flights, and a linear controller that was hardly tuned."""
    return precision.report(argparse.Namespace(checkpoint="flip", tracks=24, seed=3, linear=2))


@pytest.mark.slow
def test_what_the_report_says(result: dict) -> None:
    """Same seed, same flights, same error as `evaluate`."""
    expected = evaluate("flip", Conditions(tracks=24, seed=3))
    assert result["fail_rate"] == expected["fail_rate"]
    assert result["error_m"] == pytest.approx(expected["position_error_m"]["mean"], rel=1e-9)
    # Perfection in one thing gains part of what rest lacks, at least as much as nothing.
    missing = result["missing_reward"]
    assert 0.0 < missing["all"] < 0.1
    parts = [missing[name] for name in ("position", "angle", "velocity", "rate", "integral")]
    assert all(0.0 <= part < missing["all"] for part in parts)
    assert sum(parts) == pytest.approx(missing["all"], rel=0.1)  # r_p multiplies the others
    # On each rail the bands hold all flights that did not fail.
    kept = round(24 * (1.0 - result["fail_rate"]))
    for rail in ("rail_x", "rail_z"):
        assert sum(count for name, _, _, count, _ in result["bands"] if name == rail) == kept
    # The policy made linear over ten centimetres hovers too, hardly tuned, if not as close as the bent one.
    policy, linear = (np.array(result["linear"][name]) for name in ("policy", "linear"))
    assert (policy > 0.0).all()
    assert 0.5 * policy[0] < linear[0] < 3.0 * policy[0]
    assert 0.5 * policy[1] < linear[1] < 3.0 * policy[1]


@pytest.mark.parametrize(
    ("arguments", "found"), [(["nowhere.pt"], "no checkpoint"), (["flip", "--json", "/nowhere/x.json"], "cannot write")]
)
def test_bad_input_is_refused_at_once(arguments: list[str], found: str, capsys: pytest.CaptureFixture[str]) -> None:
    """No checkpoint, nowhere to write: one line, exit status 2."""
    assert precision.main(arguments) == 2
    assert found in capsys.readouterr().err
