"""The pictures of a report, drawn from a diagnosis and from the twins' predictions, which are exported as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vpptwin.diagnosis.evidence.flights import HORIZONS_S
from vpptwin.diagnosis.evidence.noise import ANGLE, POSITION, NoiseFloor
from vpptwin.diagnosis.judgement.diagnose import Diagnosis
from vpptwin.diagnosis.judgement.verdict import Verdict
from vpptwin.diagnosis.judgement.wrench import WrenchPlot, plot_wrench
from vpptwin.diagnosis.report.prediction import FlightPrediction, Track
from vpptwin.effects import find_effect
from vpptwin.twin.sensors import PERFECT
from vpptwin.viz import plots

STRETCH = 8.0
"""Length of the flight that is shown beside the twin [s]."""


@dataclass(frozen=True)
class Pictures:
    """SVG elements, several for one subject where it takes several panels.

    Attributes:
        errors: by horizon, one for positions and one for angles.
        forces: cause → the missing force before and after.
        flight: pairs of log with twin and of residual, one for each measured quantity.
        flight_name: the log that `flight` shows.
        leftover: the force that is still missing.
    """

    errors: list[str]
    forces: dict[str, list[str]]
    flight: list[str]
    flight_name: str
    leftover: list[str]


def draw_pictures(diagnosis: Diagnosis, predictions: Sequence[FlightPrediction], noise: NoiseFloor) -> Pictures:
    """Draw everything; of several flights one is shown that no fit has seen."""
    verdict = diagnosis.verdict
    shown = predictions[int(diagnosis.held_out.short.windows.flight[-1])]
    return Pictures(
        errors=draw_errors(verdict, noise),
        forces={cause.effect: draw_force(diagnosis, cause.effect) for cause in verdict.causes},
        flight=draw_flight(shown),
        flight_name=shown.flight.path.name,
        leftover=draw_wrench(diagnosis.leftover_plot, "left") if diagnosis.leftover_plot is not None else [],
    )


def draw_errors(verdict: Verdict, noise: NoiseFloor) -> list[str]:
    """Errors over the horizon before and after, where the rig has slides and where it has hinges."""
    figures = []
    for key, label in ((POSITION, "position rmse [m]"), (ANGLE, "angle rmse [rad]")):
        before, floor = getattr(verdict.before, key), noise.rmse.get(key)
        after, interval = None, None
        if verdict.causes:
            after, interval = getattr(verdict.after, key), verdict.improvement.get(key)
        if before is not None:
            figures.append(plots.error_by_horizon(HORIZONS_S, before, after, floor, interval, label, noise.label))
    return figures


def draw_force(diagnosis: Diagnosis, effect_id: str) -> list[str]:
    """The missing force against what the accused effect follows; nothing for sensors, which make no force."""
    effect = find_effect(diagnosis.held_out.short.spec.catalogue, effect_id)
    if effect.writes and set(effect.writes) <= set(PERFECT):
        return []
    return draw_wrench(plot_wrench(diagnosis.held_out, diagnosis.values, effect), effect_id)


def draw_wrench(plot: WrenchPlot, subject: str) -> list[str]:
    """A missing force before and after."""
    return plots.residual_against(plot.quantity, plot.before, plot.after, plot.x_label, plot.y_label, subject)


def draw_flight(prediction: FlightPrediction) -> list[str]:
    """A stretch from the middle of a flight: log and twin, and their difference, for each measured quantity."""
    known = [track.time[np.isfinite(track.predicted).all(axis=0)] for track in prediction.tracks]
    first, last = max(t[0] for t in known), min(t[-1] for t in known)
    begin = max(first, 0.5 * (first + last) - 0.5 * STRETCH)
    figures = []
    for track in prediction.tracks:
        part = (track.time >= begin) & (track.time <= begin + STRETCH) & np.isfinite(track.predicted).all(axis=0)
        figures += draw_track(track, part, prediction.restarts)
    return figures


def draw_track(track: Track, part: np.ndarray, restarts: np.ndarray) -> list[str]:
    """Log with twin, and residual, of some samples of one quantity."""
    time, after = track.time[part], len(track.predicted) > 1
    cuts = restarts[(restarts >= time[0]) & (restarts <= time[-1])].tolist()
    predicted, residual = track.predicted[:, part], track.residual[:, part]
    twins, left = ((both[0], both[1] if after else None) for both in (predicted, residual))
    return [
        plots.prediction_overlay(time, track.measured[part], *twins, f"{track.name} [{track.unit}]", cuts),
        plots.residual_over_time(time, *left, track.noise, f"{track.name} residual [{track.unit}]", cuts),
    ]
