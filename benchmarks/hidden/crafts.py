"""Sessions of a quadrotor and of an arm with position servos (tests/quadrotor.py, tests/servo_arm.py).

Simulated without MuJoCo, one effect hidden or none. Whether the logs show it and tell it from its look-alikes is not
worked out there, as it is for the rigs of tests/mechanisms.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hidden.mechanisms import MechanismPlan
from tests import quadrotor, servo_arm
from vpptwin.logs.write import write_flight

GROUNDS = {"quadrotor": quadrotor, "servo": servo_arm}


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
        """Write the nominal twin and the logs: three flights of 12 s, two motions of 16 s."""
        folder.mkdir(parents=True, exist_ok=True)
        ground, hidden = GROUNDS[self.family], self.hidden
        first = 100 * (10_000 * self.seed + self.number)
        logs = []
        for i in range(3 if ground is quadrotor else 2):
            path = folder / f"log_{i}.mcap"
            if ground is quadrotor:
                logs.append(quadrotor.write_log(quadrotor.fly(hidden, 12.0, first + i), path))
            else:
                write_flight(path, {}, servo_arm.move(hidden, 16.0, first + i).joints)
                logs.append(path)
        done = "flights of 12 s" if ground is quadrotor else "motions of 16 s, 50 Hz"
        plan = MechanismPlan(self.number, self.kind, self.family, hidden, true=hidden, logged=done)
        return RecordedCraft(ground.write_twin(folder), logs, plan)


def draw_quadrotor(seed: int, number: int) -> CraftSession:
    """Session of a quadrotor."""
    return CraftSession(seed, number, "quadrotor")


def draw_servo(seed: int, number: int) -> CraftSession:
    """Session of an arm with position servos."""
    return CraftSession(seed, number, "servo")
