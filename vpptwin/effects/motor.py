"""Effects on what drives the rotors: the drag torque against their motors, and the battery behind these."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Constants, Effect, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior


def apply_drag(constants: Constants, site: Site, /, gain: np.ndarray) -> None:
    """The rotors' drag torque is off by a factor (paper Eq. 5)."""
    constants["rotor.drag_gain"][:] *= gain


def apply_sag(constants: Constants, site: Site, /, rate: np.ndarray) -> None:
    """The supply voltage falls linearly with time [1/s]."""
    constants["battery.sag"][:] += rate


DRAG = Effect(
    id="rotor.drag",
    summary="a wrong drag torque of the rotors",
    equation="D × gain",
    parameters=(Parameter("gain", "", 1.0, 0.3, 3.0, Prior("normal", 1.0, 0.1), 0.1, 0.01),),
    stage=Stage.CONSTANT,
    apply=apply_drag,
    shows=("/rotor/state",),
    look_alikes=("battery.sag",),
    writes=("rotor.drag_gain",),
    follows="command",
)
SAG = Effect(
    id="battery.sag",
    summary="a battery whose voltage falls",
    equation="U × (1 - rate t)",
    parameters=(Parameter("rate", "1/s", 0.0, 0.0, 0.05, Prior("halfnormal", 0.0, 0.002), 0.004, 0.0004),),
    stage=Stage.CONSTANT,
    apply=apply_sag,
    shows=("/rotor/state",),
    look_alikes=("rotor.drag",),
    writes=("battery.sag",),
    follows="command",
)
