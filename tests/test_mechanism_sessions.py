"""Sessions of other rigs: drawn the same every time, recorded for the tool to read, with a truth to be trusted."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proving.mechanisms import DECK, FAMILIES, Session, draw_session
from proving.mechanisms.hidden import Hidden, Scale, size_effect
from proving.mechanisms.measure import Evidence, Visibility, measure_visibility
from proving.mechanisms.plant import build_drives, build_laws
from proving.mechanisms.sensors import Disturbance, Sensors, measure_inputs, measure_motion, push
from proving.mechanisms.session import draw_kind
from proving.mechanisms.trial import Motion, World, perform, plan_trial
from tests.test_mechanisms import CART, build_world
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.read import read_flight
from vpptwin.twin import load_twin

FIRST = {draw_session(7, number).family: number for number in range(len(FAMILIES))}
"""Family → the first session of it."""
QUIET = Disturbance("ou", 1e-4, 0.1)
SHARP = Sensors(1e-3, 0.0, "none", 1e-2, 20.0, 1e-3)


def test_of_twenty_sessions_the_kinds_are_as_stated() -> None:
    """Nine hide one effect, four two, three one from outside, four none; six in a row are of six families.

    What was outside the catalogue when the decks were fixed and came into it since is one effect.
    """
    sessions = [draw_session(3, number) for number in range(40, 60)]
    assert Counter(draw_kind(3, number)[0] for number in range(40, 60)) == Counter(DECK)
    assert sum(s.kind == "single" for s in sessions) >= 9
    assert {s.family for s in sessions[2:8]} == set(FAMILIES)
    for session in sessions:
        assert len(session.hidden) == {"none": 0, "two": 2}.get(session.kind, 1)
        assert all(h.outside == (session.kind == "alien") for h in session.hidden)


def test_rigs_span_three_decades() -> None:
    """Moved masses of 180 sessions go from under 0.1 kg to over 100 kg; every kind and every motion comes up."""
    sessions = [draw_session(1, number) for number in range(180)]
    masses = [sum(link.mass for link in s.rig.links) for s in sessions]
    assert min(masses) < 0.1
    assert max(masses) > 100.0
    kinds = Counter(h.kind for s in sessions for h in s.hidden)
    assert len(kinds) > 20
    assert {m.style for s in sessions for m in s.motions} == {"tracked", "open", "balanced", "released"}
    assert {s.sensors.velocity for s in sessions} == {"none", "noisy", "filtered"}
    assert any(h.sensor for s in sessions for h in s.hidden)


def shorten(session: Session) -> Session:
    """Its first motion, of 10 s at most: Pinocchio moves an arm at a fifth of its pace."""
    first = session.motions[0]
    return replace(session, motions=(replace(first, duration=min(first.duration, 10.0)),))


@pytest.mark.parametrize(
    "family", [each if each in ("pendulum", "arm") else pytest.param(each, marks=pytest.mark.slow) for each in FAMILIES]
)
def test_a_session_can_be_read_and_is_the_same_again(family: str, tmp_path: Path) -> None:
    """Log, MJCF and twin are files that the tool takes; a second recording has the same bytes and the same truth."""
    session, again = (shorten(draw_session(7, FIRST[family])) for _ in range(2))
    one, other = session.record(tmp_path / "one"), again.record(tmp_path / "other")
    assert one.truth == other.truth
    json.dumps(one.truth.as_dict())
    assert [p.read_bytes() for p in one.logs] == [p.read_bytes() for p in other.logs]
    assert one.twin.read_text() == other.twin.read_text()
    twin, flight = load_twin(one.twin), read_flight(one.logs[0])
    assert list(flight.joints["/joint_states"]) == session.rig.joints
    assert ("/actuator_command" in flight.joints) == (family != "pendulum")
    assert flight.duration == pytest.approx(session.motions[0].duration, abs=0.03)
    if family != "pendulum":
        measured = read_measurements(twin, flight)
        assert len(measured.positions) == len(session.rig.links)
    known = {effect.id for effect in twin.catalogue}
    assert {e for e in one.truth.hidden if not e.startswith("outside:")} <= known
    for effect in (e for e in twin.catalogue if e.id in one.truth.hidden):
        assert set(one.truth.hidden[effect.id]) <= {p.name for p in effect.parameters}


def test_names_of_parameters_are_the_catalogues(tmp_path: Path) -> None:
    """Every kind that is hidden, at a slide and at a hinge, has the parameters of the tool's effect of that id."""
    session = next(s for n in range(99) if (s := draw_session(1, n)).family == "cart-pole")
    (tmp_path / "rig.xml").write_text(session.told.write_mjcf())
    (tmp_path / "rig.yaml").write_text(session.told.write_twin("rig.xml"))
    two, rig = np.full(2, 0.3), session.rig
    scale = Scale(two, two, two, 0.0 * two, two, np.linspace(-1.0, 1.0, 50)[:, None], 0.01)
    joints, drives = dict(zip(rig.joints, (0, 1))), {d.name: d.joint for d in rig.drives}
    checked = 0
    for effect in load_twin(tmp_path / "rig.yaml").catalogue:
        if effect.id.rpartition(".")[2] in ("lugre", "load", "dead_band", "sag", "mass", "com", "payload", "tilt"):
            continue  # not hidden there
        if effect.target in joints and effect.id.endswith(".delay"):
            continue  # what cameras are late by, tests/test_partly_seen.py hides
        values = size_effect(Hidden(effect.id, (joints | drives)[effect.target], 0.1), rig, scale)
        assert list(values) == [p.name for p in effect.parameters]
        checked += 1
    assert checked == 2 * 11 + 1 + 1 + 6  # only the hinge has an encoder whose zero matters


