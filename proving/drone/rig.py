"""The true rig of each flight of a batch: nominal numbers, session tolerances and hidden effects in one place."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import yaml

from .effects import COMPANIONS, EFFECTS, Effects, check_effects

X, Z, PITCH = 0, 1, 2  # rows of every (3, flights) array
ON_THE_RIG = ("carriage.mass", "rail_x.jamming", "rail_z.jamming")  # effects that need carriage and slider
MODELS = Path(__file__).resolve().parents[2] / "models"
if not MODELS.exists():  # installed alone, as simgap
    MODELS = Path(__file__).resolve().parent
VEHICLE = MODELS / "vehicle.yaml"


@cache
def load_nominal(strength: float = 1.0) -> dict:
    """Read models/vehicle.yaml, its rotors and the largest thrust that is commanded so many times as strong."""
    nominal = yaml.safe_load(VEHICLE.read_text())
    nominal["rotor"]["k_t"] *= strength
    nominal["control"]["thrust_max"] *= strength
    return nominal


class Hidden:
    """Hidden effects of a batch of flights."""

    def __init__(self, flights: Sequence[Effects]) -> None:
        for effects in flights:
            check_effects(effects)
        self.flights = flights

    def any(self, *ids: str) -> bool:
        """Tell whether a flight of the batch has one of these effects."""
        return any(effect in effects for effects in self.flights for effect in ids)

    def get(self, effect: str, parameter: str) -> np.ndarray:
        """Value of one parameter in every flight, its off value where the effect is absent. Shape (flights,)."""
        off = (EFFECTS | COMPANIONS)[effect][parameter].off
        return np.array([effects.get(effect, {}).get(parameter, off) for effects in self.flights], dtype=float)


def draw_tolerances(session: int) -> dict[str, float]:
    """Draw what an honest data sheet leaves open: one rig per session number.

    Returns:
        Relative errors of mass, inertia, thrust constant, servo time constant; asymmetry; dry friction N;
        amplitude N of a force that varies along the rail.
    """
    rng = np.random.default_rng([session, 77])

    def draw(spread: float) -> float:
        return float(rng.uniform(-spread, spread))

    return {
        "mass": draw(0.005),
        "inertia": draw(0.01),
        "k_t": draw(0.005),
        "asymmetry": draw(0.003),
        "time_constant": draw(0.03),
        "friction_x": float(rng.uniform(0.0, 0.01)),
        "friction_z": float(rng.uniform(0.0, 0.01)),
        "uneven": float(rng.uniform(0.0, 0.01)),
    }


def true_size(effect: str, parameter: str, value: float, session: int) -> float:
    """What a rig really has: the hidden value and, where it adds to that, the tolerance of the session's rig."""
    tolerance, nominal = draw_tolerances(session), load_nominal()
    match effect:
        case "rail_x.coulomb":
            return value + tolerance["friction_x"]
        case "rail_z.coulomb":
            return value + tolerance["friction_z"]
        case "airframe.mass" | "airframe.inertia":
            return value + nominal["airframe"][parameter] * tolerance[parameter]
        case "rotor.thrust_gain":
            return value * (1 + tolerance["k_t"])
        case "rotor.asymmetry":
            return value + tolerance["asymmetry"]
        case _:
            return value


