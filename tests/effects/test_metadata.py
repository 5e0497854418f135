"""What every effect says about itself: ids, units, bounds, priors, look-alikes, and the table made of them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.effects.rigs import CART_EFFECTS
from vpptwin.effects import CATALOGUE, Effect, Parameter, Stage, effects_for_rig, find_effect, generic_place
from vpptwin.effects.actuator import list_loop_effects
from vpptwin.effects.table import print_catalogue

# What other tools depend on: effects of the drone, names of the parameters with their units.
DAMPING, FORCE, STRIBECK = {"damping": "N s/m"}, {"force": "N"}, {"force": "N", "velocity": "m/s"}
AGREED_EFFECTS: dict[str, dict[str, str]] = {
    "rail_x.coulomb": FORCE,
    "rail_z.coulomb": FORCE,
    "rail_x.stiction": STRIBECK,
    "rail_z.stiction": STRIBECK,
    "rail_x.viscous": DAMPING,
    "rail_z.viscous": DAMPING,
    "pitch.viscous": {"damping": "N m s/rad"},
    "rail_x.jamming": {"mu": ""},
    "rail_z.jamming": {"mu": ""},
    "rail_x.bias": FORCE,
    "rail_z.bias": FORCE,
    "pitch.bias": {"force": "N m"},
    "rail_x.spring": {"stiffness": "N/m", "rest": "m"},
    "rail_x.asymmetry": {"fraction": ""},
    "rail_z.asymmetry": {"fraction": ""},
    "rail_x.tight_spot": {"force": "N", "place": "m", "width": "m"},
    "pitch.coulomb": {"torque": "N m"},
    "rail.tilt": {"angle": "rad"},
    "airframe.mass": {"mass": "kg"},
    "airframe.inertia": {"inertia": "kg m^2"},
    "carriage.mass": {"mass": "kg"},
    "airframe.com": {"offset": "m"},
    "airframe.com_height": {"offset": "m"},
    "air.drag": {"k_d": "N s^2/m^2"},
    "air.ground_effect": {"gain": "", "height": "m"},
    "rotor.thrust_gain": {"gain": ""},
    "rotor.asymmetry": {"fraction": ""},
    "rotor.negative_thrust": {"loss": ""},
    "rotor.stall": {"onset": "rad"},
    "rotor.inflow": {"damping": "N s/(m rad)"},
    "rotor.in_plane": {"damping": "N s/(m rad)"},
    "rotor.drag": {"gain": ""},
    "battery.sag": {"rate": "1/s"},
    "servo.lag": {"time_constant": "s"},
    "servo.rate_limit": {"rate": "rad/s"},
    "servo.backlash": {"gap": "rad"},
    "servo.trim": {"offset_1": "rad", "offset_2": "rad"},
    "command.delay": {"delay": "s"},
    "mocap.delay": {"delay": "s"},
    "mocap.misalignment": {"angle": "rad"},
    "mocap.scale": {"scale": ""},
    "clock.drift": {"drift": "s/s"},
    "gyro.bias": {"bias": "rad/s"},
    "gyro.scale": {"scale": ""},
}
MORE_EFFECTS: dict[str, dict[str, str]] = {
    "rail_x.lugre": {"compliance": "m/N"},
    "rail_z.lugre": {"compliance": "m/N"},
    "pitch.lugre": {"compliance": "rad/(N m)"},
    "rail_x.elastic": {"share": "", "frequency": "Hz", "zeta": ""},
    "contact.compliance": {"stiffness": "", "damping": ""},
    "contact.friction": {"gain": ""},
}
"""What the catalogue has besides these."""
JOINT_KINDS = {"coulomb", "stiction", "viscous", "bias", "spring", "inertia", "lugre", "offset", "load",
                    "rate_bias", "rate_scale", "cogging", "tight_spot", "fade",
                    "drag"}  # fmt: skip
ACTUATOR_KINDS = {"delay", "gain", "lag", "backlash", "rate_limit", "saturation", "dead_band", "sag"}
BODY_KINDS = {"mass", "com", "payload", "tilt"}
MOVED = {f"swing.{kind}" for kind in ("bias", "spring", "offset")}
WEIGHED = {f"pole.{kind}": {"motor.gain"} for kind in ("mass", "payload", "com")} | {key: {"pole.com"} for key in MOVED}
WEIGHED |= {"motor.gain": {"pole.mass", "pole.payload", "pole.com"}, "pole.com": {"motor.gain", *MOVED}}
"""Look-alikes of other targets: of a pole's weight, and of where it pulls."""
CONTACT_KINDS = {"compliance", "friction"}
TOPICS = {"/mocap/pose", "/imu/data", "/rotor/command", "/rotor/state", "/battery", "/joint_states"}
RATIOS = {"gain", "fraction", "mu", "loss", "scale", "share", "zeta"}
"""Parameters that are pure numbers, as are all of contacts."""
SHAPES = {"velocity", "rest", "place", "width", "height", "frequency", "zeta", "place_x", "place_y", "place_z",
          "waves", "phase"}  # fmt: skip
