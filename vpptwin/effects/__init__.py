"""The laws of physical effects: what the world may do that a simulation leaves out.

One list of them serves the model, the identification's unknowns, the randomization's axes, the candidates of a
diagnosis and the makers of hidden test data. This package imports nothing else of vpptwin; the drone's list, and what
its laws are given, are looked up where they lie when somebody asks for them here.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from vpptwin.effects.base import Body, Effect, Motion, Stage, State
from vpptwin.effects.body import FreeBody, effects_for_body
from vpptwin.effects.catalogue import (
    GENERIC_ACTUATOR,
    GENERIC_JOINT,
    effects_for_ball,
    effects_for_rig,
    find_effect,
    generic_place,
)
from vpptwin.effects.constants import Constants, Site
from vpptwin.effects.link import Link
from vpptwin.effects.parameter import SIGMAS_90, UNLIMITED, Parameter, Prior

if TYPE_CHECKING:
    from vpptwin.robots.planar_drone.effects.catalogue import CATALOGUE
    from vpptwin.robots.planar_drone.effects.laws import Craft, Rotor

__all__ = [
    "CATALOGUE", "GENERIC_ACTUATOR", "GENERIC_JOINT", "SIGMAS_90", "UNLIMITED", "Body", "Constants", "Craft", "Effect",
    "FreeBody", "Link", "Motion", "Parameter", "Prior", "Rotor", "Site", "Stage", "State", "effects_for_ball",
    "effects_for_body", "effects_for_rig", "find_effect", "generic_place",
]  # fmt: skip
ELSEWHERE = {"CATALOGUE": "catalogue", "Craft": "laws", "Rotor": "laws"}


def __getattr__(name: str) -> Any:  # noqa: ANN401
    """What lies in the drone's room."""
    if name not in ELSEWHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"vpptwin.robots.planar_drone.effects.{ELSEWHERE[name]}"), name)