def look(
    rig_laws: dict[str, float], hidden: Hidden, values: dict[str, float], disturbance: Disturbance = QUIET
) -> Visibility:
    """Visibility of one effect in 20 s of the heavy carriage."""
    world, rig = build_world(CART), CART
    for name, value in rig_laws.items():
        world.laws[name] = world.later[name] = value
    if "gain" in values:
        world.drives["gain"] = values["gain"]
    track = perform(world, rig, plan_trial(rig, Motion("tracked", "sines", 20.0, 1), 0.005))
    v, q = track.moved[:, 1], track.moved[:, 0]
    force = np.sqrt(np.mean((60.0 * track.given) ** 2, 0))
    scale = Scale(force, np.sqrt(np.mean(v**2, 0)), q.std(0), np.median(q, 0), np.full(1, 40.0), track.given, 0.005)
    return measure_visibility(
        rig, scale, [Evidence(track, track.given)], [(hidden, values)], SHARP, disturbance, rig, []
    )[0][0]


def test_what_logs_of_a_carriage_show() -> None:
    """12 N of some 60 N stand out, and no other law does the same; weaker disturbances show it better."""
    hidden, values = Hidden("slide.coulomb", 0, 0.2), {"force": 12.0}
    found, shaken = (look({"coulomb": 12.0}, hidden, values, Disturbance("ou", s, 0.1)) for s in (1e-4, 1e-2))
    assert found.separable
    assert not found.alike
    assert found.seen > shaken.seen > shaken.apart
    # On a level rail without friction a drive that is 20 % too strong is a mass that is 17 % too small.
    found = look({}, Hidden("motor.gain", 0, 0.18), {"gain": 1.2})
    assert found.detectable
    assert not found.separable
    assert found.nearest == "slide.inertia"
    assert found.alike == ["slide.inertia"]
    # A thousandth of a newton on 40 kg shows in no log.
    found = look({"coulomb": 1e-3}, Hidden("slide.coulomb", 0, 1e-5), {"force": 1e-3})
    assert found.seen < 0.5
    assert not found.detectable


def test_a_force_shifts_predictions_as_newton_says() -> None:
    """By hand: 2 N on 40 kg move a carriage by t²/40 m, rms over a second 1/(40 √5) m, here over the noise."""
    hidden, values = Hidden("slide.bias", 0, 0.05), {"force": 2.0}
    found = look({"bias": 2.0}, hidden, values)
    track = perform(build_world(CART), CART, plan_trial(CART, Motion("tracked", "sines", 20.0, 1), 0.005))
    noise = 1e-3 * track.moved[:, 0].std()
    # Sums over steps of 20 ms count the force a step longer: 3 % of a second squared.
    assert found.shift == pytest.approx(1.0 / (40.0 * np.sqrt(5.0)) / noise, rel=0.05)


