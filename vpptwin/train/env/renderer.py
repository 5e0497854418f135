"""Pictures of a simulation while it flies, for `VppEnv.render`."""

from __future__ import annotations

import copy

import numpy as np

from vpptwin.actuators.blade import compute_thrust
from vpptwin.robots.planar_drone.display.overlay import CraftOverlay
from vpptwin.robots.planar_drone.display.rotors import RotorMotion, SetpointChanges, fit_craft
from vpptwin.twin import Twin, TwinState
from vpptwin.viz.scene.camera import CameraView
from vpptwin.viz.scene.frames import Painter

VIEW = CameraView(np.array([0.1, 0.0, 1.25]), 1.3)
"""The whole rig: floor, wall, rail and guide."""


class Renderer:
    """Draws the first of many simulations."""

    def __init__(self, twin: Twin) -> None:
        model, self._vehicle = copy.copy(twin.spec.model), twin.vehicle
        fit_craft(model, self._vehicle)
        self._painter = Painter(model, VIEW)

    def draw(self, state: TwinState, target: np.ndarray, elapsed: float) -> np.ndarray:
        """A frame, (height, width, 3) uint8, with target (3,) [m, m, rad], rotors, thrust and time [s]."""
        speed, pitch = state.actuators["rotor_speed"][0], state.actuators["blade"][0]
        thrust = compute_thrust(self._vehicle.rotor, speed, pitch)
        rotors = RotorMotion((speed * elapsed * np.ones(2))[None], pitch[None], thrust[None])
        setpoint = SetpointChanges(np.zeros(1), *target[:, None])
        overlay = CraftOverlay(self._vehicle, np.zeros(1), rotors, setpoint=setpoint)
        return self._painter.draw(state.qpos[0], overlay=overlay, text=[f"{elapsed:5.2f} s"])
