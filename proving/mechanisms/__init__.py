"""A second proving ground: rigs that are not ours, simulated without MuJoCo, with something hidden in them.

Six families (carriage, strongly damped cart, free pendulum, cart-pole, double pendulum, six-joint arm), every rig, its
sensors, its motion and what is hidden in it drawn from a seed. Own equations of motion or Pinocchio's, own friction,
own drives; nothing of vpptwin.
"""

from .families import FAMILIES
from .measure import APART, SEEN, Visibility
from .recording import Recorded, Truth
from .session import DECK, Session, draw_session

__all__ = ["APART", "DECK", "FAMILIES", "SEEN", "Recorded", "Session", "Truth", "Visibility", "draw_session"]
