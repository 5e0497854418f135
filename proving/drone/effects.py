"""What the real rig may do that the twin does not know: ids, parameters, sizes to draw hidden tests from.

Written from what ids and parameters mean, apart from the catalogue of vpptwin.
So a slip in one is not repeated in the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .outside import ALIEN, FORMS, find_known
from .size import Size, either_sign

Effects = Mapping[str, Mapping[str, float]]

CORE: dict[str, dict[str, Size]] = {
    "rail_x.coulomb": {"force": Size("N", 0.0, ((0.10, 0.50),))},
    "rail_z.coulomb": {"force": Size("N", 0.0, ((0.10, 0.50),))},
    "rail_x.viscous": {"damping": Size("N s/m", 0.0, ((0.15, 0.80),))},
    "rail_z.viscous": {"damping": Size("N s/m", 0.0, ((0.15, 0.80),))},
    "rail_x.bias": {"force": Size("N", 0.0, either_sign(0.12, 0.50))},
    "rail_z.bias": {"force": Size("N", 0.0, either_sign(0.12, 0.50))},
    "airframe.mass": {"mass": Size("kg", 0.0, ((-0.06, -0.025), (0.025, 0.08)))},
    "airframe.inertia": {"inertia": Size("kg m^2", 0.0, either_sign(0.00048, 0.0015))},
    "air.drag": {"k_d": Size("N s^2/m^2", 0.0, ((0.05, 0.25),))},
    "rotor.thrust_gain": {"gain": Size("1", 1.0, ((0.85, 0.95), (1.05, 1.15)))},
    "rotor.asymmetry": {"fraction": Size("1", 0.0, either_sign(0.02, 0.08))},
    "servo.lag": {"time_constant": Size("s", float("nan"), ((0.028, 0.050),), idle=0.020)},
    "command.delay": {"delay": Size("s", 0.0, ((0.004, 0.015),))},
    "mocap.delay": {"delay": Size("s", 0.0, ((0.005, 0.020),))},
}

EXTENDED: dict[str, dict[str, Size]] = {
    "rail_x.stiction": {"force": Size("N", 0.0, ((0.15, 0.40),)), "velocity": Size("m/s", 0.05, ((0.03, 0.10),))},
    "rail_z.stiction": {"force": Size("N", 0.0, ((0.15, 0.40),)), "velocity": Size("m/s", 0.05, ((0.03, 0.10),))},
    "rail_x.jamming": {"mu": Size("1", 0.0, ((0.01, 0.03),))},
    "rail_z.jamming": {"mu": Size("1", 0.0, ((0.15, 0.40),))},
    "rail_x.spring": {"stiffness": Size("N/m", 0.0, ((0.3, 1.2),)), "rest": Size("m", 0.0, ((-0.3, 0.3),))},
    "rail_x.tight_spot": {
        "force": Size("N", 0.0, ((0.3, 0.8),)),
        "place": Size("m", 0.0, ((-0.5, 0.5),)),
        "width": Size("m", 0.1, ((0.08, 0.20),)),
    },
    "pitch.viscous": {"damping": Size("N m s/rad", 0.0, ((0.004, 0.012),))},
    "pitch.coulomb": {"torque": Size("N m", 0.0, ((0.01, 0.04),))},
    "pitch.bias": {"force": Size("N m", 0.0, either_sign(0.03, 0.10))},
    "rail.tilt": {"angle": Size("rad", 0.0, either_sign(0.02, 0.07))},
    "carriage.mass": {"mass": Size("kg", 0.0, ((-0.04, -0.02), (0.03, 0.12)))},
    "airframe.com": {"offset": Size("m", 0.0, either_sign(0.005, 0.02))},
    "airframe.com_height": {"offset": Size("m", 0.0, either_sign(0.006, 0.02))},
    "air.ground_effect": {"gain": Size("1", 0.0, ((0.15, 0.40),)), "height": Size("m", 0.3, ((0.2, 0.4),))},
    "rotor.negative_thrust": {"loss": Size("1", 0.0, ((0.08, 0.25),))},
    "rotor.stall": {"onset": Size("rad", 1.0, ((0.15, 0.18),), idle=0.21)},  # the largest blade pitch
    "rotor.inflow": {"damping": Size("N s/(m rad)", 0.0, ((4e-4, 1.2e-3),))},
    "rotor.in_plane": {"damping": Size("N s/(m rad)", 0.0, ((2e-4, 6e-4),))},
    "rotor.drag": {"gain": Size("1", 1.0, ((0.75, 0.90), (1.10, 1.30)))},
    "battery.sag": {"rate": Size("1/s", 0.0, ((0.003, 0.008),))},
    "servo.rate_limit": {"rate": Size("rad/s", 1e9, ((1.5, 3.0),), idle=6.0)},
    "servo.backlash": {"gap": Size("rad", 0.0, ((0.006, 0.015),))},
    "servo.trim": {
        "offset_1": Size("rad", 0.0, either_sign(0.004, 0.012)),
        "offset_2": Size("rad", 0.0, either_sign(0.004, 0.012)),
    },
    "mocap.misalignment": {"angle": Size("rad", 0.0, either_sign(0.02, 0.06))},
    "mocap.scale": {"scale": Size("1", 1.0, ((0.96, 0.985), (1.015, 1.04)))},
    "clock.drift": {"drift": Size("s/s", 0.0, either_sign(3e-4, 1e-3))},
    "gyro.bias": {"bias": Size("rad/s", 0.0, either_sign(0.04, 0.15))},
    "gyro.scale": {"scale": Size("1", 1.0, ((0.90, 0.96), (1.04, 1.10)))},
}

# What of the rig gives, and floor and wall. Hidden where it is asked for: the draws of others stay what they were.
FRAME: dict[str, dict[str, Size]] = {
    "rail_x.elastic": {
        "share": Size("1", 0.0, ((0.08, 0.25),)),
        "frequency": Size("Hz", 8.0, ((5.0, 11.0),)),
        "zeta": Size("1", 0.03, ((0.01, 0.05),)),
    },
    "contact.compliance": {
        "stiffness": Size("1", 1.0, ((0.15, 0.5), (2.0, 4.0))),
        "damping": Size("1", 1.0, ((0.3, 0.6), (1.5, 2.5))),
    },
    "contact.friction": {"gain": Size("1", 1.0, ((0.0, 0.6),))},  # with more a tip sticks, as it does with 1
}

EFFECTS: dict[str, dict[str, Size]] = (
    CORE | EXTENDED | FRAME | ALIEN | {name: form.sizes for name, form in FORMS.items()}
)

# Acts only where there is friction already, which is drawn with it.
COMPANIONS: dict[str, dict[str, Size]] = {
    "rail_x.asymmetry": {"fraction": Size("1", 0.0, either_sign(0.2, 0.5))},
    "rail_z.asymmetry": {"fraction": Size("1", 0.0, either_sign(0.2, 0.5))},
}


# Look-alikes, and dry friction of one rail: hardly told apart even alone, so never hidden together.
LOOK_ALIKES: tuple[frozenset[str], ...] = tuple(
    frozenset(group.split())
    for group in (
        "rail_x.bias rail.tilt mocap.misalignment",
        "airframe.mass rotor.thrust_gain rail_z.bias servo.trim rotor.negative_thrust",
        "rotor.asymmetry servo.trim airframe.com pitch.bias",
        "rail_x.viscous rail_z.viscous air.drag rotor.in_plane rotor.inflow",
        "command.delay servo.lag servo.rate_limit servo.backlash",
        "airframe.inertia gyro.scale rotor.thrust_gain rotor.stall",
        "mocap.delay clock.drift",
        "rail_x.spring carriage.mass rail_x.bias",
        "rail_x.coulomb rail_x.stiction rail_x.jamming rail_x.tight_spot rail_x.viscous rail_x.asymmetry",
        "rail_z.coulomb rail_z.stiction rail_z.jamming rail_z.viscous rail_z.asymmetry",
        "pitch.coulomb pitch.viscous rotor.inflow",
        "rotor.drag battery.sag",
    )
)


def draw_effect(
    rng: np.random.Generator, among: Sequence[str] = tuple(CORE), faint: float | None = None, least: float = 0.0
) -> dict[str, dict[str, float]]:
    """Draw one hidden effect with its size and sign.

    Args:
        rng: Source of randomness.
        among: Effect ids to choose from.
        faint: Least strength of an effect that is to be fainter than its spans; None for one within them.
        least: Share of the first parameter's span, from its faint end on, that is left out.

    Returns:
        {id: {parameter: value in SI}}; with asymmetry the friction that it acts on.
    """
    effect = among[int(rng.integers(len(among)))]
    if effect in COMPANIONS:
        friction = draw_effect(rng, (effect.replace("asymmetry", "coulomb"),), faint, least)
        return friction | {effect: {name: size.draw(rng) for name, size in COMPANIONS[effect].items()}}
    (strength, first), *shape = EFFECTS[effect].items()
    size = first.draw(rng, least) if faint is None else first.draw_faint(rng, faint)
    return {effect: {strength: size} | {name: other.draw(rng) for name, other in shape}}


def draw_small(
    rng: np.random.Generator, hidden: Mapping[str, object], among: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Draw none to two deviations between a rig's tolerance and what is hidden, no look-alikes of that or each other.

    With them there is no gap between jitter and effect: the strength of the first parameter is log-uniform from
    LEAST_SMALL, about where tolerances end, to 1, where hidden effects begin. Named or not, neither is wrong.
    """
    taken, small = set(find_known(hidden)), dict[str, dict[str, float]]()
    for _ in range(int(rng.choice(len(SMALL_COUNTS), p=SMALL_COUNTS))):
        barred = taken.union(*(group for group in LOOK_ALIKES if group & taken))
        free = [effect for effect in among if effect not in barred]
        effect = free[int(rng.integers(len(free)))]
        (name, first), *shape = EFFECTS[effect].items()
        size = first.draw_of_strength(rng, float(np.exp(rng.uniform(np.log(LEAST_SMALL), 0.0))))
        small[effect] = {name: size} | {name: other.draw(rng) for name, other in shape}
        taken.add(effect)
    return small


