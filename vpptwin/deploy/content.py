"""What an exported controller carries: network, scaling, the believed vehicle, test vectors, where it comes from."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from vpptwin import __version__
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.train.config import TrainConfig, to_plain
from vpptwin.train.env.rotors import load_trained_twin, strengthen
from vpptwin.train.learn.actor import Actor, build_actor
from vpptwin.train.stored import find_commit, find_versions, open_checkpoint
from vpptwin.twin.spec import TwinSpec

STATES = ("pose", "velocity", "target", "integral")
"""What an ONNX model takes."""
VECTORS = 64
"""Test vectors: observations and the actions that belong to them."""
TOLERANCE = 1e-5
"""Largest difference of an action that passes."""


@dataclass(frozen=True)
class Content:
    """Everything that goes into an export."""

    policy: Actor  # the network
    trained: TrainConfig  # how it was trained; its `observation` says what is observed
    vehicle: Vehicle  # believed by the controller
    adaptive: bool  # whether the twin's actuator controller adapts
    inputs: np.ndarray  # of the test vectors, (`VECTORS`, inputs) float32
    outputs: np.ndarray  # actions that belong to them, (`VECTORS`, 2) float32
    metadata: dict[str, Any]  # plain data that is stored in the export


def collect_content(checkpoint: Path | str, twin: str | None = None) -> Content:
    """What an export of a checkpoint holds.

    Args:
        checkpoint: file, folder of a run, or name of a shipped policy.
        twin: whose vehicle and controller it is for; None for that of training.

    Raises:
        InputError: if the checkpoint or the twin is not what it should be.
    """
    content = open_checkpoint(checkpoint)
    policy, trained = build_actor(content, checkpoint)
    about = {"checkpoint": Path(str(checkpoint)).name, "steps": content["steps"], "trained_at": content["commit"]}
    return make_content(policy, trained, about, twin)


def make_content(policy: Actor, trained: TrainConfig, about: dict[str, Any], twin: str | None = None) -> Content:
    """The same of a network and its configuration.

    Args:
        policy: the network.
        trained: how it was trained.
        about: where it comes from: `checkpoint`, `steps`, `trained_at`.
        twin: as of `collect_content`.

    Raises:
        InputError: if the twin is not what it should be.
    """
    spec = strengthen(load_trained_twin(trained, twin), trained.task.thrust_to_weight, trained.task.commanded)
    inputs = draw_observations(trained, VECTORS, seed=1)
    metadata = {
        "vpptwin": __version__, **about, "exported_at": find_commit(), "versions": find_versions(),
        "twin": Path(spec.name).name, "twin_sha256": hash_twin(spec), "controller": spec.controller,
        "observation": list(trained.observation.names), "config": to_plain(replace(trained, out=None, resume=None)),
    }  # fmt: skip
    return Content(policy, trained, spec.vehicle, spec.controller == "adaptive", inputs, policy(inputs), metadata)


def draw_observations(trained: TrainConfig, count: int, seed: int) -> np.ndarray:
    """Observations as a flight may give them, near the target and far from it, (count, inputs) float32."""
    rng = np.random.default_rng(seed)
    spread = {"delta_x": 0.6, "delta_z": 0.6, "velocity_x": 2.0, "velocity_z": 2.0, "rate": 6.0, "integral_x": 3.0,
              "integral_z": 3.0}  # fmt: skip
    near = rng.uniform(size=(count, 1)) < 0.5
    angles = {name: rng.uniform(-np.pi, np.pi, count) for name in ("delta_theta", "target_theta")}
    columns = []
    for name in trained.observation.names:
        kind, _, angle = name.partition("_")
        if name in spread:
            columns.append(spread[name] * rng.standard_normal(count) * np.where(near[:, 0], 0.05, 1.0))
        elif kind in ("sin", "cos"):
            columns.append(getattr(np, kind)(angles[angle]))
        else:
            columns.append(angles[name])
    return np.stack(columns, axis=-1).astype(np.float32)


def hash_twin(spec: TwinSpec) -> str:
    """SHA-256 of what a twin is: its compiled model, vehicle, effects and controller."""
    model = spec.model
    parts = [np.ascontiguousarray(getattr(model, name)).tobytes() for name in
             ("body_mass", "body_inertia", "body_pos", "body_ipos", "jnt_range", "geom_pos", "geom_size")]  # fmt: skip
    said = json.dumps([spec.vehicle.model_dump_json(), spec.effects, spec.controller], sort_keys=True, default=str)
    return sha256(b"".join([*parts, said.encode()])).hexdigest()