class Rig:
    """Constants of the true rigs. Arrays end in the flight axis."""

    def __init__(
        self, flights: Sequence[Effects], sessions: Sequence[int | None], free: bool = False, strength: float = 1.0
    ) -> None:
        """Put the rigs together.

        Args:
            flights: Hidden effects of each flight.
            sessions: Session number of each flight, None for a rig without tolerances.
            free: Whether the craft flies free: no carriage, no slider, nothing to run into.
            strength: Of the rotors, 1 for those of models/vehicle.yaml.
        """
        nominal = load_nominal(strength)
        self.nominal = nominal
        self.count = len(flights)
        self.hidden = hidden = Hidden(flights)
        self.free = free
        if free and hidden.any(*ON_THE_RIG):
            raise ValueError(f"a free craft has none of {', '.join(ON_THE_RIG)}")
        drawn = [dict.fromkeys(draw_tolerances(0), 0.0) if s is None else draw_tolerances(s) for s in sessions]
        tolerance = {name: np.array([d[name] for d in drawn]) for name in drawn[0]}

        airframe, rig = nominal["airframe"], nominal["rig"]
        self.gravity = float(nominal["gravity"])
        self.half_length = float(airframe["half_length"])
        self.rail_height = float(rig["rail_height"])
        self.bearing_spacing = float(rig["bearing_spacing"])
        self.craft_mass = airframe["mass"] * (1 + tolerance["mass"]) + hidden.get("airframe.mass", "mass")
        self.com = np.stack([hidden.get("airframe.com", "offset"), hidden.get("airframe.com_height", "offset")])
        self.slider_mass = 0.0 if free else float(rig["slider_mass"])
        self.carriage_mass = 0.0 if free else rig["carriage_mass"] + hidden.get("carriage.mass", "mass")
        self.inertia = airframe["inertia"] * (1 + tolerance["inertia"]) + hidden.get("airframe.inertia", "inertia")
        self.inertia = self.inertia + self.craft_mass * (self.com**2).sum(0)
        self.update_mass()

        none = np.zeros(self.count)
        self.coulomb = np.stack(
            [
                hidden.get("rail_x.coulomb", "force") + tolerance["friction_x"],
                hidden.get("rail_z.coulomb", "force") + tolerance["friction_z"],
                hidden.get("pitch.coulomb", "torque"),
            ]
        )
        pointed = hidden.get("form.stribeck", "force")
        self.pointed = pointed > 0.0  # exp(-|v| / velocity) along x instead of the square
        along_x = np.where(
            self.pointed, hidden.get("form.stribeck", "velocity"), hidden.get("rail_x.stiction", "velocity")
        )
        self.stiction = np.stack(
            [hidden.get("rail_x.stiction", "force") + pointed, hidden.get("rail_z.stiction", "force"), none]
        )
        self.stribeck = np.stack([along_x, hidden.get("rail_z.stiction", "velocity"), none + 1.0])
        self.friction_asymmetry = np.stack(
            [hidden.get("rail_x.asymmetry", "fraction"), hidden.get("rail_z.asymmetry", "fraction"), none]
        )
        self.damping = np.stack([hidden.get(f"{j}.viscous", "damping") for j in ("rail_x", "rail_z", "pitch")])
        self.bias = np.stack([hidden.get(f"{j}.bias", "force") for j in ("rail_x", "rail_z", "pitch")])
        self.tilt_sine = np.sin(hidden.get("rail.tilt", "angle"))
        self.drag = hidden.get("air.drag", "k_d")
        self.uneven = tolerance["uneven"]

        asymmetry = hidden.get("rotor.asymmetry", "fraction") + tolerance["asymmetry"]
        k_t = nominal["rotor"]["k_t"] * (1 + tolerance["k_t"]) * hidden.get("rotor.thrust_gain", "gain")
        self.k_t = k_t * np.stack([1 + asymmetry, 1 - asymmetry])
        lag = hidden.get("servo.lag", "time_constant")
        nominal_lag = nominal["servo"]["time_constant"] * (1 + tolerance["time_constant"])
        double = hidden.get("form.lag", "time_constant")
        self.second_lag = np.where(np.isnan(double), 0.0, double / 2)  # of a servo that has two
        self.servo_lag = np.where(np.isnan(lag), np.where(np.isnan(double), nominal_lag, double / 2), lag)
        self.command_delay = hidden.get("command.delay", "delay")

    def update_mass(self) -> None:
        """Derive the moving masses from those of the parts."""
        self.mass_z = self.craft_mass + self.slider_mass
        self.mass_x = self.mass_z + self.carriage_mass
        self.moved = np.stack([self.mass_x, self.mass_z, self.inertia])
        self.inverse = 1.0 / self.moved
