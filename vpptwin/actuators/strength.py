"""How strong the rotors of a vehicle are: its numbers alone, so that reading a twin loads no compiler."""

from __future__ import annotations

from vpptwin.robots.planar_drone.vehicle import Rotor, Vehicle


def strengthen_rotor(rotor: Rotor, factor: float) -> Rotor:
    """The rotor with so many times the thrust at every pitch."""
    wider = rotor.inflow * factor**0.5
    changed = {"k_t": rotor.k_t * factor, "k_t2": rotor.k_t2 * factor, "k_t3": rotor.k_t3 * factor, "inflow": wider}
    return rotor.model_copy(update=changed)


def weigh(vehicle: Vehicle) -> float:
    """What the rotors carry, craft and slider [N]."""
    return (vehicle.airframe.mass + vehicle.rig.slider_mass) * vehicle.gravity


def strengthen(vehicle: Vehicle, thrust_to_weight: float, commanded: float | None = None) -> Vehicle:
    """A vehicle whose rotors, and what is believed of them, give this thrust-to-weight ratio.

    As much is commanded at most, unless `commanded`, over the weight too, says otherwise.
    """
    weight = weigh(vehicle)
    rotor = strengthen_rotor(vehicle.rotor, thrust_to_weight * weight / vehicle.control.thrust_max)
    control = vehicle.control.model_copy(update={"thrust_max": (commanded or thrust_to_weight) * weight})
    return vehicle.model_copy(update={"rotor": rotor, "control": control})
