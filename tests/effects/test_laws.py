"""The physics of every effect, against values worked out by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.effects.rigs import CART_EFFECTS
from vpptwin.actuators.layer import weaken_control
from vpptwin.effects import CATALOGUE, Craft, Motion, Rotor, Site, Stage, find_effect
from vpptwin.effects.actuator import SAG, list_loop_effects
from vpptwin.twin.sensors import perfect_sensors

EFFECTS = (*CATALOGUE, *CART_EFFECTS)
ROUNDING = 1e-12
"""The numbers below are exact, or carry functions that numpy computes to the last bit or two."""

E = np.e

# Laws of every step: what the effect is given before its parameters, its parameters, what it returns.
FORWARD = Motion(position=0.3, velocity=0.1, direction=1.0, load=-2.0, lever=15.0, inertia=0.5)
BACKWARD = Motion(position=0.3, velocity=-0.1, direction=-1.0, load=2.0, lever=-15.0, inertia=0.5)
AT_REST = Motion(position=0.3, velocity=0.0, direction=1.0, load=0.0, lever=0.0, inertia=0.5)
# v = (3, -4) m/s, |v| = 5; arm along (cos θ, sin θ) = (0.8, 0.6); upright and climbing: nothing along the arm.
CRAFT = Craft(0.1, 1.2, 3.0, -4.0, 2.0, sine=0.6, cosine=0.8, arm=0.2, speed_1=450.0, speed_2=550.0, time=1.0)
CLIMBING = CRAFT._replace(v_x=0.0, v_z=2.0, sine=0.0, cosine=1.0)
LEFT = Rotor(side=-1.0, speed=500.0, pitch=0.12, height=0.6, axial=0.5)
RIGHT = Rotor(side=1.0, speed=500.0, pitch=-0.20, height=0.6, axial=-0.5)
STEP_LAWS = [
    # Dry friction: level before, motion → level after [N, N m].
    ("rail_x.coulomb", (0.2, FORWARD), (0.3,), 0.5),  # 0.2 + 0.3, at any speed
    ("pitch.coulomb", (0.0, BACKWARD), (0.02,), 0.02),  # a level has no sign
    ("slide.coulomb", (0.2, AT_REST), (0.3,), 0.5),
    ("rail_x.stiction", (0.2, AT_REST), (0.3, 0.05), 0.5),  # breakaway: all of it, exp(0) = 1
    ("rail_x.stiction", (0.2, FORWARD), (0.3, 0.1), 0.2 + 0.3 / E),  # (0.1/0.1)² = 1
    ("swing.stiction", (0.2, BACKWARD), (0.3, 0.05), 0.2 + 0.3 / E**4),  # (-0.1/0.05)² = 4
    ("rail_x.jamming", (0.2, FORWARD), (0.02,), 0.8),  # 0.2 + 0.02 · |-2 · 15| = 0.2 + 0.6
    ("rail_x.jamming", (0.2, BACKWARD), (0.02,), 0.8),
    ("rail_x.jamming", (0.2, AT_REST), (0.02,), 0.2),  # nothing carried
    ("rail_z.jamming", (0.2, FORWARD), (0.25,), 0.7),  # 0.2 + 0.25 · |-2|, whatever the lever
    ("slide.load", (0.2, FORWARD), (0.15,), 0.5),  # 0.2 + 0.15 · |-2|
    ("rail_x.tight_spot", (0.2, FORWARD), (0.5, 0.3, 0.1), 0.7),  # in its middle
    ("swing.tight_spot", (0.2, AT_REST), (0.5, 0.5, 0.1), 0.2 + 0.5 / E**4),  # two widths away: (-0.2/0.1)² = 4
    ("rail_x.asymmetry", (0.4, FORWARD), (0.25,), 0.5),  # 0.4 · (1 + 0.25)
    ("rail_x.asymmetry", (0.4, BACKWARD), (0.25,), 0.3),  # 0.4 · (1 - 0.25)
    ("rail_z.asymmetry", (0.4, FORWARD), (-0.25,), 0.3),
    # Force on a joint [N, N m].
    ("rail_x.bias", (FORWARD,), (0.3,), 0.3),
    ("swing.bias", (BACKWARD,), (-0.3,), -0.3),
    ("rail_x.spring", (FORWARD,), (2.0, -0.1), -0.8),  # -2 · (0.3 + 0.1)
    ("swing.spring", (AT_REST,), (2.0, 0.5), 0.4),  # -2 · (0.3 - 0.5)
    ("slide.drag", (BACKWARD,), (2.0,), 0.02),  # 2 · 0.1²
    ("swing.drag", (FORWARD,), (2.0,), -0.02),
    ("slide.fade", (FORWARD,), (2.0,), 0.0),  # -2 N brakes it
    ("slide.fade", (Motion(0.0, -0.1, 0.0, -2.0, 0.0, 0.5),), (2.0,), 0.4),  # a fifth less of the 2 N that drive it
    ("slide.fade", (Motion(0.0, 0.7, 0.0, 2.0, 0.0, 0.5),), (2.0,), -2.0),  # too fast for any
    ("slide.cogging", (FORWARD,), (2.0, 5.0, 0.0), 0.0),  # one and a half periods on
    ("swing.cogging", (FORWARD,), (2.0, 2.5, -np.pi / 2.0), 0.0),
    ("swing.cogging", (AT_REST,), (2.0, 0.0, np.pi / 6.0), 1.0),
    # Force on the craft [N, N, N m].
    ("air.drag", (CRAFT,), (0.1,), (-1.5, 2.0, 0.0)),  # -0.1 · 5 · (3, -4)
    ("air.drag", (CLIMBING,), (0.1,), (0.0, -0.4, 0.0)),  # -0.1 · 2 · 2
    # Along the arm 3 · 0.8 - 4 · 0.6 = 0: it slips along its thrust axis. Turned to (0.6, 0.8) it would not.
    ("rotor.in_plane", (CRAFT,), (5e-4,), (0.0, 0.0, 0.0)),
    # v_arm = 3 · 0.6 - 4 · 0.8 = -1.4; -5e-4 · (450 + 550) · -1.4 = 0.7 along the arm: 0.7 · (0.6, 0.8)
    ("rotor.in_plane", (CRAFT._replace(sine=0.8, cosine=0.6),), (5e-4,), (0.42, 0.56, 0.0)),
    ("rotor.in_plane", (CLIMBING,), (5e-4,), (0.0, 0.0, 0.0)),
    # Thrust of one rotor before → after [N].
    ("rotor.thrust_gain", (3.0, LEFT), (0.9,), 2.7),
    ("rotor.thrust_gain", (-3.0, RIGHT), (0.9,), -2.7),
    ("rotor.asymmetry", (3.0, LEFT), (0.1,), 3.3),  # rotor 1 · (1 + 0.1)
    ("rotor.asymmetry", (3.0, RIGHT), (0.1,), 2.7),  # rotor 2 · (1 - 0.1)
    ("rotor.negative_thrust", (3.0, LEFT), (0.2,), 3.0),  # pitch is positive
    ("rotor.negative_thrust", (-3.0, RIGHT), (0.2,), -2.4),  # -3 · (1 - 0.2)
    ("rotor.negative_thrust", (0.0, LEFT._replace(pitch=0.0)), (0.2,), 0.0),
    ("rotor.stall", (3.0, LEFT), (0.16,), 3.0),  # 0.12 rad is below onset
    # 0.20 rad with onset 0.16 counts as 0.16 + 0.04/4 = 0.17: -4 · 0.17/0.20 = -3.4
    ("rotor.stall", (-4.0, RIGHT), (0.16,), -3.4),
    ("rotor.stall", (4.0, RIGHT._replace(pitch=0.20)), (0.16,), 3.4),
    ("rotor.stall", (0.0, LEFT._replace(pitch=0.0)), (0.16,), 0.0),
    ("rotor.inflow", (3.0, LEFT), (1e-3,), 2.75),  # 3 - 1e-3 · 500 · 0.5: it climbs
    ("rotor.inflow", (-3.0, RIGHT), (1e-3,), -2.75),  # it sinks
    ("air.ground_effect", (3.0, LEFT), (0.4, 0.3), 3.0 * (1.0 + 0.4 / E**2)),  # 0.6/0.3 = 2
    ("air.ground_effect", (-3.0, LEFT._replace(height=0.0)), (0.4, 0.3), -4.2),  # on the floor: 1 + 0.4
    ("air.ground_effect", (3.0, LEFT._replace(height=-900.0)), (0.4, 0.3), 4.2),  # a free craft may fall for ever
]

# Bristles of 0.01 m/N that carry 0.5 kg: motion, friction forward and backward [N], deflection before [m], bend of it
# that is damped, by 2 √(0.5/0.01) N s/m, deflection 1 ms later.
SIGMA = 2.0 * np.sqrt(50.0)
BRISTLES = {
    "at rest": (AT_REST, (0.4, 0.4), 1e-3, 0.0, 1e-3),  # they push back, and stay
    "bending": (FORWARD, (0.4, 0.3), 1e-3, 1e-4, 1.1e-3),  # by v dt = 0.1 mm
    # Half of it up to 0.9 of 4 mm, half beyond, ever more slipping: 4 - 0.4 exp(-0.05/0.4) mm
    "yielding": (FORWARD, (0.4, 0.3), 3.55e-3, 0.5e-4, 4e-3 - 0.4e-3 * np.exp(-0.125)),
    "slipping": (BACKWARD, (0.4, 0.3), -3e-3, 0.0, -3e-3),  # as far as they bend: 0.3 N backward
    "overbent": (FORWARD, (0.1, 0.1), 5e-3, 0.0, 1e-3 + 4e-3 / E),  # what could hold 0.5 N lets go
    "no friction": (FORWARD, (0.0, 0.0), 0.0, 0.0, 0.0),
}

# Constants: what the effect writes, at parameters that differ between two simulations. Body 2, dof 1 and actuator 0 are
# those that the effect acts on; the craft is body 2, its nominal mass 0.45 kg.
SITE = Site(dof=1, place=1, actuator=0, body=2)
G = 9.81
SIXTH = np.pi / 6  # sin = 1/2
CONSTANT_LAWS = [
    # Time constant by damping, ratio by damping over the root of stiffness; numbers below zero are the two themselves.
    ("contact.compliance", {"stiffness": (4.0, 1.0), "damping": (2.0, 0.5)},
     {"geom_solref": [[[0.01, 1.0], [-400.0, -20.0]], [[0.04, 0.5], [-100.0, -5.0]]]}),
    ("contact.friction", {"gain": (0.5, 2.0)}, {"geom_friction": [[[0.2, 0.1], [0.5, 0.1]], [[0.8, 0.1], [2.0, 0.1]]]}),
    ("rail_x.viscous", {"damping": (0.3, 0.5)}, {"dof_damping": [[0, 0.4, 0], [0, 0.6, 0]]}),  # 0.1 besides
    ("slide.inertia", {"inertia": (0.1, -0.1)}, {"dof_armature": [[0, 0.3, 0], [0, 0.1, 0]]}),  # 0.2 besides
    ("swing.offset", {"angle": (0.1, -0.1)},
     {"qpos0": [[0, 0.1, 0], [0, -0.1, 0]], "qpos_spring": [[0, 0.4, 0], [0, 0.2, 0]]},  # 0.3 besides
    ),
    # Raised by 30° along +x, half of gravity pulls back along x; what pulls along z stays.
    ("rail.tilt", {"angle": (SIXTH, -SIXTH)}, {"opt.gravity": [[-G / 2, 0, -G], [G / 2, 0, -G]]}),
    ("airframe.mass", {"mass": (0.05, -0.05)}, {"body_mass": [[0, 0.08, 0.50], [0, 0.08, 0.40]]}),
    # About the axis into the page alone.
    (
     "airframe.inertia",
     {"inertia": (1e-3, -1e-3)},
     {"body_inertia": [[[0] * 3, [0] * 3, [6e-3, y, 6e-3]] for y in (7e-3, 5e-3)]}),
    ("airframe.com", {"offset": (0.01, -0.01)}, {"body_ipos": [[[0] * 3, [0] * 3, [x, 0, 0]] for x in (0.01, -0.01)]}),
    ("airframe.com_height", {"offset": (0.01, -0.01)},
     {"body_ipos": [[[0] * 3, [0] * 3, [0, 0, z]] for z in (0.01, -0.01)]}),
    ("rotor.drag", {"gain": (1.2, 0.8)}, {"rotor.drag_gain": [1.2, 0.8]}),
    ("battery.sag", {"rate": (0.005, 0.0)}, {"battery.sag": [0.005, 0.0]}),
    # Both servos.
    ("servo.lag", {"time_constant": (0.03, 0.01)}, {"actuator.time_constant": [[0.03, 0.03], [0.01, 0.01]]}),
    ("servo.rate_limit", {"rate": (3.0, 1000.0)}, {"actuator.rate_limit": [[3.0, 3.0], [1000.0, 1000.0]]}),
    ("servo.backlash", {"gap": (0.01, 0.02)}, {"actuator.gap": [[0.01, 0.01], [0.02, 0.02]]}),
    ("servo.trim", {"offset_1": (0.01, 0.02), "offset_2": (-0.01, 0.0)},
     {"actuator.trim": [[0.01, -0.01], [0.02, 0.0]]}),
    ("command.delay", {"delay": (0.004, 0.008)}, {"actuator.delay": [[0.004, 0.004], [0.008, 0.008]]}),
    ("mocap.delay", {"delay": (0.004, 0.008)}, {"pose.delay": [[0.004] * 3, [0.008] * 3]}),
    ("clock.drift", {"drift": (1e-4, -1e-4)}, {"pose.drift": [[1e-4] * 3, [-1e-4] * 3]}),
    ("mocap.misalignment", {"angle": (0.02, -0.02)}, {"pose.offset": [[0, 0, 0.02], [0, 0, -0.02]]}),
    ("mocap.scale", {"scale": (1.02, 0.98)}, {"pose.scale": [[1.02, 1.02, 1], [0.98, 0.98, 1]]}),
    ("gyro.bias", {"bias": (0.05, -0.05)}, {"rate.bias": [[0, 0, 0.05], [0, 0, -0.05]]}),
    ("gyro.scale", {"scale": (1.05, 0.95)}, {"rate.scale": [[1, 1, 1.05], [1, 1, 0.95]]}),
    ("swing.rate_bias", {"bias": (0.05, 0.0)}, {"rate.bias": [[0, 0.05, 0], [0, 0, 0]]}),
    ("swing.rate_scale", {"scale": (1.05, 0.95)}, {"rate.scale": [[1, 1.05, 1], [1, 0.95, 1]]}),
    # The first actuator alone.
    ("motor.gain", {"gain": (1.2, 0.8)}, {"actuator.gain": [[1.2, 1.0], [0.8, 1.0]]}),
    ("motor.delay", {"delay": (0.004, 0.008)}, {"actuator.delay": [[0.004, 0.0], [0.008, 0.0]]}),
    ("motor.lag", {"time_constant": (0.03, 0.01)}, {"actuator.time_constant": [[0.05, 0.02], [0.03, 0.02]]}),
    ("motor.rate_limit", {"rate": (3.0, 10.0)}, {"actuator.rate_limit": [[3.0, 1e9], [10.0, 1e9]]}),
    ("motor.backlash", {"gap": (0.01, 0.02)}, {"actuator.gap": [[0.01, 0.0], [0.02, 0.0]]}),
    ("motor.dead_band", {"band": (0.5, 0.2)}, {"actuator.dead_band": [[0.5, 0.0], [0.2, 0.0]]}),
    ("motor.sag", {"rate": (0.005, 0.0)}, {"actuator.sag": [[0.005, 0.0], [0.0, 0.0]]}),
    # A link of 0.45 kg and 6 g m² that weighs a third more has a third more inertia.
    ("pole.mass", {"mass": (0.15, -0.15)},
     {"body_mass": [[0, 0.08, 0.60], [0, 0.08, 0.30]],
         "body_inertia": [[[0] * 3, [0] * 3, [i] * 3] for i in (8e-3, 4e-3)]}),
    # Along the axes that show; mass and inertia about it stay.
    ("pole.com", {"x": (0.02, 0.0), "z": (-0.1, 0.1)},
     {"body_ipos": [[[0] * 3, [0] * 3, [x, 0, z]] for x, z in ((0.02, -0.1), (0.0, 0.1))]}),
    # 0.15 kg at 0.4 m of 0.45 kg: a quarter of the way, and a reduced mass of 0.1125 kg at 0.4 m; none changes nothing.
    ("pole.payload", {"mass": (0.15, 0.0), "place_x": (0.0, 1.0), "place_y": (0.0, 1.0), "place_z": (0.4, 1.0)},
     {"body_mass": [[0, 0.08, 0.60], [0, 0.08, 0.45]],
         "body_ipos": [[[0] * 3, [0] * 3, [0, 0, z]] for z in (0.1, 0.0)],
         "body_iquat": [[[1, 0, 0, 0]] * 2 + [[0.5**0.5, 0, -(0.5**0.5), 0]], [[1, 0, 0, 0]] * 3],
         "body_inertia": [[[0] * 3, [0] * 3, [6e-3, more, more]] for more in (24e-3, 6e-3)]}),
    # Turned by 30° about y, so that its x points down, half of gravity pulls along x.
    ("mount.tilt", {"x": (0.0, SIXTH), "y": (SIXTH, 0.0)},
     {"opt.gravity": [[G / 2, 0, -G * 0.75**0.5], [0, -G / 2, -G * 0.75**0.5]]}),
    ("motor.saturation", {"limit": (0.5, 2.0)}, {"actuator.limit": [[0.5, 1e9], [2.0, 1e9]]}),
]  # fmt: skip


def nominal_constants() -> dict[str, np.ndarray]:
    """Constants of two simulations with three bodies, three degrees of freedom and two actuators."""

    def rows(*values: Any) -> np.ndarray:  # noqa: ANN401
        return np.repeat(np.array([values], dtype=float), 2, axis=0)

    per_actuator = {"delay": 0.0, "time_constant": 0.02, "rate_limit": 1e9, "gap": 0.0, "trim": 0.0, "gain": 1.0}
    per_actuator |= {"dead_band": 0.0, "sag": 0.0}
    table = {f"actuator.{name}": rows(value, value) for name, value in per_actuator.items()}
    table["actuator.limit"] = rows(1e9, 1e9)
    table |= {"battery.sag": np.zeros(2), "rotor.drag_gain": np.ones(2)} | perfect_sensors(2)
    return table | {
        "body_mass": rows(0.0, 0.08, 0.45),
        "qpos0": rows(0.0, 0.0, 0.0),
        "qpos_spring": rows(0.0, 0.3, 0.0),
        "body_inertia": rows([0.0] * 3, [0.0] * 3, [6e-3] * 3),
        "body_iquat": rows([1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]),
        "body_ipos": rows([0.0] * 3, [0.0] * 3, [0.0] * 3),
        "dof_damping": rows(0.0, 0.1, 0.0),
        "dof_armature": rows(0.0, 0.2, 0.0),
        "opt.gravity": rows(0.0, 0.0, -G),
        "geom_solref": rows([0.02, 1.0], [-100.0, -10.0]),
        "geom_friction": rows([0.4, 0.1], [1.0, 0.1]),
    }


def name_case(value: object) -> str | None:
    """Cases are called by their effect."""
    return value if isinstance(value, str) else ""


def test_every_law_has_a_value_by_hand() -> None:
    """No law of the catalogue, and no generic one, is without one; those of constants differ by what they write."""
    tested = {find_effect(EFFECTS, case[0]).apply for case in (*STEP_LAWS, *CONSTANT_LAWS)}
    evolving = {effect.apply for effect in EFFECTS if effect.states}
    assert tested == {effect.apply for effect in EFFECTS} - evolving


LUGRE = [effect.id for effect in EFFECTS if effect.stage is Stage.SLIP]


@pytest.mark.parametrize("effect_id", LUGRE)
@pytest.mark.parametrize("case", BRISTLES)
def test_bristles(effect_id: str, case: str) -> None:
    """Bristles bend by the way of a step, hold by their stiffness and damping, and slip where friction ends."""
    motion, levels, before, damped, after = BRISTLES[case]
    found, bent = find_effect(EFFECTS, effect_id).apply(motion, *levels, before, 1e-3, 0.01)
    assert bent == pytest.approx(after, rel=ROUNDING)
    held = after / 0.01
    force = -np.clip(held + SIGMA * damped / 1e-3, min(held, -levels[1]), max(held, levels[0]))
    assert found == pytest.approx(force, rel=ROUNDING)


def test_bristles_stiffer_than_a_step_shows() -> None:
    """They count as those that swing in 12 steps: at 0.5 kg and 1 ms 8 µm/N."""
    apply = find_effect(EFFECTS, "rail_x.lugre").apply
    for compliance in (0.0, 1e-9, 8e-6):
        force, bent = apply(AT_REST, 0.4, 0.4, 1e-6, 1e-3, compliance)
        assert (force, bent) == pytest.approx((-1e-6 / 8e-6, 1e-6), rel=ROUNDING)


def test_elastic_mode() -> None:
    """A joint 0.2 m ahead of its part and 0.3 m/s faster pulls it along, and feels what that takes."""
    omega = 2.0 * np.pi * 5.0
    pull = omega**2 * 0.2 + 2.0 * 0.1 * omega * 0.3  # m/s²
    found = find_effect(EFFECTS, "rail_x.elastic").apply(FORWARD, 0.1, -0.2, 1e-3, 0.1, 5.0, 0.1)
    faster = -0.2 + 1e-3 * pull
    assert found == pytest.approx((-0.1 * 0.5 * pull, 0.1 + 1e-3 * faster, faster), rel=ROUNDING)


def test_servos() -> None:
    """By hand: kp (u - q) - kv v weaker, softer and freer, kv (u - v) weaker; what feeds nothing back is no servo."""
    gain, bias = np.zeros((2, 2, 10)), np.zeros((2, 2, 10))
    gain[:, 0, 0], bias[:, 0, :3] = 6.0, (0.1, -6.0, -0.4)
    gain[:, 1, 0], bias[:, 1, :3] = 5.0, (0.0, 0.0, -5.0)
    table = {"actuator_gainprm": gain, "actuator_biasprm": bias}
    laws = {site: list_loop_effects(gain[0, site, 0], *bias[0, site, 1:3]) for site in (0, 1)}
    assert [effect.id for effect in laws[0]] == ["strength", "stiffness", "damping"]
    assert [effect.id for effect in laws[1]] == ["damping"]
    assert list_loop_effects(20.0, 0.0, 0.0) == list_loop_effects(2.0, -3.0, 0.0) == (SAG,)
    for site, effects in laws.items():
        for effect in effects:
            effect.apply(table, Site(actuator=site), **{effect.id: np.array([0.5, 1.0])})
    np.testing.assert_array_equal(gain[:, :, 0], [[1.5, 2.5], [6.0, 5.0]])
    np.testing.assert_array_equal(bias[:, 0, :3], [[0.1, -1.5, -0.1], [0.1, -6.0, -0.4]])
    np.testing.assert_array_equal(bias[:, 1, :3], [[0.0, 0.0, -2.5], [0.0, 0.0, -5.0]])
    (limit,) = set(list_loop_effects(6.0, -6.0, 0.0, limited=True)) - set(list_loop_effects(6.0, -6.0, 0.0))
    ranges = np.array(2 * [[[-2.0, 3.0], [-1.0, 1.0]]])
    limit.apply({"actuator_forcerange": ranges}, Site(actuator=0), limit=np.array([0.5, 1.0]))
    np.testing.assert_array_equal(ranges, [[[-1.0, 1.5], [-1.0, 1.0]], [[-2.0, 3.0], [-1.0, 1.0]]])


def test_what_is_left_of_a_control() -> None:
    """Half of 0.8 after 20 s of 2.5 %/s; of that all but 0.1 off what is idle; nothing within; later than all, none."""
    constants = np.rec.fromarrays([[[0.1]], [[0.025]]], names=["actuator.dead_band", "actuator.sag"])[0]
    assert weaken_control(constants, 0, 0.8, 0.0, 20.0) == pytest.approx(0.3)
    assert weaken_control(constants, 0, 0.8, 0.6, 20.0) == pytest.approx(0.5)
    assert weaken_control(constants, 0, 0.8, 0.35, 20.0) == pytest.approx(0.35)
    assert weaken_control(constants, 0, 0.8, 0.0, 50.0) == 0.0


@pytest.mark.parametrize(("effect_id", "given", "parameters", "expected"), STEP_LAWS, ids=name_case)
def test_laws_of_every_step(effect_id: str, given: tuple, parameters: tuple[float, ...], expected: Any) -> None:  # noqa: ANN401
    """Friction, force or thrust is as the law says."""
    found = find_effect(EFFECTS, effect_id).apply(*given, *parameters)
    assert found == pytest.approx(expected, rel=ROUNDING, abs=ROUNDING)


@pytest.mark.parametrize(("effect_id", "parameters", "expected"), CONSTANT_LAWS, ids=name_case)
def test_constants(effect_id: str, parameters: dict[str, tuple[float, float]], expected: dict[str, list]) -> None:
    """An effect writes what the law says, in every simulation its own, and leaves all other constants alone."""
    effect, table = find_effect(EFFECTS, effect_id), nominal_constants()
    effect.apply(table, SITE, **{name: np.array(values) for name, values in parameters.items()})
    assert tuple(expected) == effect.writes
    for name, value in (nominal_constants() | expected).items():
        np.testing.assert_allclose(table[name], value, rtol=ROUNDING, atol=ROUNDING, err_msg=name)


@pytest.mark.parametrize("effect_id", [law[0] for law in CONSTANT_LAWS])
def test_constants_stay_at_off(effect_id: str) -> None:
    """At its off value an effect leaves every bit of the constants; a limit comes down to one that nothing reaches."""
    effect, table = find_effect(EFFECTS, effect_id), nominal_constants()
    nominal = nominal_constants()
    off = {p.name: np.full(2, p.off) for p in effect.parameters}
    actuators = slice(None) if effect.target != "motor" else SITE.actuator
    if effect_id.endswith(("rate_limit", "saturation")):
        (limit,) = effect.parameters
        assert limit.off >= 1000.0  # servos turn at some 10 rad/s, and controls are of the order of one
        nominal[effect.writes[0]][:, actuators] = limit.off
    effect.apply(table, SITE, **off)
    for name, value in nominal.items():
        np.testing.assert_array_equal(table[name], value, err_msg=name)


def test_dry_frictions_add_and_asymmetry_scales_them() -> None:
    """Sliding friction and the rest add; a friction that depends on the direction scales the sum."""
    level = 0.0
    values = {"rail_x.coulomb": (0.2,), "rail_x.stiction": (0.3, 0.05), "rail_x.jamming": (0.02,)}
    values |= {"rail_x.tight_spot": (0.5, 0.3, 0.1), "rail_x.asymmetry": (0.1,)}
    motion = AT_REST._replace(load=1.0, lever=10.0)
    for effect in CATALOGUE:
        if effect.id in values:
            level = effect.apply(level, motion, *values[effect.id])
    # (0.2 + 0.3 + 0.02 · 10 + 0.5) · (1 + 0.1) = 1.2 · 1.1
    assert level == pytest.approx(1.32, rel=ROUNDING)
