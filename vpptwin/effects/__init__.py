"""The catalogue of physical effects: what the world may do that a simulation leaves out.

One list serves the model, the identification's unknowns, the randomization's axes, the suspects of a diagnosis and
the makers of hidden test data. This package imports nothing else of vpptwin.
"""

from vpptwin.effects.base import Body, Constants, Craft, Effect, Motion, Rotor, Site, Stage, State
from vpptwin.effects.body import FreeBody, effects_for_body
from vpptwin.effects.catalogue import (
    CATALOGUE,
    GENERIC_ACTUATOR,
    GENERIC_JOINT,
    effects_for_ball,
    effects_for_rig,
    find_effect,
    generic_place,
)
from vpptwin.effects.link import Link
from vpptwin.effects.parameter import SIGMAS_90, UNLIMITED, Parameter, Prior

__all__ = [
    "CATALOGUE", "GENERIC_ACTUATOR", "GENERIC_JOINT", "SIGMAS_90", "UNLIMITED", "Body", "Constants", "Craft", "Effect",
    "FreeBody", "Link", "Motion", "Parameter", "Prior", "Rotor", "Site", "Stage", "State", "effects_for_ball",
    "effects_for_body", "effects_for_rig", "find_effect", "generic_place",
]  # fmt: skip
