"""How far manoeuvres separate causes that look alike, as predicted, and as flown with gusts.

python benchmarks/next_experiment.py [--fly]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from vpptwin.diagnosis.evidence.flights import SETTLE, build_bench
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.search.hypotheses import open_fitter
from vpptwin.diagnosis.search.separation import separate
from vpptwin.diagnosis.search.suspects import list_unknowns
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.flight import Flight
from vpptwin.robots.planar_drone.experiment import FlownManoeuvre, fly_library, observe_candidates
from vpptwin.robots.planar_drone.pilot.flight import SETTLING, fly
from vpptwin.robots.planar_drone.pilot.gusts import CARRIERS, GustProcess
from vpptwin.robots.planar_drone.pilot.manoeuvre import Manoeuvre
from vpptwin.robots.planar_drone.pilot.recording import record_streams
from vpptwin.robots.planar_drone.pilot.scripted import ScriptedPilot
from vpptwin.twin import Twin, TwinSpec, load_twin


@dataclass(frozen=True)
class Explanation:
    """Effects with their parameters."""

    effects: frozenset[str]
    values: dict[Key, float]


def blame(effect: str, **values: float) -> Explanation:
    """One effect."""
    return Explanation(frozenset({effect}), {(effect, name): value for name, value in values.items()})


GAIN = blame("rotor.thrust_gain", gain=0.91)
CASES = (
    (blame("command.delay", delay=0.008), blame("servo.lag", time_constant=0.028)),
    (blame("airframe.mass", mass=0.05), GAIN),
    (blame("rail_x.viscous", damping=0.3), blame("air.drag", k_d=0.15), blame("rotor.in_plane", damping=3e-4)),
    (blame("rail_x.coulomb", force=0.15), blame("rail_x.jamming", mu=0.01)),
    (blame("air.ground_effect", gain=0.2, height=0.3), GAIN),
    (blame("rail_x.bias", force=0.3), blame("rail.tilt", angle=-0.053)),
)


def fly_and_fit(spec: TwinSpec, manoeuvre: Manoeuvre, case: tuple[Explanation, ...]) -> list[float]:
    """Fly a manoeuvre with gusts in the twin of the first explanation; sigma by which each rival then fits worse."""
    effects: dict[str, dict[str, float]] = {}
    for (effect, name), value in case[0].values.items():
        effects.setdefault(effect, {})[name] = value
    pilot = ScriptedPilot(spec.vehicle, [manoeuvre.plan(spec.vehicle, {})])
    gusts = GustProcess(spec, 1, pilot.ticks + round(SETTLING * spec.vehicle.control.policy_rate), 7)
    tracks = fly(Twin(spec.with_effects(effects), 1, CARRIERS, num_threads=1), pilot, 7, gusts)
    flight = read_measurements(spec, Flight(Path(manoeuvre.name), 0, record_streams(tracks), {}))
    length = spec.robot.window
    bench = build_bench(spec, [flight], [np.arange(flight.start + SETTLE, flight.end - length, length)], length, False)
    fitter = open_fitter(bench, list_unknowns(spec), bench)
    evidence = [fitter.fit(e.effects, e.values).evidence for e in case]
    return [float(np.sqrt(max(2.0 * (evidence[0] - rival), 0.0))) for rival in evidence[1:]]


def print_case(spec: TwinSpec, case: tuple[Explanation, ...], flown: bool) -> None:
    """One line of the table for every rival."""
    candidates: list[FlownManoeuvre] = fly_library(spec, case)
    bench = observe_candidates(spec, candidates)
    windows = np.array([c.manoeuvre.duration / spec.robot.window for c in candidates])
    sigma = separate(bench, case, list_unknowns(spec), windows)
    names = [c.manoeuvre.name for c in candidates]
    best = int(np.argmax(sigma.min(axis=0)))
    measured = fly_and_fit(spec, candidates[best].manoeuvre, case) if flown else []
    for i, rival in enumerate(case[1:]):
        told = " | ".join(f"{sigma[i, names.index(name)]:.1f}" for name in ("x_steps", "hover") if name in names)
        line = f"| `{min(case[0].effects)}` | `{min(rival.effects)}` | {names[best]} | {sigma[i, best]:.1f} | {told} |"
        print(line + (f" {measured[i]:.1f} |" if flown else ""), flush=True)


def main() -> None:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fly", action="store_true", help="fly the best manoeuvre with gusts and fit both to its log")
    flown = parser.parse_args().fly
    spec = load_twin()
    print("| named | rival | best manoeuvre | sigma in 20 s | by x_steps | by hover |" + (" flown |" if flown else ""))
    print("|---" * (7 if flown else 6) + "|")
    with threadpool_limits(limits=1, user_api="blas"):
        for case in CASES:
            print_case(spec, case, flown)


if __name__ == "__main__":
    main()
