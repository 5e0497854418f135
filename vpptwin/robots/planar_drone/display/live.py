"""`vpptwin play --live`: a policy in meshcat in real time, with a page of buttons and keys around it."""

from __future__ import annotations

import copy
import json
import time
from collections.abc import Callable, Iterable
from contextlib import closing
from queue import SimpleQueue
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from vpptwin.actuators.blade import compute_thrust
from vpptwin.robots.planar_drone.display import rotors
from vpptwin.robots.planar_drone.display.rotors import RotorMotion, find_craft, fit_craft
from vpptwin.robots.planar_drone.display.scene import BLADES, draw_arrows, draw_ghost, draw_rotors, measure_arrows
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.signals import until_interrupted
from vpptwin.twin.spec import load_twin
from vpptwin.viz.pages.browse import tell_address
from vpptwin.viz.pages.page import TEMPLATES
from vpptwin.viz.pages.serve import LOOPBACK, Answer, Server, keep_going
from vpptwin.viz.scene.camera import CameraView
from vpptwin.viz.scene.geoms import ROOT, name_body
from vpptwin.viz.scene.nodes import Node, shift, turn
from vpptwin.viz.scene.stage import aim_at, draw_bodies, draw_surroundings, make_matrix

if TYPE_CHECKING:
    from vpptwin.train.evaluate.live import LiveFlight

VIEW = CameraView(np.array([0.1, 0.0, 1.25]), 1.35)
START = np.array([0.0, 1.0, 0.0])
"""Where the craft stands until its policy flies it: x, z, θ (3,) m, m, rad."""
FRAME = 0.025
"""Time between pictures, s."""
KEYS = {
    "f": "flip", "q": "turn left", "e": "turn right", "ArrowLeft": "push left", "ArrowRight": "push right",
    "ArrowUp": "push up", "ArrowDown": "push down", "s": "spin", "j": "target left", "l": "target right",
    "i": "target up", "k": "target down",
}  # fmt: skip
"""Keys of the page, and what they ask for."""


class LiveStage:
    """The rig in meshcat, moved by hand.

    Args:
        vis: where to draw.
        model: the rig.
        vehicle: numbers of the craft.
    """

    def __init__(self, vis: Node, model: mujoco.MjModel, vehicle: Vehicle) -> None:
        self._model, self._vehicle, self._data = copy.copy(model), vehicle, mujoco.MjData(model)
        fit_craft(self._model, vehicle)
        self._node = vis[f"{ROOT}/log"]
        self._craft = self._node[name_body(model, find_craft(model))]
        self._ghost = vis[f"{ROOT}/target"]
        draw_surroundings(vis, self._model)
        draw_bodies(self._node, self._model)
        draw_rotors(self._craft, self._model, vehicle)
        draw_arrows(self._craft)
        draw_ghost(self._ghost, self._model, vehicle)
        aim_at(vis, VIEW)

    def show(self, qpos: np.ndarray, target: np.ndarray, motion: RotorMotion) -> None:
        """Move everything.

        Args:
            qpos: joint positions (nq,).
            target: x, z, θ (3,) m, m, rad.
            motion: of the rotors at this time, (1, 2).
        """
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        for body in np.flatnonzero(self._model.body_weldid != 0):
            pose = make_matrix(self._data.xpos[body], self._data.xquat[body])
            self._node[name_body(self._model, int(body))].set_transform(pose)
        half = -0.5 * target[2]  # θ turns about -y
        attitude = np.array([np.cos(half), 0.0, np.sin(half), 0.0])
        self._ghost.set_transform(make_matrix(np.array([target[0], 0.0, target[1]]), attitude))
        for i, sign in enumerate(rotors.TURN_SIGNS):
            spin = self._craft[f"rotor_{i + 1}"]["spin"]
            spin.set_transform(turn(sign * motion.angle[0, i] / rotors.TURN_SLOWDOWN, [0, 0, 1]))
            for blade, _ in BLADES:
                feather = turn(sign * rotors.PITCH_EXAGGERATION * motion.blade_pitch[0, i], [1, 0, 0])
                spin[blade]["feather"].set_transform(feather)
        for node, length in measure_arrows(motion.thrust[0], self._vehicle):
            arrow = self._craft[node]
            arrow.set_property("visible", bool(length > rotors.SHORTEST_ARROW))
            arrow["shaft"].set_transform(np.diag([1.0, 1.0, length, 1.0]))
            arrow["head"].set_transform(shift([0.0, 0.0, float(length)]))


class LivePage:
    """A page with the scene, buttons and keys; what is asked for waits in `asked`.

    Args:
        commands: what may be asked for.
        host: address of this machine to listen on.
        port: of it; 0 for any that is free.
    """

    def __init__(self, commands: Iterable[str], host: str = LOOPBACK, port: int = 0) -> None:
        self.asked: SimpleQueue[str] = SimpleQueue()
        self.state: dict[str, float] = {}
        known = set(commands)
        page = TEMPLATES.get_template("live.html").render(keys=json.dumps(KEYS), buttons=KEYS).encode()

        def ask(body: bytes) -> tuple[str, bytes]:
            what = body.decode()
            if what not in known:
                raise ValueError(what)
            self.asked.put(what)
            return "text/plain", b""

        gets: dict[str, Answer] = {
            "": lambda body: ("text/html; charset=utf-8", page),
            "state": lambda body: ("application/json", json.dumps(self.state).encode()),
        }
        self.server = Server(host, gets, {"": ask}, port)


def fly_live(begin: Callable[[], LiveFlight], host: str = LOOPBACK, port: int = 0) -> None:
    """Fly in real time until Ctrl-C, and print where to look: a page on an address of this machine.

    The craft is on it before `begin` has read the policy and the first step is compiled, which takes a while.
    """
    panel = LivePage(KEYS.values(), host, port)
    with until_interrupted(), closing(panel.server):
        spec, still = load_twin("nominal"), RotorMotion(*np.zeros((3, 1, 2)))
        LiveStage(Node(panel.server), spec.model, spec.vehicle).show(START, START, still)
        about = "shows the flight, with buttons and keys to flip and push it. Ctrl-C here to end."
        tell_address(panel.server, about)
        flight = begin()
        flight.step()
        while not panel.asked.empty():  # of a craft that did not fly yet
            panel.asked.get()
        fly_on(flight, panel)


def fly_on(flight: LiveFlight, panel: LivePage) -> None:
    """Fly what has begun, on a page that is open."""
    env, vehicle = flight.env, flight.env.twin.vehicle
    stage = LiveStage(Node(panel.server), env.twin.spec.model, vehicle)
    angle, redraw, due = np.zeros(2), 0.0, time.perf_counter()
    for _ in keep_going():
        while not panel.asked.empty():  # only this loop takes from it
            flight.commands[panel.asked.get()]()
        flight.step()
        panel.state = flight.tell()
        actuators = env.state.actuators
        speed, pitch = actuators["rotor_speed"][0], actuators["blade"][0]
        angle += speed * flight.period
        due += flight.period
        now = time.perf_counter()
        if now >= redraw:
            thrust = compute_thrust(vehicle.rotor, speed, pitch)
            motion = RotorMotion(*(part[None] for part in (angle, pitch, thrust)))
            stage.show(env.state.qpos[0], env.episodes.target[0], motion)
            # Drawing takes half of the time at most: the flight is to keep pace with the clock.
            redraw = max(now + FRAME, 2.0 * time.perf_counter() - now)
        if due > now:
            time.sleep(due - now)
        elif now - due > 0.5:
            due = now  # a machine too slow for real time does not hurry afterwards
