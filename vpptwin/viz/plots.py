"""The plots of reports, each returned as one inline SVG element."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from vpptwin.viz.figure import AFTER, BEFORE, INK, name_axes, open_figure, thin, write_svg
from vpptwin.viz.palette import GREY

ERROR_PANELS = {"position_rmse_m": "position rmse [m]", "angle_rmse_rad": "angle rmse [rad]"}
MOST_POINTS = 1000  # of a scatter plot
BINS = 16  # of the running median
FEWEST_IN_BIN = 8  # samples, below which a bin's quantiles say nothing
BAND = (0.1, 0.9)  # quantiles
MOST_SAMPLES = 2000  # of a line


def error_by_horizon(
    horizons_s: Sequence[float],
    before: Mapping[str, Sequence[float]],
    after: Mapping[str, Sequence[float]] | None = None,
    noise_floor: Mapping[str, float] | None = None,
) -> str:
    """Prediction error against horizon, before and after, on logarithmic axes.

    Args:
        horizons_s: (h,) time since the estimated state [s].
        before: position_rmse_m (h,) [m] and angle_rmse_rad (h,) [rad] of the twin as it was; panels for the keys there.
        after: likewise with the named causes; None when none was named.
        noise_floor: rmse of a perfect twin by the same keys.
    """
    keys = [key for key in ERROR_PANELS if key in before]
    with open_figure(3.6 * max(len(keys), 1), 2.9) as figure:
        for axes, key in zip(figure.subplots(1, len(keys), squeeze=False)[0], keys):
            axes.loglog(horizons_s, before[key], "o--", color=BEFORE, label="before")
            if after is not None:
                axes.loglog(horizons_s, after[key], "s-", color=AFTER, label="after")
            if noise_floor is not None and key in noise_floor:
                axes.axhline(noise_floor[key], color=GREY, linestyle=":", label="sensor noise")
            axes.set_xticks(list(horizons_s), [f"{h:g}" for h in horizons_s])
            axes.minorticks_off()
            axes.yaxis.set_major_formatter("{x:g}")
            widen_to_decades(axes)
            name_axes(axes, "horizon [s]", ERROR_PANELS[key])
            axes.legend()
        return write_svg(figure, "Prediction error against horizon")


def widen_to_decades(axes: Axes) -> None:
    """Extend a logarithmic y axis to whole decades, so that at least two ticks carry a number."""
    low, high = axes.get_ylim()
    axes.set_ylim(10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high)))


def residual_against(
    x: np.ndarray,
    residual_before: np.ndarray,
    residual_after: np.ndarray | None,
    x_label: str,
    y_label: str,
) -> str:
    """What the twin leaves unexplained against a quantity: samples, running median and the band of 80 % of them.

    Args:
        x: (n,) the quantity.
        residual_before: (n,) residual of the twin as it was.
        residual_after: (n,) residual with the named causes; None when none was named.
        x_label: the quantity with its unit, e.g. "rail velocity [m/s]".
        y_label: the residual with its unit.
    """
    panels = [("before", residual_before, BEFORE)]
    if residual_after is not None:
        panels.append(("after", residual_after, AFTER))
    with open_figure(3.6 * len(panels), 3.0) as figure:
        row = figure.subplots(1, len(panels), squeeze=False, sharex=True, sharey=True)[0]
        for axes, (title, residual, colour) in zip(row, panels):
            known = np.isfinite(x) & np.isfinite(residual)
            draw_residual(axes, np.asarray(x)[known], np.asarray(residual)[known], colour)
            name_axes(axes, x_label, y_label if axes is row[0] else "", title)
        if all(len(residual) for _, residual, _ in panels):
            limit_to_bulk(row[0], np.concatenate([residual for _, residual, _ in panels]))
        return write_svg(figure, f"{y_label} against {x_label}")


def draw_residual(axes: Axes, x: np.ndarray, residual: np.ndarray, colour: str) -> None:
    """Samples, running median and quantile band of one residual."""
    axes.axhline(0.0, color=INK, linewidth=0.8)
    if len(x):
        draw_dots(axes, x, residual, colour)
    centre, low, median, high = bin_quantiles(x, residual)
    axes.fill_between(centre, low, high, color=colour, alpha=0.25, linewidth=0.0)
    axes.plot(centre, median, "-", color=INK, linewidth=3.4, alpha=0.35)
    axes.plot(centre, median, "-", color=colour, linewidth=2.2)


def draw_dots(axes: Axes, x: np.ndarray, y: np.ndarray, colour: str) -> None:
    """Some of the samples as dots in one path: a marker each would make the SVG ten times as long."""
    shown = thin(len(x), MOST_POINTS)
    gap = np.full(len(shown), np.nan)
    ends = np.stack([x[shown], x[shown] + 1e-9, gap], -1).reshape(-1)
    dots = axes.plot(ends, np.stack([y[shown], y[shown], gap], -1).reshape(-1), color=colour, linewidth=2.2, alpha=0.4)
    dots[0].set_solid_capstyle("round")
    dots[0].get_path().should_simplify = False


def bin_quantiles(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Quantiles of y in bins of equal width over the bulk of x.

    Returns:
        Bin centres (b,), lower quantile, median and upper quantile (b,) of the bins that hold enough samples.
    """
    if len(x) < FEWEST_IN_BIN:
        return (np.empty(0),) * 4
    first, last = np.quantile(x, [0.005, 0.995])
    edges = np.linspace(first, last, BINS + 1)
    place = np.digitize(x, edges) - 1
    rows = [
        (0.5 * (edges[b] + edges[b + 1]), *np.quantile(y[place == b], [BAND[0], 0.5, BAND[1]]))
        for b in range(BINS)
        if np.count_nonzero(place == b) >= FEWEST_IN_BIN
    ]
    centre, low, median, high = np.array(rows).T if rows else np.empty((4, 0))
    return centre, low, median, high


