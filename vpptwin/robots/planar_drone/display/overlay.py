"""What the drone adds to a show of its bodies: rotors and thrust arrows on the craft, and its ghost at the setpoint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from vpptwin.actuators.blade import max_thrust
from vpptwin.logs.flight import Flight
from vpptwin.robots.planar_drone.craft import CRAFT_JOINTS, PlanarDrone
from vpptwin.robots.planar_drone.display import rotors
from vpptwin.robots.planar_drone.display.rotors import RotorMotion, SetpointChanges, find_craft, hold
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.viz.plots.palette import BLADE, NEGATIVE_THRUST, POSITIVE_THRUST, TARGET, TOP_MARK
from vpptwin.viz.scene.frames import THINNEST, Painter, to_colour
from vpptwin.viz.scene.geoms import ROOT, ROUND, Paint, name_body
from vpptwin.viz.scene.show import LegendEntry, Overlay, Positions, Show

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

    from vpptwin.estimation.replay import Prediction
    from vpptwin.viz.scene.nodes import Node
    from vpptwin.viz.scene.tracks import KeyframeTrack


def read_pose(robot: PlanarDrone, flight: Flight) -> Positions:
    """The drone's `find_positions`: those of the craft."""
    flight.require("/mocap/pose")
    pose, joint = flight.streams["/mocap/pose"], robot.model.joint
    return {joint(j).qposadr[0]: (pose.time, pose[c]) for j, c in zip(CRAFT_JOINTS, ("x", "z", "theta"))}


