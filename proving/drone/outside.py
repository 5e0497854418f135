"""What the catalogue has no law for: effects outside it, and effects of it whose law is another.

Outside it a diagnosis must say "unexplained" rather than name the nearest thing that it knows. An effect of another
form is to be named as what it is: the nearest effect of the catalogue.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .size import Size, either_sign

ALIEN: dict[str, dict[str, Size]] = {
    # Periodic along the rail; in time, along z.
    "alien.cogging": {"force": Size("N", 0.0, ((0.3, 0.8),)), "period": Size("m", 0.2, ((0.10, 0.30),))},
    "alien.hum": {"force": Size("N", 0.0, ((0.25, 0.6),)), "frequency": Size("Hz", 1.0, ((0.6, 2.5),))},
    # Sudden: s after the start of the log something falls off, or the blades of rotor 1 lose a share of their thrust.
    "alien.mass_drop": {"mass": Size("kg", 0.0, ((0.05, 0.10),)), "time": Size("s", 8.0, ((6.0, 12.0),))},
    "alien.chip": {"loss": Size("1", 0.0, ((0.06, 0.15),)), "time": Size("s", 8.0, ((6.0, 12.0),))},
    # Rate: thrust x (1 - loss |blade pitch rate|); moment = gain vx q.
    "alien.flutter": {"loss": Size("s/rad", 0.0, ((0.10, 0.25),))},
    "alien.swirl": {"gain": Size("N s^2/rad", 0.0, either_sign(0.008, 0.020))},
    # Cross-coupling: force along x = gain vx vz; force along body x = gain (F2 - F1); gyro += gain (f_z - g).
    "alien.crosswind": {"gain": Size("N s^2/m^2", 0.0, ((0.15, 0.40),))},
    "alien.side_thrust": {"gain": Size("1", 0.0, either_sign(0.15, 0.40))},
    "alien.g_sensitivity": {"gain": Size("rad s/m", 0.0, either_sign(0.010, 0.025))},
    # Memory: a Dahl element that takes `reach` m to turn round; some of the craft's mass hangs on a spring along z.
    "alien.hysteresis": {"force": Size("N", 0.0, ((0.3, 0.8),)), "reach": Size("m", 0.2, ((0.15, 0.40),))},
    "alien.slosh": {"mass": Size("kg", 0.0, ((0.08, 0.16),)), "frequency": Size("Hz", 1.2, ((0.8, 2.0),))},
}

ALIEN_KINDS: dict[str, str] = {
    "alien.cogging": "periodic",
    "alien.hum": "periodic",
    "alien.mass_drop": "sudden",
    "alien.chip": "sudden",
    "alien.flutter": "rate",
    "alien.swirl": "rate",
    "alien.crosswind": "cross-coupling",
    "alien.side_thrust": "cross-coupling",
    "alien.g_sensitivity": "cross-coupling",
    "alien.hysteresis": "memory",
    "alien.slosh": "memory",
}


@dataclass(frozen=True)
class Form:
    """An effect of the catalogue with another law."""

    nearest: str  # The effect of the catalogue that it is
    sizes: dict[str, Size]  # Its parameters
    also: tuple[str, ...] = ()  # Effects that describe part of its law too: named beside the nearest they are not wrong


FORMS: dict[str, Form] = {
    # force tanh(v / velocity): creeps, never sticks
    "form.creep": Form(
        "rail_x.coulomb",
        {"force": Size("N", 0.0, ((0.12, 0.50),)), "velocity": Size("m/s", 0.04, ((0.02, 0.06),))},
        ("rail_x.viscous", "rail_x.lugre"),
    ),
    # force exp(-|v| / velocity) at breakaway, where ours has the square
    "form.stribeck": Form(
        "rail_x.stiction",
        {"force": Size("N", 0.0, ((0.20, 0.45),)), "velocity": Size("m/s", 0.06, ((0.04, 0.10),))},
        ("rail_x.coulomb", "rail_x.lugre"),
    ),
    # damping |v|^exponent
    "form.grease": Form(
        "rail_z.viscous",
        {"damping": Size("N (s/m)^exponent", 0.0, ((0.15, 0.60),)), "exponent": Size("1", 0.7, ((0.6, 0.8),))},
        ("rail_z.coulomb", "rail_z.lugre"),
    ),
    # k |v|^exponent, where ours is the square
    "form.drag": Form(
        "air.drag",
        {"k_d": Size("N (s/m)^exponent", 0.0, ((0.06, 0.25),)), "exponent": Size("1", 1.7, ((1.5, 1.8),))},
        ("rail_x.viscous", "rail_z.viscous"),
    ),
    # two equal lags one behind the other; their sum
    "form.lag": Form(
        "servo.lag", {"time_constant": Size("s", float("nan"), ((0.028, 0.050),), idle=0.020)}, ("command.delay",)
    ),
    # stiffness d (1 + (d / stretch)^2)
    "form.spring": Form(
        "rail_x.spring",
        {
            "stiffness": Size("N/m", 0.0, ((0.25, 0.8),)),
            "rest": Size("m", 0.0, ((-0.2, 0.2),)),
            "stretch": Size("m", 1.0, ((0.8, 1.2),)),
        },
    ),
    # thrust x (1 + gain (height / (height + z))^3), where ours falls as exp(-z / height)
    "form.ground": Form(
        "air.ground_effect", {"gain": Size("1", 0.0, ((0.3, 0.8),)), "height": Size("m", 0.5, ((0.4, 0.6),))}
    ),
}


def find_known(hidden: Mapping[str, object]) -> frozenset[str]:
    """The effects of the catalogue among what is hidden, those of another form under their nearest id."""
    return frozenset(FORMS[e].nearest if e in FORMS else e for e in hidden) - frozenset(ALIEN)


def find_also(hidden: Mapping[str, object]) -> frozenset[str]:
    """Effects that describe part of another form's law: not asked for, and not wrong."""
    return frozenset(effect for e in hidden if e in FORMS for effect in FORMS[e].also)
