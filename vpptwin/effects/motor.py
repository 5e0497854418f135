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
    id="rotor.drag", summary="a wrong drag torque of the rotors", equation="D × gain",
    parameters=(
        Parameter(name="gain", unit="", off=1.0, low=0.3, high=3.0, prior=Prior("normal", 1.0, 0.1), size=0.1,
                  tolerance=0.01, source="assumption: k_d1 to k_d3 (vehicle.yaml) within 10 %"),
    ),
    stage=Stage.CONSTANT, apply=apply_drag, shows=("/rotor/state",), look_alikes=("battery.sag",),
    writes=("rotor.drag_gain",), follows="command",
)  # fmt: skip
SAG = Effect(
    id="battery.sag", summary="a battery whose voltage falls", equation="U × (1 - rate t)",
    parameters=(
        Parameter(name="rate", unit="1/s", off=0.0, low=0.0, high=0.05, prior=Prior("halfnormal", 0.0, 0.002),
                  size=0.004, tolerance=0.0004, source="assumption: a small pack loses some 0.2 % a second"),
    ),
    stage=Stage.CONSTANT, apply=apply_sag, shows=("/rotor/state",), look_alikes=("rotor.drag",),
    writes=("battery.sag",), follows="command",
)  # fmt: skip
