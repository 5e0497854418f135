"""Chosen parameters of a twin fitted to logs: values, intervals, and which are not separable."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from vpptwin.diagnosis.evidence.logged_inputs import describe_turned
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement.conclusion import estimate
from vpptwin.diagnosis.judgement.holdout import Score
from vpptwin.diagnosis.judgement.inferred import select_inferred
from vpptwin.diagnosis.judgement.material import prepare
from vpptwin.diagnosis.judgement.verdict import Estimate
from vpptwin.effects import find_effect
from vpptwin.estimation.measurements import list_warnings
from vpptwin.logs.flight import Flight
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.robot import Robot, by_robot
from vpptwin.twin.spec import TwinSpec

ALIKE = 0.9
"""Parameters whose errors correlate more than this can't be told apart by the flights."""
VAGUE = 0.5
"""A parameter whose standard deviation is more than this share of its prior's spread was hardly seen."""


@dataclass(frozen=True)
class LeastSquares:
    """The paper's estimate of drag: accelerations against thrust commands (System Identification, item 2)."""

    k_d: float  # N s²/m²
    std: float  # its standard deviation, neighbouring samples taken as alike over a tenth of a second
    samples: int  # number used


@dataclass(frozen=True)
class FlightFit:
    """Chosen parameters fitted to logs."""

    values: dict[Key, Estimate]  # (effect id, parameter) → estimate; not of effects that nothing shows
    alike: list[tuple[Key, Key, float]]  # pairs whose errors correlate, with their correlation, the worst first
    vague: list[Key]  # parameters that were hardly seen
    before: Score  # errors on held-out windows of the twin as it was
    after: Score  # and with the values
    windows: tuple[int, int]  # fitted, and held out
    drag: LeastSquares | None  # the paper's simple estimate, where drag was asked for and the log allows it
    warnings: list[str]  # about the logs


def parse_parameters(spec: TwinSpec, text: str) -> list[str]:
    """Effect ids from `air.drag,servo.lag`; a parameter's own name after the id is allowed.

    Raises:
        InputError: on an unknown effect, or none.
    """
    effects: list[str] = []
    for name in filter(None, (part.strip() for part in text.split(","))):
        known = {effect.id for effect in spec.catalogue}
        effect = name if name in known else name.rpartition(".")[0]
        if effect not in known:
            try:
                find_effect(spec.catalogue, name)
            except KeyError as error:
                found, expected = f"--parameters: unknown effect {name!r}", f"an id such as {error.args[0]}"
                raise InputError(found, expected, "`vpptwin effects` lists all") from error
        known_parameters = [p.name for p in find_effect(spec.catalogue, effect).parameters]
        if effect != name and name.rpartition(".")[2] not in known_parameters:
            found = f"--parameters: {effect} has no parameter {name.rpartition('.')[2]!r}"
            raise InputError(found, ", ".join(known_parameters), "rename it")
        if find_effect(spec.catalogue, effect).touching:
            found, expected = f"--parameters: {effect}, which only impacts show", "effects that show in all motion"
            raise InputError(found, expected, "leave it out; `vpptwin diagnose` judges impacts")
        if effect not in effects:
            effects.append(effect)
    if not effects:
        raise InputError("--parameters names none", "effect ids, separated by commas", "e.g. air.drag,servo.lag")
    return effects


def fit_flights(
    spec: TwinSpec, flights: Sequence[Flight], effects: Sequence[str],
    stage: Callable[[str], None] = lambda text: None, progress: Callable[[int], None] | None = None,
) -> FlightFit:  # fmt: skip
    """Fit these effects, all others uncertain within their build tolerance, and measure the gain on held-out windows.

    Args:
        spec: the twin.
        flights: logs; with several, whole logs may be held out.
        effects: ids.
        stage: called with the present step, in words.
        progress: called with the number of inner steps that were simulated.

    Raises:
        InputError: as `diagnose`.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        material = prepare(spec, flights, stage, progress, causes=effects)
        search, chosen = material.search, material.inferred.chosen
        fit = select_inferred(material.inferred, search).fit
        stage("judging on held-out windows")
        before, after = material.held_out.score({}), material.held_out.score(fit.values)
    fitted = [unknown for unknown in search.unknowns if unknown.effect.id in fit.effects]
    freed = [list(chosen.values).index(unknown.key) for unknown in fitted]
    asked = [unknown for unknown in search.unknowns if unknown.effect.id in effects]
    return FlightFit(
        values={unknown.key: estimate(unknown, fit) for unknown in fitted},
        alike=pair_up([unknown.key for unknown in fitted], chosen.posterior.covariance[np.ix_(freed, freed)]),
        vague=[u.key for u in asked if u.key not in fit.std or fit.std[u.key] > VAGUE * u.width / 3.0],
        before=before,
        after=after,
        windows=(len(search.bench.windows), len(material.held_out.short.windows)),
        drag=regress_drag(spec.robot, flights) if "air.drag" in effects else None,
        warnings=[*describe_turned(search.bench.spec), *list_warnings(flights, material.measurements)],
    )


def pair_up(keys: Sequence[Key], covariance: np.ndarray) -> list[tuple[Key, Key, float]]:
    """Pairs whose errors correlate by more than `ALIKE`, with the correlation, the worst first; covariance (P, P)."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    likeness = covariance / deviation[:, None] / deviation
    pairs = [(keys[i], keys[j], float(likeness[i, j])) for i in range(len(keys)) for j in range(i)]
    return sorted((pair for pair in pairs if abs(pair[2]) > ALIKE), key=lambda pair: -abs(pair[2]))


@by_robot
def regress_drag(robot: Robot, flights: Sequence[Flight]) -> LeastSquares | None:
    """Air drag by a simple regression that a robot's room knows; of most robots none."""
    return None
