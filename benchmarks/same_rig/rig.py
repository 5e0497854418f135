"""What all simulators have in common: rail_rig.xml with dry friction on the rails, states to start from, actions."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from vpptwin.robots.planar_drone.craft import CRAFT_JOINTS
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.twin.robot.losses import take_out_losses

RIG_FILE = Path(__file__).resolve().parents[2] / "models" / "rail_rig.xml"
FRICTION = 0.3
"""Dry friction on each rail [N]."""
SUBSTEPS = 10
"""Physics steps of 1 ms in one control step."""
EPISODE = 500
"""Control steps until an episode is truncated: 5 s."""
START_POSE = (0.0, 1.0, 0.0625)
"""x [m], z [m], θ [rad]; exact in float32, which TorchRL and MJX keep states in."""
START_VELOCITY = (0.0625, 0.5, -0.5)
"""m/s, m/s, rad/s; likewise. Slow along x, so that the carriage comes to rest and friction has to hold it."""
TRAVEL = ((-1.4375, 1.4375), (0.25, 2.4375))
"""Ends of x and z beyond which an episode is over [m]; just before the stops."""


def write_rig(path: Path, friction: float = FRICTION, mass_factor: float = 1.0) -> Path:
    """Write the rig with its friction [N] in MuJoCo's constraint solver and the craft's mass times a factor."""
    spec = mujoco.MjSpec.from_file(str(RIG_FILE))
    take_out_losses(spec, CRAFT_JOINTS)
    for name in ("rail_x", "rail_z"):
        spec.joint(name).frictionloss = friction
    spec.body("craft").mass *= mass_factor
    spec.compile()
    path.write_text(spec.to_xml())
    return path


def draw_actions(vehicle: Vehicle, seed: int, *shape: int) -> np.ndarray:
    """Random actions (thrust, rate) around hover in [-1, 1], as an exploring policy would send them.

    Multiples of 1/256, so that float32 and float64 hold the same numbers.

    Args:
        vehicle: for the thrust that hovers.
        seed: of the random numbers.
        *shape: leading axes.

    Returns:
        (*shape, 2), float32.
    """
    carried = vehicle.airframe.mass + vehicle.rig.slider_mass
    hover = carried * vehicle.gravity / vehicle.control.thrust_max
    noise = 0.1 * np.random.default_rng(seed).standard_normal((*shape, 2))
    return (np.round(np.clip(noise + np.array([hover, 0.0]), -1.0, 1.0) * 256.0) / 256.0).astype(np.float32)