"""Parameters that merely shape an effect whose strength another one gives."""
LIMITS = {"rate_limit", "saturation", "stall"}
"""Effects that are off where their limit is too far to be reached: at the upper bound."""

EVERY_EFFECT = [pytest.param(effect, id=effect.id) for effect in (*CATALOGUE, *CART_EFFECTS)]
EVERY_PARAMETER = [pytest.param(e, p, id=f"{e.id}.{p.name}") for e in (*CATALOGUE, *CART_EFFECTS) for p in e.parameters]


def is_limit(effect: Effect) -> bool:
    """Whether an effect is off at the upper bound of its parameter."""
    return effect.id.rpartition(".")[2] in LIMITS


def test_the_catalogue_is_the_agreed_one() -> None:
    """Every effect that was agreed on is there once, with its parameters and units; what is besides is listed."""
    ids = [effect.id for effect in CATALOGUE]
    assert len(set(ids)) == len(ids)
    assert {e.id: {p.name: p.unit for p in e.parameters} for e in CATALOGUE} == AGREED_EFFECTS | MORE_EFFECTS


def test_any_rig_has_the_generic_effects() -> None:
    """Every joint and every actuator of another rig has all the generic effects, once."""
    wanted = {f"{joint}.{kind}" for joint in ("slide", "swing") for kind in JOINT_KINDS}
    wanted -= {"slide.offset", "swing.load", "swing.fade"}
    wanted |= {f"motor.{kind}" for kind in ACTUATOR_KINDS} | {"pole.mass", "pole.com", "pole.payload"}
    wanted |= {"mount.tilt"}
    wanted |= {f"contact.{kind}" for kind in CONTACT_KINDS}
    assert {effect.id for effect in CART_EFFECTS} == wanted
    assert len(CART_EFFECTS) == len(wanted)


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.id)
def test_ids_name_what_the_effect_acts_on(effect: Effect) -> None:
    """An id reads part.kind in lower case, and the part is the joint or body that the effect acts on, if any."""
    assert re.fullmatch(r"[a-z]+(_[a-z]+)*\.[a-z]+(_[a-z]+)*", effect.id)
    assert effect.target in ("", effect.id.split(".")[0])
    assert set(effect.needs) <= {"carriage", "slider"}


@pytest.mark.parametrize("effects", [CATALOGUE, CART_EFFECTS], ids=["drone", "cart"])
def test_look_alikes_are_mutual(effects: tuple[Effect, ...]) -> None:
    """A look-alike is another effect of the same rig, listed once, and takes this one for its own look-alike."""
    known = {effect.id: effect for effect in effects}
    assert len(known) == len(effects)
    for effect in effects:
        assert len(set(effect.look_alikes)) == len(effect.look_alikes)
        assert effect.id not in effect.look_alikes
        for alike in effect.look_alikes:
            assert effect.id in known[alike].look_alikes, f"{alike} does not list {effect.id}"


