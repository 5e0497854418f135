"""Carts of `rigs` measured without a log, their noise known, and searches on them: small, so that tests are quick."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.diagnosis.rigs import CARTS, LOG_EVERY, STEP, Track, write_rig
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.flights import build_bench
from vpptwin.diagnosis.evidence.forces import scale_twin
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.power import Shown
from vpptwin.diagnosis.search.hypotheses import TEMPER, open_fitter
from vpptwin.diagnosis.search.search import Search
from vpptwin.diagnosis.search.suspects import list_unknowns
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.twin.spec import TwinSpec, load_twin

WINDOW = 1.0
FITTED = 0.5 + WINDOW * np.arange(10)
"""Starts of the windows that are fitted [s]."""
JUDGING = 11.5 + WINDOW * np.arange(10)
"""Starts of those that judge [s]."""


def load_cart(folder: Path) -> TwinSpec:
    """The twin of a cart, without friction."""
    return load_twin(write_rig(CARTS, folder))


def measure_cart(track: Track, seed: int) -> Measurements:
    """A cart through noisy sensors at 200 Hz: two samples a bin, whose mean has 1/√2 of the noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(len(track[0])) * LOG_EVERY * STEP
    place, speed = (v + std * rng.standard_normal(len(v)) for v, std in zip(track, CARTS.noise))
    position = Series("slide", "m", time, place, CARTS.noise[0] / np.sqrt(2.0), white=False)
    velocity = Series("slide rate", "m/s", time, speed, CARTS.noise[1] / np.sqrt(2.0), white=False)
    command = Series("control", "", time, track[2][:, None], 0.0)
    return Measurements("cart", {0: position}, {0: velocity}, None, command, None, (), 0.0, float(time[-1]))


def cut(spec: TwinSpec, flight: Measurements, starts: Sequence[float] | np.ndarray) -> Bench:
    """Windows of a flight on a bench."""
    return build_bench(spec, [flight], [np.asarray(starts)], WINDOW, False)


def open_search(spec: TwinSpec, flight: Measurements) -> Search:
    """A search on the windows that are fitted, within the bounds that the flight asks for."""
    spec = scale_twin(spec, [flight])
    return Search(cut(spec, flight, FITTED), list_unknowns(spec))


def open_judges(spec: TwinSpec, flight: Measurements, starts: np.ndarray = JUDGING) -> HeldOut:
    """The windows that judge."""
    bench = cut(spec, flight, starts)
    return HeldOut(bench, bench)


def show(search: Search) -> Shown:
    """What a search's windows would have shown beside the nominal twin."""
    fitter = open_fitter(search.bench, search.unknowns, search.bench)
    return Shown(fitter, fitter.fit(frozenset(), {}), TEMPER)
