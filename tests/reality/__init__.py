"""An independent simulation of the rig: it flies, and records logs with effects that the twin does not know of.

Nothing of vpptwin is imported and no MuJoCo: other equations, another integrator (0.25 ms midpoint), another friction
law (true sticking), another log writer.
"""

from .effects import ALIEN, CORE, EFFECTS, EXTENDED, LOOK_ALIKES, draw_effect, draw_together, measure_strength
from .flight import fly, fly_many
from .manoeuvres import MANOEUVRES
from .policy import fly_policy
from .recording import Recording, write_mcap
from .rig import true_size

__all__ = [
    "ALIEN",
    "CORE",
    "EFFECTS",
    "EXTENDED",
    "LOOK_ALIKES",
    "MANOEUVRES",
    "Recording",
    "draw_effect",
    "draw_together",
    "fly",
    "fly_many",
    "fly_policy",
    "measure_strength",
    "true_size",
    "write_mcap",
]
