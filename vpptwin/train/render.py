"""Looking at the environment: pictures of a simulation, and the factories that TorchRL's `rlrender` asks for.

rlrender --ckpt runs/flip/best.pt --env vpptwin.train.render:make_env --policy vpptwin.train.render:make_policy
    --seed 3 --fps 50 --out flip.gif
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np

from vpptwin.actuators.blade import compute_thrust
from vpptwin.train import env as environment
from vpptwin.train.checkpoint import build_policy
from vpptwin.train.config import to_config
from vpptwin.train.networks import Policy
from vpptwin.viz.camera import View
from vpptwin.viz.frames import Painter
from vpptwin.viz.motion import Rotors
from vpptwin.viz.scene import fit_craft

VIEW = View(np.array([0.1, 0.0, 1.25]), 1.3)
"""The whole rig: floor, wall, rail and guide."""


class Watcher:
    """Draws the first simulation of an environment.

    Args:
        env: whose rig it is.
        size: of a frame, width and height in pixels.
    """

    def __init__(self, env: environment.VppEnv, size: tuple[int, int] = (640, 400)) -> None:
        model = copy.copy(env.twin.spec.model)
        fit_craft(model, env.twin.vehicle)
        self._painter = Painter(model, env.twin.vehicle, VIEW, size)

    def draw(self, env: environment.VppEnv) -> np.ndarray:
        """A frame, (height, width, 3) uint8, with target, rotors, thrust and time."""
        state, actuators, elapsed = env.state, env.state.actuators, float(env.episodes.elapsed[0])
        speed, pitch = actuators["rotor_speed"][0], actuators["blade"][0]
        thrust = compute_thrust(env.twin.vehicle.rotor, speed, pitch)
        return self._painter.draw(
            state.qpos[0],
            spin=Rotors(speed * elapsed * np.ones(2), pitch, thrust),
            target=env.episodes.target[0],
            text=[f"{elapsed:5.2f} s"],
        )


def make_env(checkpoint: dict[str, Any], seed: int | None = None) -> environment.VppEnv:
    """One simulation of a checkpoint's task, at full difficulty, with its noise and randomization.

    Args:
        checkpoint: content of a checkpoint file, as rlrender reads it.
        seed: of everything random; None for that of training.
    """
    trained = to_config(checkpoint["config"])
    config = replace(trained, num_envs=1, desynchronize=False, seed=trained.seed if seed is None else seed)
    return environment.make_env(config)


def make_policy(checkpoint: dict[str, Any], ckpt_path: str) -> Policy:
    """A checkpoint's policy: from observations (N, k) to its most likely actions, (N, 2) in [-1, 1]."""
    return build_policy(checkpoint, ckpt_path)[0]
