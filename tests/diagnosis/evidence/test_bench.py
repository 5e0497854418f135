"""Which twins are so different that derivatives are taken anew, what sticks no more, and simulations that diverge."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.carts import FITTED, cut, load_cart, measure_cart
from tests.diagnosis.rigs import drive_cart
from vpptwin.diagnosis.evidence.bench import ASTRAY, FAR, FARTHEST, Bench
from vpptwin.diagnosis.evidence.channels import BIN, choose_bin, observe_windows
from vpptwin.diagnosis.evidence.runs import Runs, Track, Variation
from vpptwin.effects import find_effect
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.estimation.windows import cut_windows

DAMPING, FORCE, STICTION = ("slide.viscous", "damping"), ("slide.coulomb", "force"), ("slide.stiction", "force")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """A cart."""
    return cut(load_cart(tmp_path_factory.mktemp("cart")), measure_cart(drive_cart(0.0, 3), 7), FITTED)


def size_of(bench: Bench, effect: str) -> float:
    """A typical size."""
    return find_effect(bench.spec.catalogue, effect).parameters[0].size


def test_regimes_are_octaves_of_what_is_large(bench: Bench) -> None:
    """Nothing up to eight typical sizes; from there on an octave each, for every effect of its own."""
    size = size_of(bench, "slide.viscous")
    assert bench.regime({}) == bench.regime({DAMPING: 0.99 * FAR * size}) == frozenset()
    for times, octave in ((1.01, 0), (1.9, 0), (2.1, 1), (4.1, 2)):
        assert bench.regime({DAMPING: times * FAR * size}) == {("slide.viscous", octave)}
    both = {DAMPING: 3.0 * FAR * size, FORCE: 1.5 * FAR * size_of(bench, "slide.coulomb")}
    assert bench.regime(both) == {("slide.viscous", 1), ("slide.coulomb", 0)}
    # Its off value is far from everything.
    limit = find_effect(bench.spec.catalogue, "motor.rate_limit").parameters[0]
    assert bench.regime({("motor.rate_limit", limit.name): limit.off}) == frozenset()
    # Without dry friction, with strong damping; slight damping is as good as none.
    size = size_of(bench, "slide.viscous")
    strong, slight = {DAMPING: 3.0 * FAR * size}, {DAMPING: size}
    rubs = {FORCE: 100.0 * size_of(bench, "slide.coulomb"), STICTION: 1.0}
    assert bench.loosen(strong | rubs) == strong
    assert bench.loosen(slight | rubs) == {}


def test_a_simulation_that_diverges_is_far_off_and_finite(bench: Bench) -> None:
    """Ten thousand noises wherever something was measured; elsewhere and otherwise the plain difference."""
    predicted = bench.measured - 0.25
    predicted[0, :5] = np.nan
    predicted[1, 7] = np.inf
    missed = bench.miss(np.stack([predicted, bench.measured]))
    assert np.isfinite(missed).all()
    assert missed.shape == (2, *bench.measured.shape)
    np.testing.assert_allclose(missed[0, 0, :5], ASTRAY * bench.std[0, :5])
    assert missed[0, 1, 7] == ASTRAY * bench.std[1, 7]
    np.testing.assert_allclose(missed[0, 2], np.where(bench.valid[2], 0.25, 0.0))
    assert not missed[1].any()
    # What diverged to 1e300 is off by 1e8 noises, as is a change by so much; what is unknown changed nothing.
    predicted = bench.measured.copy()
    predicted[0, :3] = 1e300
    far = np.where(bench.valid[0, :3], FARTHEST * bench.std[0, :3], 0.0)
    np.testing.assert_allclose(-bench.miss(predicted)[0, :3], far)
    changed = np.full(bench.measured.shape, -1e300)
    changed[1] = np.nan
    np.testing.assert_allclose(-bench.bound(changed)[0, :3], far)
    assert not bench.bound(changed)[1].any()


@pytest.mark.parametrize(
    ("joints", "length", "times"),
    [(1, 1.0, 1), (1, 1.5, 1), (2, 1.0, 2), (3, 1.0, 2), (6, 1.0, 5), (12, 1.0, 10), (40, 1.0, 10)],
)
def test_bins_are_coarser_where_much_is_logged(joints: int, length: float, times: int) -> None:
    """At most 300 values a window: two channels a joint, of 1 s in bins of 10, 20, 50 or at most 100 ms."""
    series = Series("q", "rad", np.arange(2.0), np.zeros(2), 1e-3)
    of = dict.fromkeys(range(joints), series)
    log = Measurements("log", of, of, None, Series("u", "", np.arange(2.0), np.zeros((2, 0)), 0.0), None, (), 0.0, 1.0)
    assert choose_bin(log, length) == pytest.approx(times * BIN)


def test_coarser_bins_average_more(tmp_path: Path) -> None:
    """In bins of 50 ms a fifth of the values, noise that is that of a mean over 10 ms √5 times less."""
    spec, flight = load_cart(tmp_path), measure_cart(drive_cart(0.0, 3), 7)
    windows = cut_windows(spec, flight, FITTED, 1.0, False)
    fine, coarse = (observe_windows(windows, flight, bin_length=times * BIN)[0] for times in (1, 5))
    assert fine.value.shape == (10, 100)
    assert coarse.value.shape == (10, 20)
    np.testing.assert_allclose(coarse.value, fine.value.reshape(10, 20, 5).mean(axis=2))
    np.testing.assert_allclose(coarse.std, fine.std[:, :20] / np.sqrt(5.0))


@pytest.mark.parametrize("values", [{}, {("slide.coulomb", "force"): 1.1, ("motor.delay", "delay"): 0.012}])
@pytest.mark.parametrize("tracked", [False, True])
def test_a_pulse_is_flown_from_where_it_begins(
    bench: Bench, values: dict, tracked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last digit what flying each whole window makes of it, a delay and dry friction included."""
    number, segments, nv = len(bench.windows), bench.segments, bench.spec.model.nv
    push = np.random.default_rng(3).normal(0.0, 0.5, (number, segments, nv))
    start = np.full((number, nv), 0.01)
    told = bench.about(Track(start, -start, push) if tracked else None)
    variations = [Variation(values), Variation(values, pose=np.full(nv, 0.02))]
    variations += [Variation(values, push=(segment, 0, 0.3)) for segment in (*range(segments), 0)]
    found = told.simulate(variations)
    steps: list[int] = []
    monkeypatch.setattr(Runs, "_list_pulses", lambda *_: {})
    monkeypatch.setattr(told, "_progress", steps.append)
    whole = told.simulate(variations)
    assert sum(steps) == len(variations) * number * bench.windows.steps
    np.testing.assert_array_equal(found.pose, whole.pose)
    np.testing.assert_array_equal(found.velocity, whole.velocity)
    last = found.pose[-2] - found.pose[0]
    first = bench.windows.steps * (segments - 1) // segments
    assert not last[:, : first + 1].any()
    assert np.all(last[:, -1] >= 0.0)
    assert last[:, -1].sum() > 0.004  # the cart sticks in some
