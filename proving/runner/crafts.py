"""Sessions of a quadrotor, of an arm with position servos and of a leg (proving/quadrotor.py, servo_arm.py, leg.py).

Simulated without MuJoCo, one effect hidden or none. Whether the logs show it and tell it from its look-alikes is not
worked out there, as it is for the rigs of proving/mechanisms.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from proving import leg, quadrotor, servo_arm
from proving.logs import write_log
from proving.runner.mechanisms import MechanismPlan

GROUNDS = {"quadrotor": quadrotor, "servo": servo_arm, "leg": leg}
LOGS = {"quadrotor": (quadrotor.fly, 3, 12.0), "servo": (servo_arm.move, 2, 16.0), "leg": (leg.move, 2, 16.0)}
"""What makes a log, how many, and how long they are [s]."""


@dataclass(frozen=True)
class RecordedCraft:
    """What became of a session: twin, logs, and what the benchmark keeps."""

    twin: Path
    logs: list[Path]
    plan: MechanismPlan


@dataclass(frozen=True)
class CraftSession:
    """A session of one of `GROUNDS`: its number of a seed, and what is hidden in it."""

    seed: int
    number: int
    family: str

    @property
    def hidden(self) -> dict[str, dict[str, float]]:
        """Effect → parameter → value."""
        drawn = GROUNDS[self.family].draw_hidden(10_000 * self.seed + self.number)
        return {effect: dict(values) for effect, values in drawn.items()}

    @property
    def kind(self) -> str:
        """`single` or `none`."""
        return "single" if self.hidden else "none"

    def record(self, folder: Path) -> RecordedCraft:
        """Write the nominal twin and the logs, as `LOGS` has it."""
        folder.mkdir(parents=True, exist_ok=True)
        hidden, (make, count, duration) = self.hidden, LOGS[self.family]
        first = 100 * (10_000 * self.seed + self.number)
        logs = [write_log(make(hidden, duration, first + i), folder / f"log_{i}.mcap") for i in range(count)]
        done = f"{count} logs of {duration:.0f} s"
        plan = MechanismPlan(self.number, self.kind, self.family, hidden, true=hidden, logged=done)
        return RecordedCraft(GROUNDS[self.family].write_twin(folder), logs, plan)
