"""The library of manoeuvres: each is safe inside its bounds, in the nominal twin and in twins that are off."""

from __future__ import annotations

import numpy as np
import pytest

from vpptwin.effects import CATALOGUE
from vpptwin.robots.planar_drone.pilot.flight import fly
from vpptwin.robots.planar_drone.pilot.library import LIBRARY
from vpptwin.robots.planar_drone.pilot.manoeuvre import ROOM, Manoeuvre, find_manoeuvre, parse_settings
from vpptwin.robots.planar_drone.pilot.reference import Reference
from vpptwin.robots.planar_drone.pilot.safety import find_danger
from vpptwin.robots.planar_drone.pilot.scripted import ScriptedPilot
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.spec import EffectValues

SPEC = load_twin()
DRONE = SPEC.vehicle
TWINS: dict[str, EffectValues] = {
    "nominal": {},
    "pushed": {"rail_x.bias": {"force": 0.25}, "rail_z.bias": {"force": -0.3}},
    "heavy and weak": {"airframe.mass": {"mass": 0.03}, "rotor.thrust_gain": {"gain": 0.94}},
    "late": {"command.delay": {"delay": 0.010}, "mocap.delay": {"delay": 0.020}, "servo.lag": {"time_constant": 0.028}},
    "rubbing": {"rail_x.coulomb": {"force": 0.3}, "rail_z.coulomb": {"force": 0.3}},
    "askew": {
        "airframe.com": {"offset": 0.010},
        "mocap.misalignment": {"angle": 0.05},
        "rotor.asymmetry": {"fraction": 0.05},
    },
}
"""Twins with errors as large as a diagnosis is made for."""


def find_dangers(references: list[Reference], twins: list[EffectValues]) -> list[str]:
    """What is unsafe about each reference, flown in the twin beside it."""
    active = sorted({effect for effects in twins for effect in effects})
    twin = Twin(SPEC, len(references), active, num_threads=1)
    for i, effects in enumerate(twins):
        for effect, values in effects.items():
            for parameter, value in values.items():
                twin.set_parameter(effect, parameter, value, np.array([i]))
    tracks = fly(twin, ScriptedPilot(DRONE, references), seed=3)
    lead = tracks.lead[0]
    return [find_danger(DRONE, pose[lead:], v[lead:]) for pose, v in zip(tracks.pose, tracks.velocity)]


def test_every_manoeuvre_is_safe() -> None:
    """With default settings none comes near a stop, the floor, or a rate that is out of hand, whatever the twin."""
    flown = [(m, name) for m in LIBRARY for name in TWINS]
    dangers = find_dangers([m.plan(DRONE, {}, 10.0) for m, _ in flown], [TWINS[name] for _, name in flown])
    assert [(m.name, name, danger) for (m, name), danger in zip(flown, dangers) if danger] == []


@pytest.mark.slow
def test_every_manoeuvre_is_safe_at_its_bounds() -> None:
    """With each setting at a bound, and with all of them, it is safe in the nominal twin."""
    chosen, references = [], []
    for manoeuvre in LIBRARY:
        for side in ("low", "high"):
            bounds = {s.name: float(getattr(s, side)) for s in manoeuvre.settings}
            for given in (bounds, *({name: value} for name, value in bounds.items())):
                chosen.append((manoeuvre.name, given))
                references.append(manoeuvre.plan(DRONE, given, 9.0))
    dangers = find_dangers(references, [{}] * len(references))
    assert [(c, danger) for c, danger in zip(chosen, dangers) if danger] == []


@pytest.mark.parametrize("manoeuvre", LIBRARY, ids=lambda m: m.name)
def test_a_manoeuvre_describes_itself(manoeuvre: Manoeuvre) -> None:
    """It reveals effects of the catalogue; each setting has a meaning, a default inside its bounds, and matters."""
    assert set(manoeuvre.reveals) <= {effect.id for effect in CATALOGUE}
    assert manoeuvre.reveals
    assert manoeuvre.summary
    reference = manoeuvre.plan(DRONE, {})
    assert len(reference) == round(manoeuvre.duration * DRONE.control.policy_rate)
    for setting in manoeuvre.settings:
        assert setting.low < setting.high
        assert setting.low <= setting.default <= setting.high
        assert setting.meaning
        other = setting.low if setting.default > setting.low else setting.high
        changed = manoeuvre.plan(DRONE, {setting.name: other})
        assert any((getattr(changed, name) != getattr(reference, name)).any() for name in ("pose", "nudge"))


def test_what_is_often_confused_has_a_manoeuvre() -> None:
    """No two share a name; friction, air, rotors, servos and masses that look alike are each revealed by one."""
    assert len({m.name for m in LIBRARY}) == len(LIBRARY)
    revealed = {effect for m in LIBRARY for effect in m.reveals}
    assert revealed >= {
        "rail_x.coulomb", "rail_x.viscous", "rail_x.jamming", "air.drag", "air.ground_effect", "servo.lag",
        "command.delay", "airframe.mass", "rotor.thrust_gain", "rotor.negative_thrust", "airframe.com",
    }  # fmt: skip


def test_wrong_settings_are_refused() -> None:
    """Durations that make no sense, values that are no numbers; test_command has the others."""
    for duration in (1.0, 1e9, float("nan")):
        with pytest.raises(InputError, match="a flight of"):
            find_manoeuvre(LIBRARY, "x_steps").plan(DRONE, {}, duration)
    for text in ("amplitude", "amplitude=wide", "amplitude=inf"):
        with pytest.raises(InputError, match=f"--set {text}"):
            parse_settings([text])
    assert parse_settings(["amplitude=0.5", "period=2"]) == {"amplitude": 0.5, "period": 2.0}


def test_a_rail_that_is_too_short_is_refused() -> None:
    """A reference keeps its distance from the stops of the vehicle at hand."""
    short = DRONE.model_copy(update={"rig": DRONE.rig.model_copy(update={"travel_x": (-0.5, 0.5)})})
    with pytest.raises(InputError, match=r"rail_sweep goes from x = -1\.20 to 1\.20 m; expected -0\.35 to 0\.35 m"):
        find_manoeuvre(LIBRARY, "rail_sweep").plan(short, {})
    assert find_manoeuvre(LIBRARY, "x_steps").plan(short, {"amplitude": 0.5 - ROOM}).pose[:, 0].max() < 0.5


def test_danger_is_found() -> None:
    """A stop, the floor under a tip, too fast, turning too fast, diverged: each is named; hovering is none."""
    pose, still = np.tile([0.0, 1.0, 0.0], (5, 1)), np.zeros((5, 3))

    def danger(at: tuple[int, float], velocity: np.ndarray = still) -> str:
        moved = pose.copy()
        moved[2, at[0]] = at[1]
        return find_danger(DRONE, moved, velocity)

    assert danger((0, 0.0)) == ""
    assert danger((0, 1.48)) == "it comes within 0.020 m of the stops of x"
    assert "stops of z" in danger((1, 0.16))
    leaning = pose.copy()
    leaning[:, 1], leaning[:, 2] = 0.2, np.pi / 2
    assert "floor" in find_danger(DRONE, leaning, still)
    assert "diverges" in danger((0, np.nan))
    assert "m/s" in danger((0, 0.0), still + np.array([6.0, 0.0, 0.0]))
    assert "rad/s" in danger((0, 0.0), still + np.array([0.0, 0.0, 25.0]))
