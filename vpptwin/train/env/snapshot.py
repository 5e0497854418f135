"""Saving an environment and putting it back, so that a resumed run continues as if never interrupted."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import singledispatch
from typing import Any

import numpy as np
import torch

from vpptwin.system.errors import InputError
from vpptwin.train.env.episodes import Episodes
from vpptwin.train.env.starts import FailedStarts
from vpptwin.train.env.vpp_env import VppEnv
from vpptwin.twin import TwinState
from vpptwin.twin.stepping.past import SensorState


@singledispatch
def take_snapshot(env: VppEnv) -> dict[str, Any]:
    """Everything that evolves in an environment, as tensors and plain data."""
    twin = env.twin
    drawn = {id_: {p.name: twin.parameter(id_, p.name) for p in twin.effects[id_].parameters} for id_ in env.randomized}
    return {
        "state": to_tensors(env.state.arrays()),
        "sensors": to_tensors(env.sensors.arrays()),
        "episodes": to_tensors(vars(env.episodes)),
        "failed_starts": to_tensors(vars(env.failed_starts)),
        "parameters": {effect: to_tensors(values) for effect, values in drawn.items()},
        "random": json.dumps(env.rng.bit_generator.state),
        "onboard": None if env.onboard is None else to_tensors(env.onboard.filter.save()),
        "faults": env.faults, "flown": env.flown,
    }  # fmt: skip


@singledispatch
def restore_snapshot(env: VppEnv, snapshot: Mapping[str, Any]) -> None:
    """Put an environment where a snapshot was taken; its next full reset hands out the observation of that moment.

    Raises:
        InputError: if a version took it that kept less of a simulation.
    """
    missing = env.state.arrays().keys() - snapshot.get("state", {}).keys()
    missing |= vars(env.episodes).keys() - snapshot.get("episodes", {}).keys()
    if missing:
        found = f"a checkpoint whose simulations lack {', '.join(sorted(missing))}"
        raise InputError(found, "one of this version", "train on with init_from=RUN, which takes the policy alone")
    for effect, values in snapshot["parameters"].items():
        for name, value in values.items():
            env.twin.set_parameter(effect, name, value.numpy())
    env.state = TwinState.from_arrays(to_arrays(snapshot["state"]))
    env.sensors = SensorState.from_arrays(to_arrays(snapshot["sensors"]))
    env.episodes = Episodes(**to_arrays(snapshot["episodes"]))
    env.failed_starts = FailedStarts(**to_arrays(snapshot["failed_starts"]))
    if env.onboard is not None:
        env.onboard.filter.restore(to_arrays(snapshot["onboard"]))
    env.rng.bit_generator.state = json.loads(snapshot["random"])
    env.faults, env.flown, env.restored = snapshot["faults"], snapshot["flown"], True


def to_tensors(arrays: Mapping[str, Any]) -> dict[str, torch.Tensor]:
    """Copies of the arrays among the values, as tensors."""
    return {name: torch.tensor(value) for name, value in arrays.items() if isinstance(value, np.ndarray)}


def to_arrays(tensors: Mapping[str, torch.Tensor]) -> dict[str, np.ndarray]:
    """Copies as arrays."""
    return {name: value.numpy().copy() for name, value in tensors.items()}