LEAST_SMALL, SMALL_COUNTS = 0.1, (0.4, 0.4, 0.2)
"""Least strength of a small deviation (mass: 0.6 %, its tolerance is 0.5 %), and how often there are none, one, two."""
DRAWS = 10_000
"""Draws of several effects after which there are taken to be no unlike ones."""


def draw_together(
    rng: np.random.Generator, count: int, among: Sequence[str], least: float = 0.0
) -> dict[str, dict[str, float]]:
    """Draw several hidden effects, no two of them look-alikes; `least` as in `draw_effect`.

    Raises:
        ValueError: if there are not so many unlike ones.
    """
    for _ in range(DRAWS):
        chosen = [among[int(i)] for i in rng.choice(len(among), count, replace=False)]
        if any(effect in COMPANIONS for effect in chosen):  # it is two by itself
            continue
        if all(len(group.intersection(chosen)) < 2 for group in LOOK_ALIKES):
            return {k: v for effect in chosen for k, v in draw_effect(rng, (effect,), least=least).items()}
    raise ValueError(f"no {count} effects that can be told apart among {', '.join(among)}: name more")


def measure_strength(effect: str, values: Mapping[str, float]) -> float:
    """Strength of a hidden effect: 1 at the faint end of what is drawn, below 1 if fainter still."""
    name, size = next(iter((EFFECTS | COMPANIONS)[effect].items()))
    return size.measure_strength(values[name])


def check_effects(effects: Effects) -> None:
    """Refuse ids and parameters that this simulation does not have."""
    known = EFFECTS | COMPANIONS
    for effect, values in effects.items():
        if effect not in known:
            raise ValueError(f"unknown effect {effect!r}; there are {', '.join(known)}")
        for name in values:
            if name not in known[effect]:
                raise ValueError(f"{effect} has no parameter {name!r}; it has {', '.join(known[effect])}")


def parse_effect(text: str) -> tuple[str, dict[str, float]]:
    """Read `rail_x.stiction:force=0.3,velocity=0.05`."""
    effect, _, assignments = text.partition(":")
    values = {}
    for assignment in filter(None, assignments.split(",")):
        name, _, value = assignment.partition("=")
        values[name] = float(value)
    check_effects({effect: values})
    return effect, values
