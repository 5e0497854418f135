"""What every suspect would do to the logs at hand: small pictures of how a twin that has it departs from one without.

Those of the documentation, of the drone's effects over one flight, are drawn by `planar_drone.display.fingerprint`.
"""

from __future__ import annotations

import html

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key, Variation
from vpptwin.effects import Effect
from vpptwin.viz.plots.figure import find_loudest, thin

WINDOWS = 3
"""Held-out windows that are shown, those in which most moves."""
SIZES = 5.0
"""The strength that is shown, in typical sizes away from what the twin has."""
SEEN = 1.0
"""Noises by which a departure must stand out to be drawn."""
POINTS = 40
"""Of each window's line."""
WIDTH, HEIGHT = 240, 70
"""Of a picture [px]."""


def draw_fingerprints(bench: Bench) -> dict[str, str]:
    """Effect id → an SVG element, of every effect that would be seen in some held-out windows.

    Args:
        bench: held-out windows of the twin that was diagnosed.
    """
    few = choose_windows(bench)
    catalogue = {effect.id: effect for effect in bench.spec.catalogue}
    pairs = []
    for effect in catalogue.values():
        there = [switch_on(few, catalogue[other]) for other in effect.modifies if other in catalogue][:1]
        without: dict[Key, float] = dict(there)
        pairs += [Variation(without), Variation({**without, **dict([switch_on(few, effect)])})]
    predicted = few.predict(pairs)
    departures = predicted[1::2] - predicted[::2]
    drawn = zip(catalogue.values(), departures, strict=True)
    return {effect.id: picture for effect, departure in drawn if (picture := draw(few, effect, departure))}


def choose_windows(bench: Bench) -> Bench:
    """A bench of a few windows, those whose speeds vary most, in their order."""
    moved = np.concatenate([c.value.std(axis=1, keepdims=True) / c.sensor_std for c in bench.channels], axis=1)
    share = moved / np.maximum(moved.max(axis=0), 1e-12)
    ids = np.sort(np.argsort(-share.sum(axis=1), kind="stable")[:WINDOWS])
    channels = [channel.take(ids) for channel in bench.channels]
    windows, same = bench.windows.take(ids), (bench.criteria, bench.make_twin)
    return Bench(bench.spec, windows, channels, bench.segments, (), False, None, *same)


def switch_on(bench: Bench, effect: Effect) -> tuple[Key, float]:
    """The strength of an effect, so many typical sizes away from the twin's own."""
    strength = effect.parameters[0]
    return (effect.id, strength.name), strength.away(SIZES, bench.spec.value(effect, strength.name))


def draw(bench: Bench, effect: Effect, departure: np.ndarray) -> str:
    """The departure (K, C B) in the channel that shows it best, "" where none does."""
    known = bench.valid & np.isfinite(departure)
    times = np.where(known, departure / bench.std, 0.0)
    best, loudness = find_loudest(times[:, columns] for columns in bench.columns)
    if loudness < SEEN:
        return ""
    channel, columns = bench.channels[best], bench.columns[best]
    shown = np.where(known, departure, np.nan)[:, columns]
    most = float(np.nanmax(np.abs(shown)))
    lines = "".join(trace(row / most, i, len(shown)) for i, row in enumerate(shown))
    (_, name), value = switch_on(bench, effect)
    size = f"{name} {value:.3g} {effect.parameters[0].unit}".strip()
    length = bench.windows.steps * bench.windows.dt
    told = f"{size}: {channel.name} changes by up to {most:.2g} {channel.unit} in {length:.2g} s"
    label = html.escape(told, quote=True)
    middle = 0.5 * HEIGHT
    return (
        f'<svg role="img" aria-label="{label}" viewBox="0 0 {WIDTH} {HEIGHT}">'
        f'<path d="M0 {middle:g}H{WIDTH}" stroke="currentColor" opacity="0.3"/>{lines}</svg><span>{label}</span>'
    )


def trace(row: np.ndarray, place: int, count: int) -> str:
    """One window's line, `row` (B,) between -1 and 1, in its own part of the picture."""
    known = np.flatnonzero(np.isfinite(row))
    if len(known) < 2:
        return ""
    known = known[thin(len(known), POINTS)]
    x = WIDTH / count * (place + 0.04 + 0.92 * known / (len(row) - 1))
    y = HEIGHT * (0.5 - 0.45 * row[known])
    points = " ".join(f"{a:.0f},{b:.1f}" for a, b in zip(x, y))
    return f'<polyline points="{points}" fill="none" stroke="var(--after)" stroke-width="1.6"/>'
