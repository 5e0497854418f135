"""The independent simulation flies: commands reproduce a flight, and the catalogue's effects are there and show."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from proving.drone import CORE, EFFECTS, EXTENDED, Recording, fly, fly_many
from proving.drone.effects import COMPANIONS, FRAME, Effects
from proving.drone.rig import load_nominal
from tests.effects.test_metadata import AGREED_EFFECTS

NOMINAL = load_nominal()
CALM = {"gusts": False, "jitter": False, "dropouts": False}


def test_effects_are_those_agreed_on() -> None:
    """Ids and parameters are those that other tools depend on; aliens, other forms and the frame lie outside."""
    ours = {effect: list(sizes) for effect, sizes in (CORE | EXTENDED | COMPANIONS).items()}
    assert ours == {effect: list(units) for effect, units in AGREED_EFFECTS.items()}
    outside = set(EFFECTS) - set(AGREED_EFFECTS) - set(FRAME)
    assert all(effect.startswith(("alien.", "form.")) for effect in outside)


@pytest.mark.parametrize("effect", AGREED_EFFECTS)
def test_sizes_to_draw_are_apart_from_off(effect: str) -> None:
    """What is drawn is never the off value, whatever the sign, so a hidden effect is really there."""
    for size in (EFFECTS | COMPANIONS)[effect].values():
        assert all(low < high for low, high in size.spans)
    first = next(iter((EFFECTS | COMPANIONS)[effect].values()))
    assert all(not low <= first.off <= high for low, high in first.spans)


def test_nothing_of_vpptwin_is_imported() -> None:
    """The simulation shares no physics with what it tests."""
    code = "import sys, proving.drone; print([m for m in sys.modules if m.split('.')[0] in ('vpptwin', 'mujoco')])"
    root = Path(__file__).resolve().parents[1]
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=root, check=True)
    assert found.stdout.strip() == "[]"


def replay(effects: Effects, recording: Recording, start: int, steps: int) -> list[float]:
    """Replay recorded commands from the true state with a scalar RK4 at 0.1 ms; returns x, z, theta at the end."""
    rotor, motor = NOMINAL["rotor"], NOMINAL["motor"]
    lag = effects["servo.lag"]["time_constant"]
    delay, damping = effects["command.delay"]["delay"], effects["rail_x.viscous"]["damping"]
    drag = effects["air.drag"]["k_d"]
    columns = recording.topics["/rotor/command"].columns

    def slope(state: list[float], pitch: tuple, throttle: tuple) -> list[float]:
        _, _, theta, vx, vz, q, a1, a2, w1, w2 = state
        f1, f2 = rotor["k_t"] * w1 * a1, rotor["k_t"] * w2 * a2
        speed = math.hypot(vx, vz)
        rates = [vx, vz, q]
        rates.append((-(f1 + f2) * math.sin(theta) - damping * vx - drag * speed * vx) / 0.58)
        rates.append((((f1 + f2) * math.cos(theta) - drag * speed * vz) / 0.5) - 9.81)
        rates.append((f2 - f1) * 0.2 / 0.006)
        rates += [(u - a) / lag for u, a in zip(pitch, (a1, a2))]
        for w, a, u in ((w1, a1, throttle[0]), (w2, a2, throttle[1])):
            torque = (
                (u * motor["battery"] - w / motor["k_v"]) / motor["resistance"] - motor["no_load_current"]
            ) / 115.0
            load = rotor["k_d1"] * w**2 + rotor["k_d2"] * w**2 * a**2 + rotor["k_d3"] * w * abs(a)
            rates.append((torque - load) / rotor["inertia"])
        return rates

    truth, step = recording.truth, 1e-4
    state = [*truth["position"][start], *truth["velocity"][start]]
    state += [*truth["blade_pitch"][start], *truth["rotor_speed"][start]]
    for n in range(steps * 10):
        now = start + n // 10
        late = math.floor(start + n / 10 - delay * 1000 + 1e-9)
        pitch = columns["blade_pitch_1"][late], columns["blade_pitch_2"][late]
        throttle = columns["throttle_1"][now], columns["throttle_2"][now]
        k1 = slope(state, pitch, throttle)
        k2 = slope([s + step / 2 * k for s, k in zip(state, k1)], pitch, throttle)
        k3 = slope([s + step / 2 * k for s, k in zip(state, k2)], pitch, throttle)
        k4 = slope([s + step * k for s, k in zip(state, k3)], pitch, throttle)
        state = [s + step / 6 * (a + 2 * b + 2 * c + d) for s, a, b, c, d in zip(state, k1, k2, k3, k4)]
    return state[:3]


def test_recorded_commands_reproduce_the_flight() -> None:
    """A command acts from its stamp until the next one.

    The logged commands, replayed so by another integrator, give the same flight.
    """
    effects = {
        "command.delay": {"delay": 0.0063},
        "servo.lag": {"time_constant": 0.03},
        "rail_x.viscous": {"damping": 0.5},
        "air.drag": {"k_d": 0.2},
    }
    recording = fly(effects, "aggressive", 2.5, 3, **CALM)
    moved = np.ptp(recording.truth["position"][1000:2300], axis=0)
    assert moved.max() > 0.3
    end = replay(effects, recording, 1000, 1000)
    # 0.25 ms midpoint against 0.1 ms RK4 over 1 s; half a millisecond of lag would show as some 1e-3.
    np.testing.assert_allclose(end, recording.truth["position"][2000], atol=3e-5)


def test_inverted_hover_holds() -> None:
    """After a half flip the craft hangs upside down on negative blade pitch for over a second, then turns back."""
    truth = fly({}, "flip", 7.0, 4).truth
    start = np.flatnonzero(np.cos(truth["position"][:, 2]) < -0.97)[0]
    hold = slice(start + 600, start + 1600)
    assert (np.cos(truth["position"][hold, 2]) < -0.97).all()
    assert (truth["blade_pitch"][hold] < -0.05).all()
    assert np.abs(truth["velocity"][hold, :2]).max() < 0.5
    assert np.cos(truth["position"][-1, 2]) > 0.97


@pytest.mark.slow
def test_every_hidden_effect_can_be_flown() -> None:
    """With each effect at the ends of its range the craft keeps off the end stops, the floor and the wall."""
    plans = [
        {
            "effects": {effect: {name: size.spans[end][end] for name, size in sizes.items()}},
            "manoeuvre": manoeuvre,
            "duration": 8.0,
            "seed": 40 + number,
        }
        for manoeuvre in ("aggressive", "mixed", "flip")
        for number, (effect, sizes) in enumerate(CORE.items())
        for end in (0, -1)
    ]
    for recording in fly_many(plans):
        x, z, _ = recording.truth["position"].T
        assert np.abs(x).max() < 1.4, recording.effects
        assert z.min() > 0.2, recording.effects
        assert z.max() < 2.4, recording.effects


def compare(one: Recording, other: Recording, topic: str, column: str) -> float:
    """Mean difference of a column; with a clock that drifts a flight has a frame more or less."""
    first, second = one.topics[topic].columns[column], other.topics[topic].columns[column]
    size = min(len(first), len(second))
    return float(np.abs(first[:size] - second[:size]).mean())


@pytest.mark.slow
def test_every_effect_changes_the_flight() -> None:
    """Each effect, flown with the same seed as a flight without, shows in at least one topic."""
    rng = np.random.default_rng(6)
    hidden = [{effect: {name: size.draw(rng) for name, size in sizes.items()}} for effect, sizes in EFFECTS.items()]
    for effects in hidden:
        for sudden in {"alien.mass_drop", "alien.chip"} & set(effects):
            effects[sudden]["time"] = 2.0
        if "clock.drift" in effects:  # grows with time, and this flight is half as long as those it is drawn for
            effects["clock.drift"]["drift"] *= 2.0
    # Seed 52 turns upside down and passes low within its first 8.5 s.
    knocks = [effects for effects in hidden if set(effects) & {"contact.compliance", "contact.friction"}]
    others = []
    for manoeuvre, flown in (("mixed", [e for e in hidden if e not in knocks]), ("knock", knocks)):
        flights = [{"effects": e, "manoeuvre": manoeuvre, "duration": 8.5, "seed": 52} for e in [{}, *flown]]
        plain, *found = fly_many(flights)
        others += [(plain, other) for other in found]
    for plain, other in others:
        apart = [
            compare(plain, other, topic, column) / noise
            for topic, column, noise in (
                ("/mocap/pose", "x", 0.0004),
                ("/mocap/pose", "qy", 0.0015),
                ("/mocap/pose", "z", 0.0004),
                ("/rotor/state", "current_1", 0.05),
                ("/rotor/command", "throttle_1", 0.002),
            )
        ]
        assert max(apart) > 2.0, other.effects


def test_unknown_effects_are_refused() -> None:
    """A slip in an id or a parameter name must not fly a rig without the effect."""
    with pytest.raises(ValueError, match="unknown effect"):
        fly({"rail_x.colomb": {"force": 0.3}}, "hover", 1.0, 0)
    with pytest.raises(ValueError, match="no parameter"):
        fly({"rail_x.coulomb": {"friction": 0.3}}, "hover", 1.0, 0)
