"""Causes against inverse dynamics of the same logs: right ones are seen, made-up ones are denied and doubted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.carts import measure_cart
from tests.diagnosis.plants import Plant, move, slider
from tests.diagnosis.rigs import BOB, DECAYS, LENGTH, LOG_EVERY, STEP, Track, let_swing, record, write_rig
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.evidence.contradiction import Seen, weigh_causes
from vpptwin.diagnosis.evidence.forces import scale_twin
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement import diagnose as judgement
from vpptwin.diagnosis.judgement.selection import Selection
from vpptwin.diagnosis.judgement.verdict import Verdict
from vpptwin.effects import find_effect
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.logs.flight import Flight
from vpptwin.logs.read import read_flight
from vpptwin.twin.spec import TwinSpec, load_twin

MASS, DRIVE = 2.0, 20.0
COULOMB, VISCOUS = ("slide.coulomb", "force"), ("slide.viscous", "damping")


def see(spec: TwinSpec, flight: Measurements, values: dict[Key, float]) -> dict[str, Seen]:
    """What inverse dynamics sees of each cause."""
    return {seen.effect: seen for seen in weigh_causes(scale_twin(spec, [flight]), [flight], values, CRITERIA)}


def measure(
    plant: Plant, folder: Path, change: Callable[[Track], np.ndarray] | None = None
) -> tuple[TwinSpec, Measurements]:
    """The twin of a bare slider of 2 kg, and a plant's noisy log; `change` gives the control that is logged instead."""
    track = move(plant, 5)
    logged = track[2] if change is None else change(track)
    return load_twin(write_rig(slider(Plant(MASS)), folder)), measure_cart((track[0], track[1], logged), 6)


def measure_decay(angle: np.ndarray, rate: np.ndarray, torque: np.ndarray) -> Measurements:
    """A pendulum that was let go, without noise."""
    time = np.arange(len(angle)) * LOG_EVERY * STEP
    return Measurements(
        "decay", {0: Series("swing", "rad", time, angle, 1e-3, white=False)},
        {0: Series("swing rate", "rad/s", time, rate, 1e-3, white=False)}, None,
        Series("control", "", time, torque, 0.0), None, (), 0.0, float(time[-1]),
    )  # fmt: skip


BARE = Plant(MASS, drive=DRIVE)
RIGHT: dict[str, tuple[Plant, dict[Key, float], Callable[[Track], np.ndarray] | None]] = {
    "viscous": (replace(BARE, viscous=4.0), {VISCOUS: 4.0}, None),
    "coulomb": (replace(BARE, coulomb=2.0), {COULOMB: 2.0}, None),
    "both": (replace(BARE, coulomb=2.0, viscous=4.0), {COULOMB: 2.0, VISCOUS: 4.0}, None),
    "bias": (replace(BARE, bias=-1.5), {("slide.bias", "force"): -1.5}, None),
    # A drive that gives more than is logged; a spring that took a part of what was logged; a heavier slider.
    "gain": (BARE, {("motor.gain", "gain"): 1.3}, lambda track: track[2] / 1.3),
    "spring": (
        BARE, {("slide.spring", "stiffness"): 9.0, ("slide.spring", "rest"): 0.1},
        lambda track: track[2] + 9.0 * (track[0] - 0.1),
    ),
    "inertia": (replace(BARE, mass=1.3 * MASS), {("slide.inertia", "inertia"): 0.3 * MASS}, None),
}  # fmt: skip
"""Laws → what moves, the causes, and the control as it is logged."""


@pytest.mark.parametrize("law", RIGHT)
def test_right_causes_are_seen(law: str, tmp_path: Path) -> None:
    """At its true size all of a law's force is seen, to a quarter, and nothing is denied."""
    plant, values, change = RIGHT[law]
    for seen in see(*measure(plant, tmp_path, change), values).values():
        assert not seen.contradicts(CRITERIA)
        assert seen.std < CRITERIA.has_a_say
        assert seen.share == pytest.approx(1.0, abs=0.25)


def test_made_up_damping_is_denied(tmp_path: Path) -> None:
    """On a log with dry friction only, as much damping beside it is not seen; the friction is."""
    spec, flight = measure(replace(BARE, coulomb=2.0), tmp_path)
    seen = see(spec, flight, {COULOMB: 2.0, VISCOUS: 12.0})
    damping, friction = seen["slide.viscous"], seen["slide.coulomb"]
    assert damping.contradicts(CRITERIA)
    assert abs(damping.share) < 0.2
    assert "times the force of the fit (1 would agree)" in damping.tell(CRITERIA)
    assert "slide.viscous is doubted: on joint slide" in damping.tell(CRITERIA)
    assert not friction.contradicts(CRITERIA)


