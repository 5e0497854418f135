"""A diagnosis of a demo flight that nobody searched for: real windows and predictions, everything else made up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path

import pytest

from vpptwin.diagnosis.evidence.flights import choose_window, list_starts
from vpptwin.diagnosis.evidence.preflight import inspect_flight
from vpptwin.diagnosis.judgement.diagnose import Diagnosis
from vpptwin.diagnosis.judgement.material import open_held_out
from vpptwin.diagnosis.judgement.verdict import (
    Cause,
    Cleared,
    Estimate,
    Experiment,
    Rival,
    Unexplained,
    Unseen,
    Verdict,
)
from vpptwin.diagnosis.judgement.wrench import plot_wrench
from vpptwin.drift.free_flight import FlightFit
from vpptwin.effects import find_effect
from vpptwin.estimation.measurements import list_warnings, read_measurements
from vpptwin.logs.flight import Flight
from vpptwin.logs.read import read_flight
from vpptwin.report import result
from vpptwin.twin.spec import TwinSpec, load_twin

FLIP = Path(__file__).resolve().parents[2] / "demo/flights/flip.mcap"
VALUES = {("rail_x.coulomb", "force"): 0.306, ("gyro.bias", "bias"): 0.012}
CAUSES = [
    Cause(
        "rail_x.coulomb", 0.93, {"force": Estimate(0.306, "N", 0.006, 0.0)}, 0.79,
        [Rival("rail_x.viscous", 0.06, 2.4)], "dry friction on the horizontal rail", (0.74, 0.83),
    ),
    Cause("gyro.bias", 0.999, {"bias": Estimate(0.012, "rad/s", 0.002, 0.0)}, 0.05, [], "a bias of the gyro"),
]  # fmt: skip
LEFT = Unexplained(True, 0.16, "force on rail_x", ["rail_x position"], 4.7)
UNSEEN = [
    Unseen("air.ground_effect", "never below 0.6 m"),
    Unseen("rotor.drag", "no rotor speeds in the logs"),
    Unseen("battery.sag", "no rotor speeds in the logs"),
]
EXPERIMENT = Experiment(
    "x_steps", {"size": 0.5, "hold": 1.2}, ["rail_x.coulomb", "rail_x.viscous"], 9.3,
    "vpptwin fly --pilot scripted --manoeuvre x_steps --set size=0.5 --set hold=1.2 --out next.mcap",
)  # fmt: skip


@cache
def read_demo() -> tuple[TwinSpec, Flight]:
    """The nominal twin and a demo flight."""
    return load_twin(), read_flight(FLIP)


@cache
def make_diagnosis() -> Diagnosis:
    """Two causes, a rival, a remainder, suspects cleared and unseen, a next flight."""
    spec, flight = read_demo()
    measurements = [read_measurements(spec, flight)]
    starts = [list_starts(measurements, spec.robot.window)[0][10:25]]
    held_out = open_held_out(spec, measurements, starts, None)
    before, after = held_out.score({}), held_out.score(VALUES)
    accused = {*(cause.effect for cause in CAUSES), *(s.effect for s in UNSEEN), "rail_x.viscous"}
    cleared = [
        Cleared(e.id, p.name, -p.size if p.low < 0.0 else 0.0, p.size, p.unit)
        for e in spec.catalogue
        for p in e.parameters[:1]
        if e.id not in accused and p.off == 0.0
    ]
    verdict = Verdict(
        logs=[str(flight.path)], twin=spec.name, windows=120, held_out_windows=len(held_out.short.windows),
        before=before, after=after, gap=True, causes=CAUSES, unexplained=LEFT, cleared=cleared, unseen=UNSEEN,
        improvement={key: [(-0.15, 0.02), (-0.5, -0.3), (-0.7, -0.6), (-0.6, -0.4), (-0.3, -0.1)]
                     for key in ("position_rmse_m", "angle_rmse_rad", "θ rate")},
        experiment=EXPERIMENT, warnings=["flip.mcap: 2 gaps over 0.05 s on /mocap/pose, the longest 0.07 s at 9.1 s",
                  "gyro.bias: held-out log does not show it by itself"],
    )  # fmt: skip
    suspects = [effect for effect in spec.catalogue if not effect.touching]
    ranking = [(effect.id, 2000.0 * 0.6**i) for i, effect in enumerate(suspects)]
    friction = find_effect(spec.catalogue, "rail_x.coulomb")
    plot = plot_wrench(held_out, VALUES, friction)
    return Diagnosis(verdict, VALUES, ranking, held_out, plot, measurements=measurements)


MEMORY: dict[str, object] = {}


def make_up(patch: pytest.MonkeyPatch) -> None:
    """Have diagnoses made up, and predicted and drawn once in a process: all these runs are of one flight."""
    patch.setattr(result, "judge", lambda *given, **named: make_diagnosis())
    for name in ("predict_flight", "draw_pictures"):
        patch.setattr(result, name, partial(remember, name, getattr(result, name)))


def remember(name: str, function: Callable[..., object], *arguments: object) -> object:
    """What the function gave the first time."""
    if name not in MEMORY:
        MEMORY[name] = function(*arguments)
    return MEMORY[name]


def find_nothing(spec: TwinSpec, flights: Sequence[Flight], *given: object, **named: object) -> Diagnosis:
    """A diagnosis of any rig's flights in which nobody searched for anything: a window of each judges."""
    measurements = [read_measurements(spec, flight) for flight in flights]
    spec, measurements = choose_window(spec, measurements)
    starts = [each[:1] for each in list_starts(measurements, spec.robot.window)]
    held_out = open_held_out(spec, measurements, starts, None)
    score, rest = held_out.score({}), Unexplained(False, 0.0, None, [])
    logs, warnings = [str(flight.path) for flight in flights], list_warnings(flights, measurements)
    verdict = Verdict(logs, spec.name, 1, len(flights), score, score, False, [], rest, [], [], {}, warnings=warnings)
    preflight = [inspect_flight(spec, each) for each in measurements]
    return Diagnosis(verdict, {}, [], held_out, None, preflight, measurements)


def fit_nothing(spec: TwinSpec, flights: Sequence[Flight], effects: Sequence[str], *told: object) -> FlightFit:
    """A fit that nothing was found by."""
    found = find_nothing(spec, flights).verdict
    return FlightFit({}, [], [], found.before, found.after, (1, 1), None, found.warnings)
