"""Sessions of other rigs (proving/mechanisms) as the benchmark counts the drone's: what was hidden, how visible."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from proving.mechanisms import SEEN, Recorded, Session

QUIET = 0.25
"""Chi square that jitter and small effects may add where a verdict is to be silent."""
Effects = dict[str, dict[str, float]]


@dataclass(frozen=True)
class MechanismPlan:
    """One recorded session of another rig. Fields and properties that `Plan` has too mean the same.

    Attributes:
        number: its place in the sequence of its seed.
        kind: `none`, `single`, `two` or `alien`.
        family: of the rig.
        hidden: effect → parameter → value; `outside:NAME` where the catalogue lacks it.
        small: likewise, deviations that nobody asks for.
        true: like `hidden`, what the build's jitter adds included.
        joints: effect → its joint.
        by_sensor: effects that are errors of the logged torque.
        seen, apart: effect → sigma from nothing, from the nearest look-alike.
        shift: effect → rms change of free predictions, in units of the encoders' noise.
        nearest: effect → that look-alike.
        alike: what these logs cannot tell from what is hidden.
        detectable: whether they show all that is hidden.
        separable: whether they tell it from all look-alikes too.
        unasked: what jitter and small effects make of free predictions, in sigma of what noise and disturbances make.
        disturbance: kind, rms as a share of typical force, time [s] of the force that nobody modelled.
        logged: what was done in each log, samples a second, which velocities.
    """

    number: int
    kind: str
    family: str = ""
    hidden: Effects = field(default_factory=dict)
    small: Effects = field(default_factory=dict)
    true: Effects = field(default_factory=dict)
    joints: dict[str, str] = field(default_factory=dict)
    by_sensor: list[str] = field(default_factory=list)
    seen: dict[str, float] = field(default_factory=dict)
    apart: dict[str, float] = field(default_factory=dict)
    shift: dict[str, float] = field(default_factory=dict)
    nearest: dict[str, str] = field(default_factory=dict)
    alike: list[str] = field(default_factory=list)
    detectable: bool = True
    separable: bool | None = None
    unasked: float = 0.0
    disturbance: str = ""
    logged: str = ""

    @property
    def known(self) -> frozenset[str]:
        """The hidden effects that the catalogue has."""
        return frozenset(effect for effect in self.hidden if not effect.startswith("outside:"))

    @property
    def neither(self) -> frozenset[str]:
        """Effects that need not be named and are not wrong if they are: small ones, and what looks the same here."""
        return (frozenset(self.small) | frozenset(self.alike)) - self.known

    @property
    def strength(self) -> float:
        """How far the least visible hidden effect stands out: 1 is just detectable; NaN without one."""
        return min((seen / SEEN for seen in self.seen.values()), default=float("nan"))

    @property
    def quiet(self) -> bool:
        """Whether what nobody asks for adds so little to a chi square that nothing needs to be said of it."""
        return self.unasked**2 < QUIET

    @property
    def outside(self) -> str:
        """What the catalogue lacks, "" for nothing."""
        return next((effect.removeprefix("outside:") for effect in self.hidden if effect.startswith("outside:")), "")

    @property
    def about(self) -> str:
        """What else there is to know about a session, in a few words."""
        strength = f"strength {self.strength:.2g}, " if self.hidden else ""
        alike = f", like {', '.join(self.alike)}" if self.alike else ""
        return f"{strength}{self.family}: {self.logged}; disturbance {self.disturbance}{alike}"

    def find_truth(self, effect: str, parameter: str) -> float:
        """What the rig has of a hidden effect, its jitter included."""
        return self.true[effect][parameter]

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> MechanismPlan:
        """Read what `asdict` made."""
        return cls(**{f.name: content[f.name] for f in fields(cls) if f.name in content})

    @classmethod
    def from_record(cls, session: Session, recorded: Recorded) -> MechanismPlan:
        """What the benchmark keeps of a recorded session."""
        truth, push = recorded.truth, session.disturbance
        seen, apart, shift, nearest = (
            {effect: getattr(v, name) for effect, v in truth.visibility.items()}
            for name in ("seen", "apart", "shift", "nearest")
        )
        done = ", ".join(f"{m.style} {m.kind} {m.duration:g} s" for m in session.motions)
        return cls(
            session.number, session.kind, session.family, truth.hidden, truth.small, truth.true, truth.joints,
            truth.by_sensor, seen, apart, shift, nearest, truth.alike, truth.detectable, truth.separable,
            truth.unasked,
            f"{push.kind} {100.0 * push.strength:.2g} % {push.time:.2g} s",
            f"{done}, {session.rate} Hz, velocities {session.sensors.velocity}",
        )  # fmt: skip
