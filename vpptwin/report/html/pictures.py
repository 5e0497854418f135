"""The pictures of a report, drawn from a diagnosis and from the twins' predictions, which are exported as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from vpptwin.diagnosis.evidence.flights import HORIZONS_S
from vpptwin.diagnosis.evidence.noise import ANGLE, POSITION, NoiseFloor
from vpptwin.diagnosis.judgement.diagnose import Diagnosis
from vpptwin.diagnosis.judgement.verdict import Verdict
from vpptwin.diagnosis.judgement.wrench import WrenchPlot, plot_wrench
from vpptwin.effects import find_effect
from vpptwin.report.error_table import is_changed
from vpptwin.report.html.fingerprints import draw_fingerprints
from vpptwin.report.output import Pieces
from vpptwin.report.prediction import FlightPrediction, PredictedSeries
from vpptwin.report.words import join_words
from vpptwin.twin.sensors import PERFECT
from vpptwin.viz.plots import plots
from vpptwin.viz.scene.sketch import sketch_rig

STRETCH = 8.0
"""Length of the flight that is shown beside the twin [s]."""
VISIBLE = 0.1
"""Share of a residual by which it must change for two lines to be told apart."""


@dataclass(frozen=True)
class Pictures:
    """SVG elements, several for one subject where it takes several panels; without what could not be drawn."""

    sketch: str = ""  # the rig, what is accused lit; "" for a rig without shapes
    forces: dict[str, list[str]] = field(default_factory=dict)  # cause → the missing force before and after
    errors: dict[str, list[str]] = field(default_factory=dict)  # quantity → its error by horizon
    flight: dict[str, list[str]] = field(default_factory=dict)  # measured quantity → log with twin, and residual
    # names in `errors` and `flight` of what the extended twin predicts as the other did, drawn once
    same: frozenset[str] = frozenset()
    flight_name: str = ""  # the log that `flight` shows
    leftover: list[str] = field(default_factory=list)  # the force that is still missing
    prints: dict[str, str] = field(default_factory=dict)  # effect → what it would do to these logs


def draw_pictures(
    diagnosis: Diagnosis, predictions: Sequence[FlightPrediction | None], noise: NoiseFloor, pieces: Pieces
) -> Pictures:
    """Draw everything that can be; of several flights one is shown that no fit has seen."""
    verdict, bench, draw = diagnosis.verdict, diagnosis.held_out.short, pieces.attempt
    shown, plot = predictions[int(bench.windows.flight[-1])], diagnosis.leftover_plot
    accused = [find_effect(bench.spec.catalogue, cause.effect) for cause in verdict.named]
    lit = f", lit: {join_words([effect.summary for effect in accused])}" if accused else ""
    errors, flight, none = list_errors(verdict), list[PredictedSeries](), list[str]()
    if shown is not None:
        flight = draw("pictures of log and twin", partial(cut_flight, shown), flight)
    same = {quantity for quantity, (_, before, after) in errors.items() if not is_changed(before, after)}
    same |= {track.name for track in flight if not is_told_apart(track)}
    restarts = shown.restarts if shown is not None else np.empty(0)
    tracks = {
        t.name: draw(f"the picture of {t.name}", partial(draw_track, t, restarts, t.name in same), none) for t in flight
    }
    return Pictures(
        sketch=draw("the sketch of the rig", lambda: sketch_rig(bench.spec.robot, accused, f"The rig{lit}"), ""),
        forces={
            cause.effect: draw(f"the force of {cause.effect}", partial(draw_force, diagnosis, cause.effect), none)
            for cause in verdict.named
        },
        errors={
            name: draw(f"the picture of {name} errors", partial(draw_error, verdict, noise, *found, name in same), none)
            for name, found in errors.items()
        },
        flight={name: drawings for name, drawings in tracks.items() if drawings},
        same=frozenset(same),
        flight_name=shown.flight.name if shown is not None else "",
        leftover=draw("the picture of the remainder", partial(draw_wrench, plot, "left"), none) if plot else [],
        prints=draw("pictures of candidates", partial(draw_fingerprints, bench), dict[str, str]()),
    )


def list_errors(verdict: Verdict) -> dict[str, tuple[str, Sequence[float], Sequence[float] | None]]:
    """What an error is of → its key in a score, before, and after; of slides and hinges, where the rig has them."""
    after = verdict.after if verdict.named else None
    return {
        name: (key, before, getattr(after, key, None))
        for name, key in (("position", POSITION), ("angle", ANGLE))
        if (before := getattr(verdict.before, key)) is not None
    }


def draw_error(
    verdict: Verdict, noise: NoiseFloor, key: str, before: Sequence[float], after: Sequence[float] | None, same: bool
) -> list[str]:
    """Errors over the horizon, before and after where they differ."""
    floor, interval = noise.rmse.get(key), verdict.improvement.get(key)
    shown, label = None if same else after, "position rmse [m]" if key == POSITION else "angle rmse [rad]"
    return [plots.error_by_horizon(HORIZONS_S, before, shown, floor, interval, label, noise.label)]


def is_told_apart(track: PredictedSeries) -> bool:
    """Whether both twins' residuals would be seen to differ; one twin has nothing to be told from."""
    first, last = track.residual[0], track.residual[-1]
    return len(track.predicted) == 1 or float(np.std(last - first)) > VISIBLE * float(np.std(first))


def draw_force(diagnosis: Diagnosis, effect_id: str) -> list[str]:
    """The missing force against what the accused effect follows; nothing for sensors, and for contacts: none shows."""
    effect = find_effect(diagnosis.held_out.short.spec.catalogue, effect_id)
    if effect.touching or (effect.writes and set(effect.writes) <= set(PERFECT)):
        return []
    found = plot_wrench(diagnosis.held_out, diagnosis.values, effect)
    return draw_wrench(found, effect_id, ("without it", "with it"))


def draw_wrench(plot: WrenchPlot, subject: str, titles: tuple[str, str] = ("before", "after")) -> list[str]:
    """A missing force before and after."""
    return plots.residual_against(plot.quantity, plot.before, plot.after, plot.x_label, plot.y_label, subject, titles)


def cut_flight(prediction: FlightPrediction) -> list[PredictedSeries]:
    """A stretch from the middle of a flight, every measured quantity where all twins were simulated."""
    tracks = [track for track in prediction.tracks if np.count_nonzero(track.known) > 1]
    if not tracks:
        return []
    known = [track.time[track.known] for track in tracks]
    first, last = max(t[0] for t in known), min(t[-1] for t in known)
    begin = max(first, 0.5 * (first + last) - 0.5 * STRETCH)
    cut = [t.take((t.time >= begin) & (t.time <= begin + STRETCH) & t.known) for t in tracks]
    return [track for track in cut if len(track.time) > 1]


def draw_track(track: PredictedSeries, restarts: np.ndarray, same: bool) -> list[str]:
    """Log with twin, and residual, of one quantity; both twins where they differ."""
    time, after = track.time, len(track.predicted) > 1 and not same
    cuts = restarts[(restarts >= time[0]) & (restarts <= time[-1])].tolist()
    twins, left = ((both[0], both[1] if after else None) for both in (track.predicted, track.residual))
    return [
        plots.prediction_overlay(time, track.measured, *twins, f"{track.name} [{track.unit}]", cuts),
        plots.residual_over_time(time, *left, track.noise, f"{track.name} residual [{track.unit}]", cuts),
    ]
