"""Domain randomization: parameters of the twin drawn from the catalogue's priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vpptwin.effects import Effect, Parameter, Prior
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin

ALL = "all"
"""Stands for every effect of the twin's catalogue."""
PAPER = "paper"
"""Stands for `PAPER_EFFECTS`."""
IDENTIFIED = "identified"
"""Stands for the effects that the twin YAML gives intervals of: what a diagnosis named or a fit found."""
PAPER_EFFECTS = (
    "airframe.mass", "airframe.inertia", "airframe.com", "carriage.mass", "air.drag", "rotor.thrust_gain",
    "rotor.asymmetry", "rotor.drag", "servo.lag", "servo.trim", "servo.backlash", "command.delay", "mocap.delay",
    "gyro.bias", "rail_x.coulomb", "rail_z.coulomb", "rail_x.viscous", "rail_z.viscous", "pitch.viscous",
)  # fmt: skip
"""What the paper identifies and then randomizes (Domain Randomization): vehicle, actuators, latencies, air, the rig."""


@dataclass(frozen=True)
class Priors:
    """The priors of K parameters side by side, so that all are drawn at once.

    Attributes:
        keys: effect id and parameter.
        start: where a draw starts, (K,): mean, low end, or start of a half-normal.
        width: standard deviation or length of the range, (K,).
        uniform: which are uniform, (K,) bool.
        halved: which are half-normal, (K,) bool.
        low: least that is drawn, (K,): the physical bound, or the end of an interval.
        high: likewise the most.
        home: values that distances are from, (K,): those of the twin, off where it lacks the effect.
    """

    keys: tuple[tuple[str, str], ...]
    start: np.ndarray
    width: np.ndarray
    uniform: np.ndarray
    halved: np.ndarray
    low: np.ndarray
    high: np.ndarray
    home: np.ndarray

    @classmethod
    def of(
        cls, effects: Sequence[Effect], values: Mapping[str, Mapping[str, float]] | None = None,
        intervals: Mapping[str, tuple[float, float]] | None = None,
    ) -> Priors:  # fmt: skip
        """Those of every parameter of some effects.

        Args:
            effects: whose parameters are drawn.
            values: of the twin, effect → parameter → value; None for off.
            intervals: "effect.parameter" → the 90 % interval that data gave, which takes the place of the prior.
        """
        pairs = [(e.id, narrow(p, (intervals or {}).get(f"{e.id}.{p.name}"))) for e in effects for p in e.parameters]
        own = values or {}
        priors = [p.prior for _, p in pairs]
        return cls(
            keys=tuple((effect, p.name) for effect, p in pairs),
            start=np.array([p.a for p in priors]),
            width=np.array([p.b - p.a if p.kind == "uniform" else p.b for p in priors]),
            uniform=np.array([p.kind == "uniform" for p in priors], dtype=bool),
            halved=np.array([p.kind == "halfnormal" for p in priors], dtype=bool),
            low=np.array([p.low for _, p in pairs]),
            high=np.array([p.high for _, p in pairs]),
            home=np.array([own.get(effect, {}).get(p.name, p.off) for effect, p in pairs]),
        )

    def draw(self, rng: np.random.Generator, count: int, level: np.ndarray | float = 1.0) -> np.ndarray:
        """Draw every parameter inside its bounds, its distance from home times `level`, (count,) or one, (count, K)."""
        draw = rng.standard_normal((count, len(self.keys)))
        draw[:, self.uniform] = rng.uniform(size=(count, int(self.uniform.sum())))
        draw[:, self.halved] = np.abs(draw[:, self.halved])
        drawn = np.clip(self.start + self.width * draw, self.low, self.high)
        share = np.broadcast_to(level, count)[:, None]
        return np.where(share == 1.0, drawn, self.home + share * (drawn - self.home))

    def standardize(self, values: np.ndarray) -> np.ndarray:
        """Values (..., K) from their means in standard deviations, for a critic that is told."""
        spread = self.width * np.where(self.uniform, 12.0**-0.5, np.where(self.halved, (1.0 - 2.0 / np.pi) ** 0.5, 1.0))
        mean = self.start + self.width * np.where(self.uniform, 0.5, np.where(self.halved, (2.0 / np.pi) ** 0.5, 0.0))
        return (values - mean) / np.where(spread > 0.0, spread, 1.0)


def narrow(parameter: Parameter, interval: tuple[float, float] | None) -> Parameter:
    """A parameter whose prior is what data says of it: normal, within its 90 % interval; itself without one."""
    if interval is None:
        return parameter
    low, high = (float(parameter.clip(np.array(end))) for end in interval)
    return replace(parameter, prior=Prior.within(*interval), low=low, high=high)


def name_effects(
    names: Sequence[str], catalogue: Sequence[Effect], intervals: Mapping[str, tuple[float, float]] | None = None
) -> list[str]:
    """Effect ids that `names`, ids or the names of groups, stand for, each once, in the order of the catalogue.

    An unknown name is passed on, for whoever checks ids to refuse.

    Args:
        names: ids, `all`, `paper` or `identified`; those of contacts, which few tasks make, by their ids alone.
        catalogue: of the twin.
        intervals: "effect.parameter" → 90 % interval that data gave.

    Raises:
        InputError: on `identified` where nothing is, or with intervals that make no sense.
    """
    everything = [effect.id for effect in catalogue]
    found = list_identified(intervals or {}, catalogue) if IDENTIFIED in names else []
    flown = [effect.id for effect in catalogue if not effect.touching]
    groups = {ALL: flown, PAPER: list(PAPER_EFFECTS), IDENTIFIED: found}
    wanted = [effect for name in names for effect in groups.get(name, [name])]
    return sorted(set(wanted), key=lambda id_: (everything.index(id_) if id_ in everything else -1, id_))


def list_identified(intervals: Mapping[str, tuple[float, float]], catalogue: Sequence[Effect]) -> list[str]:
    """Effects that a twin has intervals of.

    Raises:
        InputError: if there are none, one is of what the catalogue lacks, or ends before it begins.
    """
    if not intervals:
        found = "randomize=identified with a twin that has no intervals"
        expected = "the twin.yaml of a diagnosis that named causes"
        raise InputError(found, expected, "name such a twin, or randomize=[]")
    known = {f"{effect.id}.{parameter.name}": effect.id for effect in catalogue for parameter in effect.parameters}
    for key, (low, high) in intervals.items():
        if key not in known or not low <= high:
            found = f"randomize=identified: interval {key} from {low:g} to {high:g}"
            raise InputError(found, "effect.parameter: [low, high]", "let `vpptwin diagnose` write the file")
    return sorted({known[key] for key in intervals})


def randomize(
    twin: Twin, priors: Priors, ids: np.ndarray, rng: np.random.Generator, level: np.ndarray | float = 1.0
) -> np.ndarray:
    """Give the simulations `ids` (n,) fresh parameters.

    Every draw comes from the prior, whatever was drawn before.

    Args:
        twin: in which the effects of the priors are switched on.
        priors: of the parameters to draw.
        ids: simulations to change, (n,) int.
        rng: source of the draws.
        level: multiplies how far the draws are from home, (n,) or one for all.

    Returns:
        What was drawn, (n, K).
    """
    drawn = priors.draw(rng, len(ids), level)
    twin.set_parameters(priors.keys, drawn, ids)
    return drawn
