"""Which way weight pulls: an MJCF without gravity, or with gravity or the axis of a joint upside down.

Where it is constant, as on a lift, a constant force hides that. So none is allowed for here: a rig with one is
explained badly as it is given, but no better by a weight of its own size that is not there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np

from vpptwin.estimation.checks.balance import POOR, Explained, explain, find_mended, list_judged, makes_worse
from vpptwin.estimation.checks.readings import MOST, Column, Reading, list_efforts, list_kin, scale_columns
from vpptwin.estimation.dynamics import find_driven_joint
from vpptwin.estimation.measurements import read_measurements
from vpptwin.estimation.series import Measurements
from vpptwin.logs.flight import Flight
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import TwinSpec

DOWN = (0.0, 0.0, -9.81)
"""Gravity where an MJCF says nothing [m/s²]."""


class Upside(NamedTuple):
    """A twin and a log in which weight pulls otherwise: what is wrong if they are right, and what to do."""

    spec: TwinSpec
    measured: Measurements
    found: str
    action: str


def compare_weight(
    spec: TwinSpec, flights: Sequence[Flight], measurements: Sequence[Measurements]
) -> InputError | None:  # fmt: skip
    """What is wrong with the weight that the MJCF has for the log of which it explains least; None where nothing is."""
    judged = list_judged(spec)
    logs = zip(flights, measurements, strict=True) if judged.any() and not spec.model.neq else ()
    told = [(flight, log, given) for flight, log in logs if (given := explain(spec, log, level=False)) is not None]
    if not told:
        return None
    flight, log, given = max(told, key=lambda each: float(np.minimum(each[2].loose, 1.0)[judged].sum()))
    poor, best = judged & (given.loose > POOR), list[tuple[float, Upside, Explained]]()
    for upside in list_upside(spec, flight, log) if poor.any() else ():
        other = explain(upside.spec, upside.measured, level=False)
        if other is None or makes_worse(given, other, judged):
            continue
        if 2 * np.count_nonzero(find_mended(given, other) & poor) >= np.count_nonzero(poor):
            best.append((float(np.minimum(other.tight, 1.0)[judged].mean()), upside, other))
    if not best:
        return None
    _, upside, other = min(best, key=lambda each: each[0])
    most = int(np.argmax(np.where(poor, given.loose - other.tight, -1.0)))
    shares = f"{1.0 - other.tight[most]:.0%} of the force on {spec.robot.name_dof(most)}, "
    why = f"explains {shares}{max(1.0 - given.loose[most], 0.0):.0%} as given"
    return InputError(f"{log.name}: {upside.found} {why}", "weight as it pulls on the rig", upside.action)


def list_upside(spec: TwinSpec, flight: Flight, log: Measurements) -> Iterator[Upside]:
    """The twin with gravity, or with gravity turned round; then the log with one joint and its drive turned round."""
    gravity = spec.model.opt.gravity
    strength = float(np.linalg.norm(gravity))
    model, turned = copy(spec.model), np.array(DOWN) if strength == 0.0 else -gravity
    model.opt.gravity[:] = turned
    line = f'write <option gravity="{" ".join(f"{g + 0.0:g}" for g in turned)}"/> into the MJCF'
    found = "the MJCF has no gravity; with it, it" if strength == 0.0 else "with gravity the other way the MJCF"
    yield Upside(spec.with_robot(model=model), log, found, line)
    kin, drives = list_kin(spec, flight), dict[str, list[Column]]()
    for actuator, (_, column) in list_efforts(spec, flight).items():
        joint = find_driven_joint(spec.model, spec.model.actuator(actuator).id)
        if joint is not None:
            drives.setdefault(spec.model.joint(joint).name, []).append(column)
    for name, (_, columns) in kin.items() if len(kin) <= MOST and strength else ():
        if columns and columns[0].group == "joints":
            reading = Reading("", "", scale_columns([*columns, *drives.get(name, [])], -1.0))
            try:
                taken = read_measurements(spec, reading.read(spec.robot.signals, flight))
            except InputError:
                continue
            found, axis = f"with {name} and its drive the other way the MJCF", spec.model.joint(name).axis
            line = f'write axis="{" ".join(f"{-a + 0.0:g}" for a in axis)}" for {name} into the MJCF'
            yield Upside(spec, taken, found, line)
