"""An independent simulation of the rig: it flies, and records logs with effects that the twin does not know of.

Nothing of vpptwin is imported and no MuJoCo: other equations, another integrator (0.25 ms midpoint), another friction
law (true sticking), another log writer.
"""

from .effects import ALIEN, CORE, EFFECTS, EXTENDED, draw_effect
from .flight import fly, fly_many
from .manoeuvres import MANOEUVRES
from .recording import Recording, write_mcap

__all__ = [
    "ALIEN",
    "CORE",
    "EFFECTS",
    "EXTENDED",
    "MANOEUVRES",
    "Recording",
    "draw_effect",
    "fly",
    "fly_many",
    "write_mcap",
]
