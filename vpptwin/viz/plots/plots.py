"""The plots of reports, each returned as one inline SVG element."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from vpptwin.viz.plots.figure import AFTER, BEFORE, INK, name_axes, open_figure, thin, write_svg
from vpptwin.viz.plots.palette import GREY

SIZE = (3.6, 2.7)  # inch: two stand side by side on a desk, one fills a phone held upright
MAX_POINTS = 1000  # of a scatter plot
BINS = 16  # of the running median
MIN_PER_BIN = 8  # samples, below which a bin's quantiles say nothing
BULK = 0.9  # of the dots, which decides on the axis
BAND = (0.1, 0.9)  # quantiles
MAX_SAMPLES = 800  # of a line


def error_by_horizon(
    horizons_s: Sequence[float], before: Sequence[float], after: Sequence[float] | None = None,
    noise: float | None = None, interval: Sequence[tuple[float, float]] | None = None, label: str = "error",
    noise_label: str = "sensor noise",
) -> str:  # fmt: skip
    """Prediction error against horizon, before and after, on logarithmic axes.

    Args:
        horizons_s: (h,) time since the estimated state [s].
        before: (h,) error of the twin as it was.
        after: (h,) with the named causes; None when none was named.
        noise: error of a perfect twin.
        interval: 90 % interval of the change per horizon, as a share of the error before.
        label: what the error is of, with its unit.
        noise_label: what the noise is to be called.
    """
    with open_figure(*SIZE) as figure:
        axes = figure.subplots()
        axes.loglog(horizons_s, before, "o--", color=BEFORE, label="before")
        if after is not None:
            axes.loglog(horizons_s, after, "s-", color=AFTER, label="after")
            if interval is not None:
                low, high = np.asarray(before)[:, None].T * (1.0 + np.asarray(interval).T)
                axes.fill_between(horizons_s, low, high, color=AFTER, alpha=0.2, linewidth=0.0)
        if noise is not None:
            axes.axhline(noise, color=INK, linewidth=1.0, linestyle=":", label=noise_label)
        axes.set_xticks(list(horizons_s), [f"{h:g}" for h in horizons_s])
        axes.minorticks_off()
        axes.yaxis.set_major_formatter("{x:g}")
        low, high = axes.get_ylim()  # whole decades, so that at least two ticks carry a number
        axes.set_ylim(10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high)))
        name_axes(axes, "horizon [s]", label)
        axes.legend()
        return write_svg(figure, f"{label} against horizon")


def residual_against(
    x: np.ndarray, residual_before: np.ndarray, residual_after: np.ndarray | None, x_label: str, y_label: str,
    subject: str = "residual", titles: tuple[str, str] = ("before", "after"),
) -> list[str]:  # fmt: skip
    """What the twin leaves unexplained against a quantity: samples, running median and the band of 80 % of them.

    Args:
        x: (n,) the quantity.
        residual_before: (n,) residual of the twin as it was.
        residual_after: (n,) residual with the named causes; None when none was named.
        x_label: the quantity with its unit, e.g. "rail velocity [m/s]".
        y_label: the residual with its unit.
        subject: what it is about, which keeps figures of the same quantities on one page apart.
        titles: of the two.

    Returns:
        One figure before and, where there is a twin with causes, one after, on the same axes.
    """
    panels = [(titles[0], residual_before, BEFORE)]
    if residual_after is not None:
        panels.append((titles[1], residual_after, AFTER))
    limits = cover_bulk(np.concatenate([residual for _, residual, _ in panels]), BULK)
    figures = []
    for title, residual, colour in panels:
        known = np.isfinite(x) & np.isfinite(residual)
        with open_figure(*SIZE) as figure:
            axes = figure.subplots()
            draw_residual(axes, np.asarray(x)[known], np.asarray(residual)[known], colour)
            axes.set_ylim(limits)
            name_axes(axes, x_label, y_label, title)
            figures.append(write_svg(figure, f"{subject}: {y_label} against {x_label}, {title}"))
    return figures


def draw_residual(axes: Axes, x: np.ndarray, residual: np.ndarray, colour: str) -> None:
    """Samples, running median and quantile band of one residual."""
    axes.axhline(0.0, color=INK, linewidth=0.8)
    if len(x):  # some of the samples as dots in one path: a marker each would make the SVG ten times as long
        shown = thin(len(x), MAX_POINTS)
        gap = np.full(len(shown), np.nan)
        ends = np.stack([x[shown], x[shown] + 1e-9, gap], -1).reshape(-1)
        heights = np.stack([residual[shown], residual[shown], gap], -1).reshape(-1)
        (dots,) = axes.plot(ends, heights, color=colour, linewidth=2.2, alpha=0.4)
        dots.set_solid_capstyle("round")
        dots.get_path().should_simplify = False
    centre, low, median, high = bin_quantiles(x, residual)
    axes.fill_between(centre, low, high, color=colour, alpha=0.25, linewidth=0.0)
    axes.plot(centre, median, "-", color=INK, linewidth=3.4, alpha=0.35)
    axes.plot(centre, median, "-", color=colour, linewidth=2.2)


def bin_quantiles(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Quantiles of y in bins that hold equally many samples, so that they are narrow where x often is.

    Returns:
        Median of x, lower quantile, median and upper quantile of y, one for each bin (b,); no bins of too few samples.
    """
    bins = min(BINS, len(x) // MIN_PER_BIN)
    if not bins:
        return (np.empty(0),) * 4
    parts = np.array_split(np.argsort(x, kind="stable"), bins)
    rows = [(np.median(x[part]), *np.quantile(y[part], [BAND[0], 0.5, BAND[1]])) for part in parts]
    centre, low, median, high = np.array(rows).T
    return centre, low, median, high


def cover_bulk(values: np.ndarray, share: float = 0.99) -> tuple[float, float]:
    """Limits of an axis that covers zero, a share of the values and a margin: outliers do not flatten the rest."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return -1.0, 1.0
    low, high = np.quantile(finite, [0.5 - 0.5 * share, 0.5 + 0.5 * share])
    margin = 0.15 * max(high - low, 1e-12)
    return min(low, 0.0) - margin, max(high, 0.0) + margin


def prediction_overlay(
    time: np.ndarray, measured: np.ndarray, before: np.ndarray, after: np.ndarray | None, label: str,
    restarts: Sequence[float] = (),
) -> str:  # fmt: skip
    """A stretch of flight: the log, and the twin before and after.

    Args:
        time: (n,) [s].
        measured: (n,) the log.
        before: (n,) the twin as it was.
        after: (n,) the twin with the named causes; None when none was named.
        label: what is shown, with its unit.
        restarts: times at which the twin was set back to the log [s]; its lines are broken there.
    """
    shown = thin(len(time), MAX_SAMPLES)
    with open_figure(*SIZE) as figure:
        axes = figure.subplots()
        axes.plot(time[shown], measured[shown], color=INK, linewidth=4.5, alpha=0.35)
        draw_twins(axes, time[shown], [line if line is None else line[shown] for line in (before, after)], restarts)
        name_axes(axes, "time [s]", label)
        return write_svg(figure, f"Log and twin, {label}")


def residual_over_time(
    time: np.ndarray, before: np.ndarray, after: np.ndarray | None, noise: float, label: str,
    restarts: Sequence[float] = (),
) -> str:  # fmt: skip
    """Measured minus predicted over a stretch of flight, and the band of two sigma of sensor noise.

    Args:
        time: (n,) [s].
        before: (n,) residual of the twin as it was.
        after: (n,) residual with the named causes; None when none was named.
        noise: 1 sigma of a sample.
        label: what is shown, with its unit.
        restarts: times at which the twin was set back to the log [s]; lines are broken there.
    """
    shown = thin(len(time), MAX_SAMPLES)
    with open_figure(*SIZE) as figure:
        axes = figure.subplots()
        axes.axhspan(-2.0 * noise, 2.0 * noise, color=GREY, alpha=0.3, linewidth=0.0)
        draw_twins(axes, time[shown], [line if line is None else line[shown] for line in (before, after)], restarts)
        axes.set_ylim(cover_bulk(np.concatenate([before, before if after is None else after])))
        name_axes(axes, "time [s]", label)
        return write_svg(figure, f"Residual over time, {label}")


def draw_twins(axes: Axes, time: np.ndarray, lines: Sequence[np.ndarray | None], restarts: Sequence[float]) -> None:
    """Lines (n,) of the twin before and after, broken where it was restarted."""
    breaks = np.searchsorted(time, np.asarray(restarts, dtype=float), side="left")
    breaks = breaks[(breaks > 0) & (breaks < len(time))]
    for line, colour, dash in zip(lines, (BEFORE, AFTER), ("--", "-")):
        if line is not None:
            broken = np.insert(np.asarray(line, dtype=float), breaks, np.nan)
            axes.plot(np.insert(time, breaks, time[breaks]), broken, dash, color=colour)