def limit_to_bulk(axes: Axes, values: np.ndarray) -> None:
    """Leave outliers out of the y axis: it covers 99 % of the values and a margin."""
    finite = values[np.isfinite(values)]
    if len(finite):
        low, high = np.quantile(finite, [0.005, 0.995])
        margin = 0.15 * max(high - low, 1e-12)
        axes.set_ylim(min(low, 0.0) - margin, max(high, 0.0) + margin)


def suspects_ranking(names: Sequence[str], gains: Sequence[float], accused: Sequence[str] | str = ()) -> str:
    """Which suspects would explain how much, strongest on top, the accused in colour.

    Args:
        names: effect ids.
        gains: drop in misfit, twice the log-likelihood, that each brings alone.
        accused: the named causes.
    """
    named = {accused} if isinstance(accused, str) else set(accused)
    order = np.argsort(np.asarray(gains, dtype=float), kind="stable")
    labels = [names[i] for i in order]
    values = [float(gains[i]) for i in order]
    with open_figure(6.4, 0.9 + 0.27 * len(labels)) as figure:
        axes = figure.subplots()
        bars = axes.barh(labels, values, color=[AFTER if label in named else GREY for label in labels], height=0.7)
        axes.bar_label(bars, [f"{value:.3g}" for value in values], padding=3)
        axes.axvline(0.0, color=INK, linewidth=0.8)
        axes.grid(visible=False, axis="y")
        axes.margins(x=0.12)
        name_axes(axes, "drop in misfit (twice the log-likelihood)", "")
        return write_svg(figure, "Suspects by what they explain")


def prediction_overlay(
    time: np.ndarray,
    measured: np.ndarray,
    before: np.ndarray,
    after: np.ndarray | None,
    labels: Sequence[str],
    restarts: Sequence[float] = (),
) -> str:
    """A stretch of flight: the log and the twin before and after, one panel for each channel.

    Args:
        time: (n,) [s].
        measured: (n, k) the log.
        before: (n, k) the twin as it was.
        after: (n, k) the twin with the named causes; None when none was named.
        labels: k channel names with units, e.g. "x [m]".
        restarts: times at which the twin was set back to the log [s]; its lines are broken there.
    """
    shown = thin(len(time), MOST_SAMPLES)
    at = np.asarray(time)[shown]
    breaks = np.searchsorted(at, np.asarray(restarts, dtype=float), side="left")
    breaks = breaks[(breaks > 0) & (breaks < len(at))]
    with open_figure(7.2, 0.5 + 1.5 * len(labels)) as figure:
        column = figure.subplots(len(labels), 1, squeeze=False, sharex=True)[:, 0]
        for k, (axes, label) in enumerate(zip(column, labels)):
            axes.plot(at, np.asarray(measured)[shown, k], color=INK, linewidth=4.5, alpha=0.35, label="log")
            for name, predicted, colour, dash in (("before", before, BEFORE, "--"), ("after", after, AFTER, "-")):
                if predicted is not None:
                    broken = np.insert(np.asarray(predicted, dtype=float)[shown, k], breaks, np.nan)
                    axes.plot(np.insert(at, breaks, at[breaks]), broken, dash, color=colour, label=f"twin {name}")
            name_axes(axes, "time [s]" if axes is column[-1] else "", label)
        column[0].legend(ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
        return write_svg(figure, "Log and twin over time")


def parameter_intervals(
    names: Sequence[str],
    values: Sequence[float],
    stds: Sequence[float],
    nominals: Sequence[float],
    units: Sequence[str],
) -> str:
    """Fitted parameters with intervals of two standard deviations beside their nominal values, one scale for each.

    Args:
        names: parameters, e.g. "rail_x.coulomb force".
        values: fitted values in their units.
        stds: their standard deviations.
        nominals: what the twin had.
        units: units, written in brackets.
    """
    with open_figure(6.4, 0.2 + 0.85 * len(names)) as figure:
        for i, axes in enumerate(figure.subplots(len(names), 1, squeeze=False)[:, 0]):
            axes.errorbar(values[i], 0.0, xerr=2.0 * stds[i], fmt="o", color=AFTER, capsize=4, label="fitted ± 2 std")
            axes.plot(nominals[i], 0.0, "D", color=BEFORE, markerfacecolor="none", label="nominal")
            axes.set_yticks([])
            axes.spines["left"].set_visible(False)
            axes.margins(x=0.1)
            name_axes(axes, f"{names[i]} [{units[i]}]", "")
            if i == 0:
                axes.legend(ncols=2, loc="lower left", bbox_to_anchor=(0.0, 0.95))
        return write_svg(figure, "Fitted parameters")
