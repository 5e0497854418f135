"""The next experiment: which manoeuvre of the library separates the rivals that the logs do not."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.flights import SETTLE, build_bench
from vpptwin.diagnosis.judgement.verdict import Experiment
from vpptwin.diagnosis.search.separation import Hypothesis, separate
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.flight import Flight
from vpptwin.robots.planar_drone.craft import PlanarDrone
from vpptwin.robots.planar_drone.pilot.flight import fly
from vpptwin.robots.planar_drone.pilot.library import LIBRARY
from vpptwin.robots.planar_drone.pilot.manoeuvre import Manoeuvre
from vpptwin.robots.planar_drone.pilot.recording import record_streams
from vpptwin.robots.planar_drone.pilot.reference import Reference
from vpptwin.robots.planar_drone.pilot.safety import find_danger
from vpptwin.robots.planar_drone.pilot.scripted import ScriptedPilot
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin, TwinSpec

FLOWN = 12.0
"""Of every manoeuvre, in the twin [s]; what is predicted is for the manoeuvre's own duration."""
SHARE = 0.25
"""Of a flight's windows that is looked at: spread evenly, but in step with nothing that the manoeuvre repeats."""
GOLDEN = 0.5 * (5.0**0.5 - 1.0)


@dataclass(frozen=True)
class FlownManoeuvre:
    """A manoeuvre that is safe whichever hypothesis is true, flown in the twin of the first."""

    manoeuvre: Manoeuvre
    flight: Flight


def propose_experiment(
    spec: TwinSpec, hypotheses: Sequence[Hypothesis], unknowns: Sequence[Unknown], criteria: Criteria = CRITERIA
) -> Experiment | None:
    """The safe manoeuvre after which the named hypothesis and its rivals are furthest apart.

    Every manoeuvre of the library is flown in the twin. A rival is as far away as its misfit says that it keeps after
    its own parameters were refitted and all others moved within their build tolerance. Of several rivals the nearest
    counts, those apart that no manoeuvre tells from the named one.

    Args:
        spec: the twin that was diagnosed.
        hypotheses: the named one first, then its rivals, with the values fitted to the logs so far.
        unknowns: parameters that may be wrong, of all effects.
        criteria: those of the diagnosis.

    Returns:
        The experiment; None where there is none, for a reason that `explain_absence` gives.
    """
    if explain_absence(spec, hypotheses):
        return None
    with threadpool_limits(limits=1, user_api="blas"):
        candidates = fly_library(spec, hypotheses)
        if not candidates:
            return None
        bench = observe_candidates(spec, candidates, criteria)
        times = np.array([c.manoeuvre.duration / spec.robot.window for c in candidates])
        sigma = separate(bench, hypotheses, unknowns, times)
    told = [i for i in range(len(sigma)) if sigma[i].max() >= criteria.worth_flying]
    if not told:
        return None
    nearest = sigma[told].min(axis=0)
    best = int(np.argmax(nearest))
    named = hypotheses[0].effects
    rivals = [hypotheses[1 + i].effects for i in told]
    separates = sorted(set().union(*(named - rival for rival in rivals)))
    separates += sorted(set().union(*(rival - named for rival in rivals)))
    manoeuvre = candidates[best].manoeuvre
    return Experiment(
        manoeuvre.name, manoeuvre.choose({}), separates, float(nearest[best]), compose_command(manoeuvre, spec)
    )


def propose(
    robot: PlanarDrone,
    spec: TwinSpec,
    hypotheses: Sequence[Hypothesis],
    unknowns: Sequence[Unknown],
    criteria: Criteria,
) -> Experiment | None:
    """What a diagnosis of the drone asks for: `propose_experiment`."""
    return propose_experiment(spec, hypotheses, unknowns, criteria)


def explain_absence(spec: TwinSpec, hypotheses: Sequence[Hypothesis]) -> str:
    """Why no experiment can be proposed, "" where one may be.

    That `propose_experiment` gives None nevertheless means that no safe manoeuvre of the library tells them apart.
    """
    if spec.robot.rotorcraft is None:
        return "the library's manoeuvres are for the drone, and this rig is another"
    if len(hypotheses) < 2:
        return "there is nothing to tell apart"
    return ""


def compose_command(manoeuvre: Manoeuvre, spec: TwinSpec) -> str:
    """What to type to see a manoeuvre flown."""
    return (
        f"vpptwin fly --pilot scripted --manoeuvre {manoeuvre.name} --twin {shlex.quote(spec.name)} "
        f"--out {manoeuvre.name}.mcap"
    )


def fly_library(spec: TwinSpec, hypotheses: Sequence[Hypothesis]) -> list[FlownManoeuvre]:
    """Fly every manoeuvre under every hypothesis, side by side; keep those that are safe under all of them."""
    library, references = list_references(spec.vehicle)
    count = len(references)
    active = sorted({effect for hypothesis in hypotheses for effect in hypothesis.effects})
    twin = Twin(spec, count * len(hypotheses), active, num_threads=1)
    for i, hypothesis in enumerate(hypotheses):
        rows = np.arange(i * count, (i + 1) * count)
        for (effect, parameter), value in hypothesis.values.items():
            twin.set_parameter(effect, parameter, value, rows)
    tracks = fly(twin, ScriptedPilot(spec.vehicle, references * len(hypotheses)), seed=0)
    lead = tracks.lead[0]
    dangers = [find_danger(spec.vehicle, p[lead:], v[lead:]) for p, v in zip(tracks.pose, tracks.velocity)]
    return [
        FlownManoeuvre(manoeuvre, Flight(Path(manoeuvre.name), 0, record_streams(tracks, i), {}))
        for i, manoeuvre in enumerate(library)
        if not any(dangers[i::count])
    ]


def list_references(vehicle: Vehicle) -> tuple[list[Manoeuvre], list[Reference]]:
    """The manoeuvres that this vehicle's rails have room for, and their references."""
    library, references = [], []
    for manoeuvre in LIBRARY:
        with contextlib.suppress(InputError):
            references.append(manoeuvre.plan(vehicle, {}, FLOWN))
            library.append(manoeuvre)
    return library, references


def observe_candidates(spec: TwinSpec, candidates: Sequence[FlownManoeuvre], criteria: Criteria = CRITERIA) -> Bench:
    """Windows of every candidate's flight; `windows.flight` tells whose."""
    measurements = [read_measurements(spec, candidate.flight) for candidate in candidates]
    length = spec.robot.window
    starts = [np.arange(m.start + SETTLE, m.end - length, length) for m in measurements]
    starts = [every[GOLDEN * np.arange(len(every)) % 1.0 < SHARE] for every in starts]
    return build_bench(spec, measurements, starts, length, causal=False, criteria=criteria)
