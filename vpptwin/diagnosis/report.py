"""report.html: one file that opens offline, with the sentence first and the evidence after it."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from vpptwin import __version__
from vpptwin.diagnosis.bench import Variation
from vpptwin.diagnosis.diagnose import Diagnosis
from vpptwin.diagnosis.holdout import HORIZONS_S, HeldOut, Score
from vpptwin.diagnosis.summary import (
    describe_cause,
    describe_leftover,
    describe_rivals,
    format_value,
    headline,
    tabulate_errors,
)
from vpptwin.diagnosis.wrench import plot_wrench
from vpptwin.effects import find_effect
from vpptwin.viz import plots

OVERLAY_WINDOWS = 8
"""Windows of one second that the overlay shows."""


def render_report(diagnosis: Diagnosis) -> str:
    """The report of a diagnosis as one HTML page."""
    verdict = diagnosis.verdict
    environment = Environment(
        loader=PackageLoader("vpptwin.diagnosis"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    template = environment.get_template("report.html.j2")
    causes = [
        {
            "cause": cause,
            "sentence": describe_cause(cause),
            "certainty": describe_rivals(cause),
            "parameters": {name: format_value(e) for name, e in cause.parameters.items()},
            "picture": Markup(draw_wrench(diagnosis, cause.effect)),
        }
        for cause in verdict.causes
    ]
    return template.render(
        version=__version__,
        date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        verdict=verdict,
        headline=headline(verdict),
        leftover=describe_leftover(verdict),
        causes=causes,
        tables=tabulate_errors(verdict.before, verdict.after),
        horizon=Markup(draw_horizon(verdict.before, verdict.after if verdict.causes else None)),
        ranking=Markup(draw_ranking(diagnosis)),
        overlay=Markup(draw_overlay(diagnosis.held_out, diagnosis)),
    )


def draw_horizon(before: Score, after: Score | None) -> str:
    """Error over the horizon before and after."""
    return plots.error_by_horizon(HORIZONS_S, curves(before), curves(after) if after is not None else None)


def curves(score: Score) -> dict[str, list[float]]:
    """The curves of a score that the plot knows."""
    named = {"position_rmse_m": score.position_rmse_m, "angle_rmse_rad": score.angle_rmse_rad}
    return {name: values for name, values in named.items() if values is not None}


def draw_wrench(diagnosis: Diagnosis, effect_id: str) -> str:
    """The missing force against what the accused effect follows."""
    effect = find_effect(diagnosis.held_out.short.spec.catalogue, effect_id)
    plot = plot_wrench(diagnosis.held_out, diagnosis.values, effect)
    return plots.residual_against(plot.quantity, plot.before, plot.after, plot.x_label, plot.y_label)


def draw_ranking(diagnosis: Diagnosis) -> str:
    """The best-ranked suspects by the drop in misfit that each alone brings."""
    shown = [(name, max(drop, 0.0)) for name, drop in diagnosis.ranking[:12]]
    accused = [cause.effect for cause in diagnosis.verdict.causes]
    return plots.suspects_ranking([name for name, _ in shown], [drop for _, drop in shown], accused)


def draw_overlay(held_out: HeldOut, diagnosis: Diagnosis) -> str:
    """Consecutive held-out windows: measured, and predicted before and after."""
    bench = held_out.long
    # Long windows overlap by half: every second one makes a continuous stretch.
    shown = np.arange(0, min(2 * OVERLAY_WINDOWS, len(bench.windows)), 2)
    variations = [Variation(), Variation(diagnosis.values)]
    pose, velocity = bench.simulate(variations)
    sensors = [bench.sensors(v.values) for v in variations]
    channels = [c for c in bench.channels if c.kind == "position"]
    seen = np.all([c.weight[shown].sum(axis=2) > 0 for c in channels], axis=0)
    time = (bench.windows.start[:, None] + (channels[0].offset * channels[0].weight).sum(axis=2))[shown][seen]
    measured, before, after = (np.empty((len(time), len(channels))) for _ in range(3))
    for i, channel in enumerate(channels):
        measured[:, i] = channel.value[shown][seen]
        for j, into in enumerate((before, after)):
            predicted = bench.observe_channel(channel, pose[j], velocity[j], sensors[j])
            into[:, i] = predicted[shown][seen]
    labels = [f"{c.name} [{c.unit}]" for c in channels]
    starts = bench.windows.start[shown].tolist()
    extended = after if diagnosis.verdict.causes else None
    return plots.prediction_overlay(time, measured, before, extended, labels, restarts=starts)
