"""What every effect says about itself: ids, units, bounds, priors, look-alikes, and the table made of them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.effects.rigs import CART_EFFECTS
from vpptwin.effects import CATALOGUE, Effect, Parameter, Stage, find_effect
from vpptwin.effects.table import print_catalogue

# fmt: off
SPEC_IDS = {
    "rail_x.coulomb", "rail_z.coulomb", "rail_x.stiction", "rail_z.stiction", "rail_x.viscous",
    "rail_z.viscous", "pitch.viscous", "rail_x.jamming", "rail_z.jamming", "rail_x.bias", "rail_z.bias",
    "pitch.bias", "rail_x.spring", "rail_x.asymmetry", "rail_z.asymmetry", "rail_x.tight_spot",
    "pitch.coulomb", "rail.tilt", "airframe.mass", "airframe.inertia", "carriage.mass", "airframe.com",
    "airframe.com_height", "air.drag", "air.ground_effect", "rotor.thrust_gain", "rotor.asymmetry",
    "rotor.negative_thrust", "rotor.stall", "rotor.inflow", "rotor.in_plane", "rotor.drag", "battery.sag",
    "servo.lag", "servo.rate_limit", "servo.backlash", "servo.trim", "command.delay", "mocap.delay",
    "mocap.misalignment", "mocap.scale", "clock.drift", "gyro.bias", "gyro.scale",
}
# fmt: on
"""Ids of SPEC 5, whether there yet or not."""
SPEC_JOINT_KINDS = {"coulomb", "stiction", "viscous", "bias", "spring", "inertia"}
SPEC_ACTUATOR_KINDS = {"delay", "gain", "lag", "backlash", "rate_limit", "saturation"}
SPEC_TOPICS = {"/mocap/pose", "/imu/data", "/rotor/command", "/rotor/state", "/battery", "/joint_states"}
# fmt: off
FIRST_TWELVE = {
    "rail_x.coulomb", "rail_z.coulomb", "rail_x.viscous", "rail_z.viscous", "rail_x.bias", "rail_z.bias",
    "airframe.mass", "airframe.inertia", "air.drag", "rotor.thrust_gain", "rotor.asymmetry", "servo.lag",
    "command.delay", "mocap.delay",
}
# fmt: on
RATIOS = {"gain", "fraction", "mu", "loss", "scale"}
"""Parameters of SPEC 5 that are pure numbers."""

EVERY_EFFECT = [pytest.param(effect, id=effect.id) for effect in (*CATALOGUE, *CART_EFFECTS)]
EVERY_PARAMETER = [pytest.param(p, id=f"{e.id}.{p.name}") for e in (*CATALOGUE, *CART_EFFECTS) for p in e.parameters]


def test_ids_are_unique() -> None:
    """No id occurs twice, and the drone has the effects that were promised first."""
    ids = [effect.id for effect in CATALOGUE]
    assert len(set(ids)) == len(ids)
    assert set(ids) >= FIRST_TWELVE
    assert len({effect.id for effect in CART_EFFECTS}) == len(CART_EFFECTS)


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.id)
def test_ids_are_those_of_the_spec(effect: Effect) -> None:
    """An id reads part.kind in lower case and stands in SPEC 5, as do its look-alikes, of which it is none itself."""
    assert re.fullmatch(r"[a-z]+(_[a-z]+)*\.[a-z]+(_[a-z]+)*", effect.id)
    assert effect.id in SPEC_IDS
    assert set(effect.look_alikes) <= SPEC_IDS
    assert effect.id not in effect.look_alikes
    assert len(set(effect.look_alikes)) == len(effect.look_alikes)
    assert effect.target in ("", effect.id.split(".")[0])


@pytest.mark.parametrize("effect", CART_EFFECTS, ids=lambda effect: effect.id)
def test_generic_ids_name_their_target(effect: Effect) -> None:
    """A generic effect is called after the joint or actuator it acts on, with a kind of SPEC 5."""
    target, _, kind = effect.id.rpartition(".")
    kinds = SPEC_ACTUATOR_KINDS if target == "motor" else SPEC_JOINT_KINDS
    assert target == effect.target
    assert kind in kinds
    assert {alike.rpartition(".")[2] for alike in effect.look_alikes} <= kinds
    assert {alike.rpartition(".")[0] for alike in effect.look_alikes} <= {target}


@pytest.mark.parametrize("effect", EVERY_EFFECT)
def test_effect_tells_what_a_report_needs(effect: Effect) -> None:
    """An effect has parameters, signals of SPEC 3, an equation, and a summary that fits into a sentence."""
    names = [p.name for p in effect.parameters]
    assert names
    assert len(set(names)) == len(names)
    assert effect.shows
    assert set(effect.shows) <= SPEC_TOPICS
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


@pytest.mark.parametrize("parameter", EVERY_PARAMETER)
def test_parameter_numbers_make_sense(parameter: Parameter) -> None:
    """Off lies within the bounds, the size is positive and fits between them, only ratios lack a unit."""
    assert parameter.low <= parameter.off <= parameter.high
    assert 0.0 < parameter.size <= 0.5 * (parameter.high - parameter.low)
    assert parameter.tolerance >= 0.0
    assert np.isfinite([parameter.low, parameter.off, parameter.high, parameter.size, parameter.tolerance]).all()
    assert bool(parameter.unit) != (parameter.name in RATIOS)


@pytest.mark.parametrize("parameter", EVERY_PARAMETER)
def test_prior_lies_within_the_bounds(parameter: Parameter) -> None:
    """Draws stay within the bounds, nearly all of them without being clipped, and are centred on or start at off."""
    raw = parameter.prior.draw(np.random.default_rng(1), 4000)
    drawn = parameter.draw(np.random.default_rng(1), 4000)
    assert ((drawn >= parameter.low) & (drawn <= parameter.high)).all()
    assert np.mean(raw == drawn) > 0.98
    assert parameter.prior.a == parameter.off
    assert 0.1 * parameter.size < drawn.std() < 0.5 * (parameter.high - parameter.low)


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