def test_known_look_alikes_are_listed() -> None:
    """The groups that a study of this rig found hard to tell apart are there."""
    groups = (
        ("rail_x.bias", "rail.tilt", "mocap.misalignment"),
        ("airframe.mass", "rotor.thrust_gain", "servo.trim"),
        ("rotor.asymmetry", "servo.trim", "airframe.com"),
        ("rail_x.viscous", "air.drag", "rotor.in_plane"),
        ("command.delay", "servo.lag"),
        ("airframe.inertia", "gyro.scale", "rotor.thrust_gain"),
        ("mocap.delay", "clock.drift"),
        ("rail_x.asymmetry", "rail.tilt"),
        ("rail_x.spring", "carriage.mass"),
    )
    for group in groups:
        for effect_id in group:
            assert set(group) - {effect_id} <= set(find_effect(CATALOGUE, effect_id).look_alikes)


def test_what_scales_friction_comes_after_all_of_it() -> None:
    """Friction that depends on the direction is the last friction of its joint, since it scales what came before."""
    for joint in ("rail_x", "rail_z"):
        rubbing = [e.id for e in CATALOGUE if e.stage is Stage.FRICTION and e.target == joint]
        assert rubbing[-1] == f"{joint}.asymmetry"
        assert rubbing[0] in find_effect(CATALOGUE, rubbing[-1]).modifies


@pytest.mark.parametrize("effect", CART_EFFECTS, ids=lambda effect: effect.id)
def test_generic_ids_name_their_target(effect: Effect) -> None:
    """A generic effect is called after the joint or actuator it acts on, then by its kind."""
    target, _, kind = effect.id.rpartition(".")
    special = {"motor": ACTUATOR_KINDS, "pole": BODY_KINDS, "mount": BODY_KINDS, "contact": CONTACT_KINDS}
    kinds = special.get(target, JOINT_KINDS)
    assert effect.target == ("" if target in ("mount", "contact") else target)
    assert kind in kinds
    alike = set(effect.look_alikes) - WEIGHED.get(effect.id, set())
    assert len(alike) == len(effect.look_alikes) - len(WEIGHED.get(effect.id, ()))
    assert {other.rpartition(".")[2] for other in alike} <= kinds
    assert {other.rpartition(".")[0] for other in alike} <= {target}


@pytest.mark.parametrize("effect", EVERY_EFFECT)
def test_effect_tells_what_a_report_needs(effect: Effect) -> None:
    """An effect has parameters, topics of docs/logs.md, an equation, and a summary that fits into a sentence."""
    names = [p.name for p in effect.parameters]
    assert names
    assert len(set(names)) == len(names)
    assert effect.shows
    assert set(effect.shows) <= TOPICS
    assert effect.equation
    assert effect.summary
    assert not effect.summary.endswith(".")
    assert effect.summary[0].islower()
    assert effect.follows in ("velocity", "position", "command", "command change")
    assert bool(effect.writes) == (effect.stage is Stage.CONSTANT)


@pytest.mark.parametrize("effect", EVERY_EFFECT)
def test_every_parameter_is_in_the_equation(effect: Effect) -> None:
    """The equation speaks of each parameter by its name, so that the table can be read."""
    assert all(p.name in effect.equation for p in effect.parameters)


@pytest.mark.parametrize(("effect", "parameter"), EVERY_PARAMETER)
def test_parameter_numbers_make_sense(effect: Effect, parameter: Parameter) -> None:
    """Off lies within the bounds, a step of the size from there too, and only ratios lack a unit."""
    assert parameter.low <= parameter.off <= parameter.high
    if is_limit(effect):  # the step leads to a limit that is often reached
        assert parameter.off == parameter.high
        assert parameter.low < parameter.off - parameter.size
    else:
        assert 0.0 < parameter.size <= 0.5 * (parameter.high - parameter.low)
    assert np.isfinite([parameter.low, parameter.off, parameter.high, parameter.size, parameter.tolerance]).all()
    assert bool(parameter.unit) != (parameter.name in RATIOS or effect.touching)