@dataclass(frozen=True)
class CraftOverlay(Overlay):
    """Rotors and setpoint at the frames of a show."""

    vehicle: Vehicle  # numbers of the craft
    time: np.ndarray  # (T,) of the frames, from the first [s]
    log: RotorMotion | None = None  # the log's rotors; None where it has no rotor channels
    twin: RotorMotion | None = None  # the prediction's
    setpoint: SetpointChanges | None = None  # the log's; None where it has none

    @property
    def legend(self) -> tuple[LegendEntry, ...]:  # type: ignore[override]
        """What the colours mean."""
        target = (LegendEntry(TARGET, "translucent", "target"),) if self.setpoint is not None else ()
        if self.log is None:
            return target
        positive, negative = (POSITIVE_THRUST, "solid", "thrust"), (NEGATIVE_THRUST, "solid", "negative thrust")
        return (*target, LegendEntry(*positive), LegendEntry(*negative))

    @property
    def notes(self) -> tuple[str, ...]:  # type: ignore[override]
        """What is not drawn to scale."""
        if self.log is None:
            return ()
        slow = (
            f"Rotors turn {rotors.TURN_SLOWDOWN:g} times slower and pitch {rotors.PITCH_EXAGGERATION:g} times further."
        )
        return slow, "Thrust: k_T × speed × commanded pitch."

    def draw_parts(self, vis: Node, show: Show, name: str, paint: Paint | None) -> list[KeyframeTrack]:
        """Rotors, with thrust arrows where they have their own colours."""
        from vpptwin.robots.planar_drone.display import scene  # few commands draw

        craft, motion = f"{ROOT}/{name}/{name_body(show.model, find_craft(show.model))}", getattr(self, name)
        scene.draw_rotors(vis[craft], show.model, self.vehicle, paint)
        if motion is None:
            return []
        tracks = scene.track_rotors(craft, self.time, motion)
        if paint is None:
            scene.draw_arrows(vis[craft])
            tracks += scene.track_arrows(craft, self.time, motion, self.vehicle)
        return tracks

    def draw_target(self, vis: Node, show: Show) -> list[KeyframeTrack]:
        """The ghost at the setpoint."""
        from vpptwin.robots.planar_drone.display import scene

        if self.setpoint is None:
            return []
        scene.draw_ghost(vis[f"{ROOT}/target"], show.model, self.vehicle)
        return scene.track_setpoint(self.setpoint, self.time[-1])

    def paint_target(self, painter: Painter, pen: ImageDraw, time: float) -> None:
        """The craft at the setpoint, from the first one on."""
        setpoint = self.setpoint
        if setpoint is None or time < setpoint.time[0]:
            return
        model, data = painter.model, painter.data
        data.qpos[:] = model.qpos0
        for joint, values in zip(CRAFT_JOINTS, (setpoint.x, setpoint.z, setpoint.theta)):
            index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
            data.qpos[model.jnt_qposadr[index]] = hold(setpoint.time, values, np.array([time]))[0]
        mujoco.mj_kinematics(model, data)
        geoms = [g for g in painter.paints if model.geom_bodyid[g] == find_craft(model)]
        painter.draw_geoms(pen, geoms, to_colour(TARGET, 0.45))

    def paint_parts(self, painter: Painter, pen: ImageDraw, time: float) -> None:
        """Blades, mark on top and thrust arrows of the log's craft."""
        if self.log is None:
            return
        row = min(int(np.searchsorted(self.time, time)), len(self.time) - 1)
        craft = find_craft(painter.model)
        origin, turn = painter.data.xpos[craft], painter.data.xmat[craft].reshape(3, 3)

        def fill(points: np.ndarray, colour: str) -> None:
            painter.fill(pen, (origin + points @ turn.T)[:, [0, 2]], to_colour(colour))

        fill(np.stack([0.03 * np.cos(ROUND), 0.0 * ROUND, 0.018 + 0.014 * np.sin(ROUND)], -1), TOP_MARK)
        for i, sign in enumerate(rotors.TURN_SIGNS):
            hub, radius = rotors.find_rotor(painter.model, self.vehicle, i + 1)
            mast = hub + rotors.ROOT_RADIUS * np.array([[-1, 0, 0], [1, 0, 0], [1, 0, 0], [-1, 0, 0]])
            mast[:2, 2] -= hub[2]
            fill(mast, BLADE)
            for side in (1.0, -1.0):
                about = sign * self.log.angle[row, i] / rotors.TURN_SLOWDOWN
                along = side * np.array([np.cos(about), np.sin(about), 0.0])
                across = side * np.array([-np.sin(about), np.cos(about), 0.0])
                pitch = sign * rotors.PITCH_EXAGGERATION * self.log.blade_pitch[row, i]
                chord = 0.5 * rotors.CHORD * (across * np.cos(pitch) + np.array([0.0, 0.0, np.sin(pitch)]))
                thick = np.array([0.0, 0.0, 0.5 * THINNEST])
                edges = [edge + skin for edge in (chord, -chord) for skin in (thick, -thick)]
                fill(np.array([hub + r * along + edge for r in (rotors.ROOT_RADIUS, radius) for edge in edges]), BLADE)
            length = self.log.thrust[row, i] / max_thrust(self.vehicle.rotor) * rotors.ARROW_LENGTH
            if abs(length) > 0.01:
                colour = POSITIVE_THRUST if length > 0.0 else NEGATIVE_THRUST
                tip = length + np.sign(length) * rotors.HEAD_HEIGHT
                fill(
                    hub + np.array([[s * rotors.SHAFT_RADIUS, 0.0, z] for s in (-1, 1) for z in (0.0, length)]), colour
                )
                barbs = [[s * rotors.HEAD_RADIUS, 0.0, length] for s in (-1, 1)]
                fill(hub + np.array([*barbs, [0.0, 0.0, tip]]), colour)


def overlay_craft(robot: PlanarDrone, show: Show, flight: Flight, prediction: Prediction | None) -> CraftOverlay:
    """The drone's `make_overlay`; the arm that is drawn gets the vehicle's length."""
    vehicle, frames = robot.vehicle, show.frames
    rotors.fit_craft(show.model, vehicle)
    log, twin = rotors.sample_rotors(flight, vehicle, frames), None
    if prediction is not None and show.twin is not None:
        known = np.isfinite(prediction.qpos).all(axis=1)
        time, speed = prediction.time[known], prediction.rotor_speed[known]
        twin = rotors.turn_rotors(time, speed, hold(time, prediction.blade_pitch[known], frames), frames, vehicle)
        if log is not None:  # nobody models the rotors' phase: they start where the log's are when the twin first shows
            first = int(np.argmax(show.twin.shown))
            twin = replace(twin, angle=twin.angle + log.angle[first] - twin.angle[first])
    setpoint = rotors.read_setpoint(flight, float(frames[0]), float(frames[-1]))
    return CraftOverlay(vehicle, show.time, log, twin, setpoint)
