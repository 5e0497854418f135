"""One session: flown in a batch with others, diagnosed alone."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from proving.drone import fly_many, write_mcap
from proving.drone.flight import FlightPlan
from proving.runner.case import Case, Finding, Named
from proving.runner.draw import Plan
from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.diagnosis.judgement.verdict import Verdict
from vpptwin.logs.flight import Flight
from vpptwin.logs.read import read_flight
from vpptwin.twin import load_twin

MANOEUVRES = ("creep", "aggressive", "mixed")
"""One flight each: holds and slow moves, everything fast, and a bit of everything with a low pass."""
KNOCKS = ("knock", "knock", "mixed", "knock")
"""Those of sessions that hide what shows at the wall alone."""
DURATION, LONG = 16.0, 24.0
"""Of each flight [s], and of these."""


def fly_sessions(plans: Sequence[Plan], folder: Path) -> list[list[Path]]:
    """Fly sessions in one batch, all realism on; write and return the logs of each."""
    knocks = any(plan.knocks for plan in plans)  # of one campaign all do or none
    manoeuvres = KNOCKS if knocks else MANOEUVRES
    flights: list[FlightPlan] = [
        {
            "effects": plan.small | plan.hidden, "manoeuvre": name, "duration": LONG if knocks else DURATION,
            "seed": plan.rig + 1 + i, "session": plan.rig, "wind": plan.wind, "distractors": True,
            "outliers": plan.outliers,
        }
        for plan in plans
        for i, name in enumerate(manoeuvres)
    ]  # fmt: skip
    logs: list[list[Path]] = [[] for _ in plans]
    for i, recording in enumerate(fly_many(flights)):
        session, flight = divmod(i, len(manoeuvres))
        home = folder / f"case_{plans[session].number:04d}"
        home.mkdir(parents=True, exist_ok=True)
        logs[session].append(write_mcap(recording, home / f"{flight}_{recording.manoeuvre}.mcap"))
    return logs


def run_session(plan: Plan, logs: Sequence[Path], oracle: bool) -> Case:
    """Diagnose a session's logs; a diagnosis that fails is a result too.

    Args:
        plan: what was hidden.
        logs: of its flights.
        oracle: fit the true structure too.
    """
    try:
        flights = [read_flight(log) for log in logs]
        return diagnose_session(plan, flights, oracle)
    except Exception as error:
        return Case(plan, None, error=f"{type(error).__name__}: {error}")


def diagnose_session(plan: Plan, flights: Sequence[Flight], oracle: bool) -> Case:
    """Diagnose flights, and fit the truth to them."""
    found, best = find(flights), None
    if oracle and plan.known:  # a diagnosis that named all of them and nothing else has fitted that structure
        best = found if set(found.named) == plan.known else find(flights, plan.known)
    return Case(plan, found, best)


def find(flights: Sequence[Flight], truth: frozenset[str] | None = None, criteria: Criteria = CRITERIA) -> Finding:
    """Diagnose flights with the nominal twin, or judge the true structure where that is given."""
    began = time.perf_counter()
    causes = None if truth is None else sorted(truth)
    diagnosis = diagnose(load_twin(), flights, criteria=criteria, causes=causes)
    return read_verdict(diagnosis.verdict, time.perf_counter() - began)


def read_verdict(verdict: Verdict, seconds: float) -> Finding:
    """What is counted of a verdict."""
    causes = [
        Named(
            cause.effect,
            round(cause.confidence, 4),
            round(cause.gain, 4),
            {name: {"value": e.value, "std": e.std, "nominal": e.nominal} for name, e in cause.parameters.items()},
            {rival.effect: round(rival.sigma, 2) for rival in cause.also_explained_by},
        )
        for cause in verdict.causes
    ]
    return Finding(
        causes,
        verdict.unexplained.significant,
        verdict.unexplained.channel or "",
        (verdict.before.chi2, verdict.after.chi2),
        [suspect.effect for suspect in verdict.unseen],
        verdict.experiment.manoeuvre if verdict.experiment else "",
        round(seconds, 1),
        verdict.gap,
    )
