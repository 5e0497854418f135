"""An independent simulation of the rig: it flies, and records logs with effects that the twin does not know of.

Nothing of vpptwin is imported and no MuJoCo: other equations, another integrator (0.25 ms midpoint), another friction
law (true sticking), another log writer.
"""

from .effects import (
    COMPANIONS,
    CORE,
    EFFECTS,
    EXTENDED,
    LOOK_ALIKES,
    draw_effect,
    draw_small,
    draw_together,
    measure_strength,
)
from .flight import fly, fly_many
from .gusts import Wind, draw_wind
from .manoeuvres import MANOEUVRES
from .outside import ALIEN, ALIEN_KINDS, FORMS, find_also, find_known
from .policy import fly_policy
from .recording import Recording, write_mcap
from .rig import true_size

__all__ = [
    "ALIEN",
    "ALIEN_KINDS",
    "COMPANIONS",
    "CORE",
    "EFFECTS",
    "EXTENDED",
    "FORMS",
    "LOOK_ALIKES",
    "MANOEUVRES",
    "Recording",
    "Wind",
    "draw_effect",
    "draw_small",
    "draw_together",
    "draw_wind",
    "find_also",
    "find_known",
    "fly",
    "fly_many",
    "fly_policy",
    "measure_strength",
    "true_size",
    "write_mcap",
]
