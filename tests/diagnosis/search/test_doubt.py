"""Noise in logged torques makes no joint heavier: rigs simulated by their own equations, under feedback."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from proving.mechanisms import Session, draw_session
from vpptwin.diagnosis.judgement.diagnose import prepare
from vpptwin.diagnosis.search.fits import Fit
from vpptwin.diagnosis.search.search import Search
from vpptwin.logs.read import read_flight
from vpptwin.twin import load_twin


def search_logs(session: Session, folder: Path) -> Search:
    """The search for causes in a session's logs, before any is tried."""
    recorded = session.record(folder)
    flights = [read_flight(log) for log in recorded.logs]
    return prepare(load_twin(recorded.twin), flights, lambda text: None, None).search


def suspect(search: Search, effect: str) -> tuple[Fit, Fit]:
    """A suspect fitted alone, judged by what gusts do to the nominal twin, and by its own too."""
    start = next(start for start in search.rank(search.start) if start.effect == effect)
    fit = search.fit(frozenset({effect}), start.values, search.start.about)
    loose = search.responses.without_dry_friction(fit.frame.floor, fit.values)
    return search._polish(fit, loose), search.judge_alone(fit)


def test_noise_of_logged_torques_is_no_inertia(tmp_path: Path) -> None:
    """Torques of an arm of six joints that are logged with noise of 0.1 % to 1 % of what is usual, and nothing hidden.

    Joint 4 is light: what is logged of its torque, mostly noise, moves a heavier one less.
    """
    session = draw_session(66641, 1)
    short = replace(session.motions[0], duration=12.0)
    search = search_logs(replace(session, hidden=(), motions=(short,)), tmp_path)
    nominal, judged = suspect(search, "joint_4.inertia")
    assert nominal.evidence_against(search.start) > 2.0 * search.criteria.bar
    assert judged.evidence_against(search.start) < 0.0


@pytest.mark.parametrize(
    ("number", "effect"),
    [
        pytest.param(4, "joint1.inertia", marks=pytest.mark.slow), (1, "pole.inertia"),
        pytest.param(7, "shoulder.inertia", marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_an_inertia_that_is_there_keeps_its_evidence(number: int, effect: str, tmp_path: Path) -> None:
    """Double pendulums and a cart-pole in which that is hidden."""
    search = search_logs(draw_session(901, number, "inertia"), tmp_path)
    nominal, judged = suspect(search, effect)
    drop = nominal.evidence_against(search.start)
    assert drop > 400.0
    assert judged.evidence_against(search.start) == pytest.approx(drop, rel=0.05)