@pytest.mark.parametrize(("effect", "parameter"), EVERY_PARAMETER)
def test_parameter_numbers_have_a_source(effect: Effect, parameter: Parameter) -> None:
    """Where the numbers come from is told in a few words: what kind of source first, and of an assumption why."""
    assert re.match(r"(datasheet|paper|vehicle\.yaml|assumption: \w)", parameter.source)
    assert len(parameter.source) <= 60
    assert bool(parameter.nominal) == parameter.source.startswith("vehicle.yaml")


@pytest.mark.parametrize(("effect", "parameter"), EVERY_PARAMETER)
def test_tolerance_is_below_what_is_looked_for(effect: Effect, parameter: Parameter) -> None:
    """A build tolerance is a fraction of the size; of what merely shapes an effect, any value passes unremarked."""
    if parameter.name in SHAPES:
        assert parameter is not effect.parameters[0]
        assert parameter.tolerance >= parameter.high - parameter.off
    else:
        assert 0.0 < parameter.tolerance < 0.3 * parameter.size


@pytest.mark.parametrize(("effect", "parameter"), EVERY_PARAMETER)
def test_prior_lies_within_the_bounds(effect: Effect, parameter: Parameter) -> None:
    """Draws stay within the bounds, nearly all without being clipped, and centre on or start at off, or are limits."""
    raw = parameter.prior.draw(np.random.default_rng(1), 4000)
    drawn = parameter.draw(np.random.default_rng(1), 4000)
    assert ((drawn >= parameter.low) & (drawn <= parameter.high)).all()
    assert np.mean(raw == drawn) > 0.98
    if is_limit(effect):  # every real servo has its limit
        assert parameter.off - drawn.mean() > 0.5 * parameter.size
    else:
        assert parameter.prior.a == parameter.off
        assert 0.1 * parameter.size < drawn.std()
    assert drawn.std() < 0.5 * (parameter.high - parameter.low)


def test_unknown_effect_names_close_ones() -> None:
    """An id that does not exist is refused with those that resemble it, or with all if none does."""
    with pytest.raises(KeyError, match=r"rail_x\.coulomb"):
        find_effect(CATALOGUE, "rail_x.colomb")
    with pytest.raises(KeyError, match=r"air\.drag.*servo\.lag"):
        find_effect(CATALOGUE, "0123456789")


def test_printed_tables_have_a_row_for_every_parameter(capsys: pytest.CaptureFixture[str]) -> None:
    """Both forms of the table have one row a parameter; in Markdown every row has as many cells as the header."""
    expected = [(effect.id, p.name) for effect in CATALOGUE for p in effect.parameters]
    print_catalogue(CATALOGUE)
    plain = [tuple(line.split()[:2]) for line in capsys.readouterr().out.splitlines()]
    assert plain == [("id", "parameter"), *expected]
    print_catalogue(CATALOGUE, markdown=True)
    page = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    header, rule, *rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in page]
    assert [(row[0].strip(), row[1].strip()) for row in rows] == expected
    assert {len(row) for row in (header, rule, *rows)} == {len(header)}
    lag = next(row for row in rows if row[0].strip() == "servo.lag")
    assert [cell.strip() for cell in lag[2:5]] == ["s", "0.02", "0.001 to 0.2"]


def test_ids_are_apart_whatever_joints_and_actuators_are_called() -> None:
    """One may be called as all together are; then these have the names of all."""
    names = ("joints", "knee", "actuators")
    places = [generic_place(name, True, 1.0, driven=True) for name in names]
    loops = dict.fromkeys(names, list_loop_effects(9.0, -9.0, -1.0))
    found = effects_for_rig(places, dict.fromkeys(names, 1.0), whole=names, drives={names: names}, loops=loops)
    ids = [effect.id for effect in found]
    assert len(ids) == len(set(ids))
    assert {f"joints+knee+actuators.{kind}" for kind in ("coulomb", "gain", "stiffness")} < set(ids)
