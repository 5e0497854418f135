"""Exported controllers, loaded again and flown: a `.so` or an ONNX model, refused if its test vectors fail."""

from __future__ import annotations

import ctypes
import json
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

import numpy as np

from vpptwin.deploy.c_source import PREFIX
from vpptwin.deploy.content import STATES, TOLERANCE
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.errors import InputError
from vpptwin.train.config import TrainConfig, to_config
from vpptwin.train.env.observe import INTEGRAL_DECAY
from vpptwin.train.env.rotors import strengthen
from vpptwin.train.env.tasks import Task, check_task_name
from vpptwin.train.evaluate.pilot import PolicyPilot, choose_task
from vpptwin.twin.spec import TwinSpec

EXPECTED = "a controller that `vpptwin export` wrote"
AGAIN = "export it again"


class Exported(ABC):
    """A controller that was exported.

    Attributes:
        path: its file.
        metadata: what it was made from.
        trained: how it was trained.
    """

    def __init__(self, path: Path, metadata: str) -> None:
        self.path = path
        try:
            self.metadata: dict[str, Any] = json.loads(metadata)
            self.trained: TrainConfig = to_config(self.metadata["config"])
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise InputError(f"{path}: metadata that cannot be read", EXPECTED, AGAIN) from error

    def _refuse_failures(self, wrong: int) -> None:
        if wrong:
            raise InputError(f"{self.path}: {wrong} of its test vectors fail", "a controller that is whole", AGAIN)

    @abstractmethod
    def decide(
        self, pose: np.ndarray, velocity: np.ndarray, target: np.ndarray, integral: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Action (2,) in [-1, 1] and integral (2,) m of the next step, from (3,), (3,), (3,) and (2,)."""


class OnnxController(Exported):
    """An ONNX model, run by onnxruntime.

    Raises:
        InputError: if it is none of ours, or a test vector fails.
    """

    def __init__(self, path: Path) -> None:
        import onnxruntime

        try:
            self._session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
            about = self._session.get_modelmeta().custom_metadata_map
            super().__init__(path, about["vpptwin"])
            seen, wanted = (np.array(json.loads(about[key]), np.float32) for key in ("test_inputs", "test_outputs"))
        except (KeyError, OSError, ValueError) as error:
            raise InputError(f"{path}: no controller of ours ({error})", EXPECTED, AGAIN) from error
        except InputError:
            raise
        except Exception as error:  # onnxruntime raises kinds of its own that share no base
            raise InputError(f"{path}: no ONNX model", EXPECTED, AGAIN) from error
        right = np.abs(self._retrace(seen) - wanted).max(axis=1) <= TOLERANCE
        self._refuse_failures(int(np.count_nonzero(~right)))

    def _retrace(self, observations: np.ndarray) -> np.ndarray:
        """Actions of observations: the states that would have given them go in."""
        names, count = self.trained.observation.names, len(observations)
        column = {name: observations[:, i].astype(np.float64) for i, name in enumerate(names)}
        zero = np.zeros(count)
        target_angle = angle_of(column, "target_theta", zero)
        target = np.stack([column["delta_x"], column["delta_z"], target_angle], -1)
        pose = np.stack([zero, zero, target_angle - angle_of(column, "delta_theta", zero)], -1)
        velocity = np.stack([column["velocity_x"], column["velocity_z"], column["rate"]], -1)
        grown = np.stack([column.get("integral_x", zero), column.get("integral_z", zero)], -1)
        return self._run(pose, velocity, target, (grown - target[:, :2]) / INTEGRAL_DECAY)[0]

    def _run(self, *given: np.ndarray) -> list[np.ndarray]:
        feeds = {name: np.asarray(values, np.float32) for name, values in zip(STATES, given)}
        return list(self._session.run(None, feeds))

    def decide(
        self, pose: np.ndarray, velocity: np.ndarray, target: np.ndarray, integral: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `Exported.decide`."""
        action, grown, _ = self._run(pose[None], velocity[None], target[None], integral[None])
        return action[0].astype(float), grown[0].astype(float)


class CompiledController(Exported):
    """The C source, compiled as a shared library.

    Attributes:
        library: its functions.

    Raises:
        InputError: if it is none of ours, or a test vector fails.
    """

    def __init__(self, path: Path) -> None:
        try:
            self.library = ctypes.CDLL(str(path.resolve()))
            size = ctypes.c_char.in_dll(self.library, f"{PREFIX}_metadata")
            text = ctypes.string_at(ctypes.addressof(size)).decode()
            wrong = int(self.library[f"{PREFIX}_selftest"]())
        except (OSError, ValueError, AttributeError) as error:
            raise InputError(f"{path}: no controller of ours ({error})", EXPECTED, AGAIN) from error
        super().__init__(path, text)
        self._refuse_failures(wrong)

    def decide(
        self, pose: np.ndarray, velocity: np.ndarray, target: np.ndarray, integral: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `Exported.decide`."""
        grown = np.array(integral, np.float32)
        seen = np.empty(len(self.trained.observation.names), np.float32)
        self.call("observe", *(np.asarray(v, np.float32) for v in (pose, velocity, target)), grown, seen)
        return self.act(seen).astype(float), grown.astype(float)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Action (2,) float32 of an observation (inputs,) float32."""
        action = np.empty(2, np.float32)
        self.call("act", observation, action)
        return action

    def call(self, name: str, *arrays: np.ndarray | ctypes.Structure | float) -> None:
        """Call a function with arrays of float32, read and written in place, structures and numbers."""
        given: list[object] = []
        for value in arrays:
            if isinstance(value, np.ndarray):
                given.append(np.ascontiguousarray(value).ctypes.data_as(ctypes.POINTER(ctypes.c_float)))
            else:
                given.append(ctypes.byref(value) if isinstance(value, ctypes.Structure) else ctypes.c_float(value))
        self.library[f"{PREFIX}_{name}"](*given)


def load_exported(path: Path) -> Exported:
    """An exported controller, by the kind of its file.

    Raises:
        InputError: if there is none, it is none of ours, or its test vectors fail.
    """
    if not path.is_file():
        raise InputError(f"no file {path}", "a controller, .so or .onnx", "`vpptwin export` writes one")
    if path.suffix.lower() == ".onnx":
        return OnnxController(path)
    if path.suffix == ".so":
        return CompiledController(path)
    raise InputError(f"{path}", "a controller, .so or .onnx", "compile C source to a shared library")


def angle_of(column: dict[str, np.ndarray], name: str, otherwise: np.ndarray) -> np.ndarray:
    """An angle that observations hold, in radians or as sine and cosine."""
    if f"sin_{name}" in column:
        return np.arctan2(column[f"sin_{name}"], column[f"cos_{name}"])
    return column.get(name, otherwise)


class ExportedPilot(PolicyPilot):
    """Flies one craft by an exported controller, which builds its observation itself.

    Args:
        exported: the controller.
        task: whose targets are flown, drawn from `seed`.
        vehicle: believed numbers, which scale its actions.
        duration: s; None for an episode, or the shortest flight that can be diagnosed.
        seed: of the targets.
    """

    def __init__(self, exported: Exported, task: Task, vehicle: Vehicle, duration: float | None, seed: int) -> None:
        super().__init__(None, exported.trained, task, vehicle, duration, seed)
        self.exported = exported

    def command(
        self, tick: int, pose: np.ndarray, velocity: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `PolicyPilot.command`."""
        action, integral = self.exported.decide(pose[0], velocity[0], self.target(tick)[0], memory[0])
        return np.clip(action, -1.0, 1.0)[None] * self._limit, integral[None]


def load_exported_pilot(
    path: Path, task: str | None, spec: TwinSpec, duration: float | None, seed: int
) -> tuple[ExportedPilot, TwinSpec]:
    """The pilot of an exported controller, and the twin with rotors as strong as its task wants them.

    The arguments are those of `vpptwin.train.evaluate.pilot.load_pilot`.

    Raises:
        InputError: if the controller is none of ours or not whole, there is no such task, or no such duration.
    """
    check_task_name(task)
    exported = load_exported(path)
    chosen = choose_task(exported.trained, task)
    spec = strengthen(spec, chosen.thrust_to_weight, chosen.commanded)
    return ExportedPilot(exported, chosen, spec.vehicle, duration, seed), spec