def test_more_than_the_log_can_balance_is_refused(tmp_path: Path) -> None:
    """Damping within its bounds that at logged speed asks for more than drives and accelerates the slider is doubted.

    Two that hold against each other are no way round it: a stiff spring and a constant force.
    """
    spec, flight = measure(replace(BARE, coulomb=2.0), tmp_path)
    scaled = scale_twin(spec, [flight])
    most = {name: find_effect(scaled.catalogue, f"slide.{name}").parameters[0].high for name in ("viscous", "spring")}
    damping = see(spec, flight, {VISCOUS: most["viscous"]})["slide.viscous"]
    assert damping.asked > CRITERIA.unbalanced
    assert "times the largest force that inputs, inertia and weight in the logs can balance" in damping.tell(CRITERIA)
    held = find_effect(scaled.catalogue, "slide.bias").parameters[0].low
    pair = {("slide.spring", "stiffness"): most["spring"], ("slide.spring", "rest"): 1.0, ("slide.bias", "force"): held}
    assert see(spec, flight, pair)["slide.spring"].asked > CRITERIA.unbalanced
    assert see(spec, flight, {("slide.inertia", "inertia"): 30.0})["slide.inertia"].asked == 0.0  # no force


@pytest.mark.parametrize("late", [0.0, 0.01])
def test_a_filter_makes_no_contradiction(late: float, tmp_path: Path) -> None:
    """Velocities through a low pass of 16 Hz look like less damping than there is: inverse dynamics then has no say."""
    angle, rate, torque = let_swing(0.003, 1)
    keep = np.exp(-LOG_EVERY * STEP / 0.01)
    filtered = np.array(rate)
    for i in range(1, len(rate)):
        filtered[i] = keep * filtered[i - 1] + (1.0 - keep) * rate[i]
    flight = measure_decay(angle, filtered, torque)
    spec = scale_twin(load_twin(write_rig(DECAYS, tmp_path)), [flight])
    believing = replace(CRITERIA, late=late)
    (seen,) = weigh_causes(spec, [flight], {("swing.viscous", "damping"): 0.003}, believing)
    assert seen.contradicts(believing) == (late == 0.0)


@pytest.mark.parametrize("noise", [1.0, 10.0, 40.0])
def test_noise_makes_no_contradiction(noise: float, tmp_path: Path) -> None:
    """However noisy position and velocity are, the true friction and damping are not denied."""
    spec, flight = measure(replace(BARE, coulomb=1.0, viscous=2.0), tmp_path)
    rng = np.random.default_rng(9)

    def blur(series: Series) -> Series:
        std = noise * series.std
        return replace(series, value=series.value + std * rng.standard_normal(len(series.value)), std=float(std))

    noisy = replace(flight, positions={0: blur(flight.positions[0])}, velocities={0: blur(flight.velocities[0])})
    seen = see(spec, noisy, {COULOMB: 1.0, VISCOUS: 2.0})
    assert not any(found.contradicts(CRITERIA) for found in seen.values())


def test_weight_by_hand(tmp_path: Path) -> None:
    """Half of the bob again as inertia, which is not there: half of the force that swings it is denied."""
    angle, rate, torque = let_swing(0.0, 1)
    flight = measure_decay(angle, rate, torque)
    spec = load_twin(write_rig(DECAYS, tmp_path))
    seen = see(spec, flight, {("swing.inertia", "inertia"): 0.5 * BOB * LENGTH**2})["swing.inertia"]
    assert seen.contradicts(CRITERIA)
    assert abs(seen.share) < 0.15
    damped = see(spec, flight, {("swing.bias", "force"): 0.25 * BOB * 9.81 * LENGTH})["swing.bias"]
    balance = BOB * 9.81 * LENGTH * 2.0 * np.abs(np.sin(angle))  # inertia and weight both carry that force
    assert damped.asked == pytest.approx(0.25 * BOB * 9.81 * LENGTH / np.percentile(balance, 98.0), rel=0.1)


def test_nothing_is_said_of_laws_with_a_memory(tmp_path: Path) -> None:
    """One step from a logged state cannot tell what a bristle has gone through."""
    spec, flight = measure(replace(BARE, coulomb=2.0), tmp_path)
    assert see(spec, flight, {COULOMB: 2.0, ("slide.lugre", "compliance"): 1e-5}) == {}
    assert see(spec, flight, {}) == {}


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory: pytest.TempPathFactory) -> tuple[TwinSpec, Flight]:
    """The twin of a bare slider and twelve seconds of one with dry friction only."""
    log, twin = record(slider(replace(BARE, coulomb=2.0)), 0.0, tmp_path_factory.mktemp("slider"), 5, part=0.5)
    return load_twin(twin), read_flight(log)


def swear_by(patch: pytest.MonkeyPatch, rubbing: tuple[TwinSpec, Flight], key: Key, value: float) -> Verdict:
    """The verdict of a search that swears by another effect beside the dry friction."""
    select = judgement.select_inferred

    def swear(*given: object) -> Selection:
        selection = select(*given)  # type: ignore[arg-type]
        return replace(selection, fit=replace(selection.fit, values=selection.fit.values | {key: value}))

    patch.setattr(judgement, "select_inferred", swear)
    return judgement.diagnose(rubbing[0], [rubbing[1]], causes=["slide.coulomb", key[0]]).verdict


def test_a_verdict_with_a_made_up_cause_says_so(
    rubbing: tuple[TwinSpec, Flight], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Damping of which there is none: confidence at most a half, the warning first."""
    verdict = swear_by(monkeypatch, rubbing, VISCOUS, 12.0)
    by_name = {cause.effect: cause for cause in verdict.causes}
    assert by_name["slide.viscous"].confidence <= CRITERIA.sober
    assert verdict.warnings[0].startswith("slide.viscous is doubted: on joint slide inverse dynamics")
