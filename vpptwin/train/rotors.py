"""The twin of a configuration, and rotors as strong as its task wants them."""

from __future__ import annotations

from pathlib import Path

from vpptwin.actuators.blade import strengthen_rotor
from vpptwin.train.config import TrainConfig
from vpptwin.trust import check_trusted
from vpptwin.twin.spec import TwinSpec, load_twin
from vpptwin.vehicle import Vehicle


def load_trained_twin(config: TrainConfig, twin: str | Path | None = None) -> TwinSpec:
    """The twin of a configuration, or another, with its effects and controller.

    A configuration may come from somebody's checkpoint, so the code that it names runs only if it is trusted.

    Raises:
        InputError: if it is not, or the twin cannot be made.
    """
    check_trusted(config.effects, "the configuration of training")
    spec = load_twin(twin or config.twin, config.effects)
    return spec if config.controller is None else spec.with_controller(config.controller)


def weigh(vehicle: Vehicle) -> float:
    """What the rotors carry, craft and slider [N]."""
    return (vehicle.airframe.mass + vehicle.rig.slider_mass) * vehicle.gravity


def strengthen(spec: TwinSpec, thrust_to_weight: float | None, commanded: float | None = None) -> TwinSpec:
    """A twin whose rotors, and what is believed of them, give this thrust-to-weight ratio; itself for None.

    As much is commanded at most, unless `commanded`, over the weight too, says otherwise.
    """
    if thrust_to_weight is None:
        return spec
    vehicle = spec.vehicle
    weight = weigh(vehicle)
    rotor = strengthen_rotor(vehicle.rotor, thrust_to_weight * weight / vehicle.control.thrust_max)
    control = vehicle.control.model_copy(update={"thrust_max": (commanded or thrust_to_weight) * weight})
    return spec.with_robot(rotorcraft=vehicle.model_copy(update={"rotor": rotor, "control": control}))
