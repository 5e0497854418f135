"""Where something acts along a joint is found before any fit, on rigs that share no physics with the twin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from proving.mechanisms import draw_session
from vpptwin.diagnosis.evidence.forces import scale_twin
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.diagnosis.search.places import look_along
from vpptwin.effects import find_effect
from vpptwin.estimation.dynamics import measure_forces
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.read import read_flight
from vpptwin.twin import load_twin

SESSIONS = [("cogging", 3), ("tight_spot", 5), ("tight_spot", 2)]
"""Kinds, and sessions of seed 11: a carriage, a damped cart, a pendulum that swings free."""


@pytest.mark.parametrize(("kind", "number"), SESSIONS)
def test_places_come_from_inverse_dynamics(kind: str, number: int, tmp_path: Path) -> None:
    """The first place found is near the true one, about as strong: near enough to start a fit from."""
    recorded = draw_session(11, number, kind).record(tmp_path)
    spec = load_twin(recorded.twin)
    measurements = [read_measurements(spec, read_flight(log)) for log in recorded.logs]
    spec = scale_twin(spec, measurements)
    ((effect_id, true),) = recorded.truth.hidden.items()
    found, *others = look_along(spec, measure_forces(spec, measurements), find_effect(spec.catalogue, effect_id))
    assert len(others) == 1
    assert 0.4 < found["force"] / true["force"] < 1.2
    if kind == "tight_spot":
        assert abs(found["place"] - true["place"]) < 0.7 * true["width"]
        assert 0.4 < found["width"] / true["width"] < 2.5
    else:
        assert found["waves"] == pytest.approx(true["waves"], rel=0.05)
        assert np.cos(found["phase"] - true["phase"]) > 0.8


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "number"), SESSIONS)
def test_what_is_here_or_there_is_named(kind: str, number: int, tmp_path: Path) -> None:
    """Hidden well above what the logs show: named alone and with confidence, with its place and its size."""
    recorded = draw_session(11, number, kind).record(tmp_path)
    verdict = diagnose(load_twin(recorded.twin), [read_flight(log) for log in recorded.logs]).verdict
    ((effect_id, true),) = recorded.truth.hidden.items()
    assert [cause.effect for cause in verdict.causes] == [effect_id]
    assert verdict.causes[0].confidence > 0.9
    for name, value in true.items():
        estimate = verdict.causes[0].parameters[name]
        assert abs(estimate.value - value) < max(4.0 * estimate.std, 0.02 * abs(value))
