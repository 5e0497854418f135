"""An exported controller as a pilot, for `vpptwin fly --policy`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vpptwin.deploy.load import Exported, load_exported
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.train.env.rotors import strengthen
from vpptwin.train.env.tasks import Task, check_task_name
from vpptwin.train.evaluate.pilot import PolicyPilot, choose_task
from vpptwin.twin.spec import TwinSpec


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
