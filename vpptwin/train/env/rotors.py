"""The twin of a configuration, and rotors as strong as its task wants them."""

from __future__ import annotations

from pathlib import Path

from vpptwin.robots.planar_drone import vehicle
from vpptwin.system.trust import check_trusted
from vpptwin.train.config import TrainConfig
from vpptwin.twin.spec import TwinSpec, load_twin


def load_trained_twin(config: TrainConfig, twin: str | Path | None = None) -> TwinSpec:
    """The twin of a configuration, or another, with its effects and controller.

    A configuration may come from somebody's checkpoint, so the code that it names runs only if it is trusted.

    Raises:
        InputError: if it is not, or the twin cannot be made.
    """
    check_trusted(config.effects, "the configuration of training")
    spec = load_twin(twin or config.twin, config.effects)
    return spec if config.controller is None else spec.with_controller(config.controller)


def strengthen(spec: TwinSpec, thrust_to_weight: float | None, commanded: float | None = None) -> TwinSpec:
    """A twin with rotors as `vpptwin.robots.planar_drone.vehicle.strengthen` makes them; itself for None."""
    if thrust_to_weight is None:
        return spec
    return spec.with_robot(rotorcraft=vehicle.strengthen(spec.vehicle, thrust_to_weight, commanded))
