"""The twin of a configuration, and rotors as strong as its task wants them."""

from __future__ import annotations

from pathlib import Path

from vpptwin.actuators.blade import strengthen_rotor
from vpptwin.train.config import TrainConfig
from vpptwin.trust import check_trusted
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


def strengthen(spec: TwinSpec, thrust_to_weight: float | None) -> TwinSpec:
    """A twin whose rotors, and what is believed of them, give this thrust-to-weight ratio; itself for None."""
    if thrust_to_weight is None:
        return spec
    vehicle = spec.vehicle
    weight = (vehicle.airframe.mass + vehicle.rig.slider_mass) * vehicle.gravity
    factor = thrust_to_weight * weight / vehicle.control.thrust_max
    rotor = strengthen_rotor(vehicle.rotor, factor)
    control = vehicle.control.model_copy(update={"thrust_max": vehicle.control.thrust_max * factor})
    return spec.with_robot(rotorcraft=vehicle.model_copy(update={"rotor": rotor, "control": control}))