def test_jitter_shows_where_disturbances_are_weak() -> None:
    """A carriage that is 0.5 % too heavy, seen by fine encoders; a rig as believed shows nothing."""
    heavy = replace(CART, links=(replace(CART.links[0], mass=40.2),))
    track = perform(build_world(CART), CART, plan_trial(CART, Motion("tracked", "sines", 20.0, 1), 0.005))
    v, q, log = track.moved[:, 1], track.moved[:, 0], Evidence(track, track.given)
    force = np.sqrt(np.mean((60.0 * track.given) ** 2, 0))
    scale = Scale(force, np.sqrt(np.mean(v**2, 0)), q.std(0), np.median(q, 0), np.full(1, 40.0), track.given, 0.005)
    weak, strong = (Disturbance("ou", s, 0.1) for s in (1e-4, 1e-2))
    fine = replace(SHARP, noise=1e-4)
    seen = [measure_visibility(CART, scale, [log], [], fine, d, r, [])[1] for d, r in
            ((weak, CART), (weak, heavy), (strong, heavy))]  # fmt: skip
    assert seen[0] < 1e-9
    assert seen[1] > 5.0 * seen[2] > 0.0


@pytest.mark.parametrize("kind", ["ou", "smooth", "swinging"])
def test_disturbances_are_as_strong_and_slow_as_stated(kind: str) -> None:
    """Rms as a share of each joint's force; uncorrelated after many correlation times, alike over a tenth of one."""
    scale = np.array([10.0, 0.1])
    force = push(np.random.default_rng(2), Disturbance(kind, 0.01, 0.2), scale, 40000, 0.005)
    np.testing.assert_allclose(np.sqrt(np.mean(force**2, 0)), 0.01 * scale, rtol=0.1)
    first = force[:, 0] / force[:, 0].std()
    assert np.mean(first[4:] * first[:-4]) > 0.8
    assert abs(np.mean(first[800:] * first[:-800])) < 0.2


def test_sensors_by_hand() -> None:
    """Encoder positions are whole steps; filtered velocities lag by the filter's 1/(2π cut)."""
    time = np.arange(4000) * 0.005
    moved = np.stack([np.sin(2.0 * time), 2.0 * np.cos(2.0 * time), 0.0 * time], 1)[:, :, None]
    sensors, one = Sensors(0.0, 0.01, "filtered", 0.0, 10.0, 0.0), np.ones(1)
    position, velocity = measure_motion(np.random.default_rng(0), sensors, moved, np.zeros((4000, 1)), one, one, 0.005)
    steps = position / 0.01
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    lag = 1.0 / (2.0 * np.pi * 10.0)
    assert velocity is not None
    # An encoder that steps by 0.01 makes 2 m/s² of noise in differences; filtered, and over the log, little is left.
    late = [2.0 * np.cos(2.0 * (time[200:] - shift)) for shift in (0.0, lag, 3.0 * lag)]
    error = [np.mean((velocity[200:, 0] - true) ** 2) for true in late]
    assert error[1] < min(error[0], error[2])
    # Gain and offset first, then a dead band of 0.2, then steps of 0.5, by hand.
    given = np.array([[0.1, 1.0], [-1.0, 2.0]])
    np.testing.assert_allclose(measure_inputs(given, {0: {"sensor_dead": 0.2}}), [[0.0, 1.0], [-0.8, 2.0]])
    np.testing.assert_allclose(measure_inputs(given, {1: {"gain": 0.5, "offset": 0.1}}), [[0.1, 0.6], [-1.0, 1.1]])
    np.testing.assert_allclose(measure_inputs(given, {0: {"quantum": 0.5}})[:, 0], [0.0, -1.0])


def test_small_deviations_and_forgotten_damping() -> None:
    """A forgotten damping is missing in the MJCF only; small friction is never on a joint that nothing drives."""
    sessions = [draw_session(11, number) for number in range(300)]
    forgotten = [s for s in sessions if s.forgotten]
    assert forgotten
    assert all(s.told.links[0].damping == 0.0 < s.rig.links[0].damping for s in forgotten)
    small = [(s, h) for s in sessions for h in s.small]
    assert small
    assert all(s.rig.driven[h.joint] and h.effect not in [x.effect for x in s.hidden] for s, h in small)
    assert not any(s.small for s in sessions if s.family == "pendulum")
    world = World(CART, build_laws(CART), build_drives(CART), np.zeros((1, 1)), build_laws(CART), build_drives(CART))
    assert replace(world, change=0.5).change == 0.5
