"""What became of a session, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from proving.runner.draw import Plan
from proving.runner.mechanisms import MechanismPlan

CONFIDENT = 0.9
"""A cause named with more than this is claimed, not suggested."""
SEEN, APART = 4.0, 3.0
"""Sigma from nothing and from the nearest rival beyond which flights show an effect and separate it from all others.
The first is about a family-wise 1 % over the catalogue. A rival nearer than the second is in the cause's group."""


@dataclass(frozen=True)
class Named:
    """A cause of a verdict."""

    effect: str  # its id
    confidence: float  # 0..1
    gain: float  # share of the held-out excess that it removes
    parameters: dict[str, dict[str, float]]  # name → value, std, nominal
    rivals: dict[str, float]  # effect that it cannot be told from → sigma between them


@dataclass(frozen=True)
class Finding:
    """What a verdict says, as far as it is counted."""

    causes: list[Named]  # strongest first
    unexplained: bool  # whether something is said to be left
    channel: str  # where it is left, "" for nowhere
    chi2: tuple[float, float]  # held out, before and after
    unseen: list[str]  # effects that the flights are said not to show
    experiment: str  # the manoeuvre suggested, "" for none
    seconds: float  # time it took
    gap: bool = False  # whether anything is said to be wrong
    memory: float = 0.0  # most that the process held [MB]; 0 where not measured

    @property
    def named(self) -> list[str]:
        """Ids of the causes, strongest first."""
        return [cause.effect for cause in self.causes]

    @property
    def suspected(self) -> set[str]:
        """Causes and all that they are said not to be told from."""
        return {*self.named}.union(*(cause.rivals for cause in self.causes))

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Finding:
        """Read what `asdict` made."""
        return cls(**{**content, "causes": [Named(**c) for c in content["causes"]], "chi2": tuple(content["chi2"])})


@dataclass(frozen=True)
class Case:
    """One session and what became of it."""

    plan: Plan | MechanismPlan  # what was hidden
    found: Finding | None  # the diagnosis; None if it failed
    oracle: Finding | None = None  # the same judgement with the true structure fitted; None where that was not done
    error: str = ""  # why the diagnosis failed, "" otherwise
    commit: str = ""  # of the code that flew and diagnosed it, `+changes` where that was changed; "" where not recorded

    @property
    def version(self) -> str:
        """The first seven digits of the commit."""
        return self.commit[:7]

    @property
    def neither(self) -> frozenset[str]:
        """Effects that need not be named and are not wrong if they are; plans of other rigs may know of none."""
        return getattr(self.plan, "neither", frozenset())

    @property
    def claims(self) -> list[Named]:
        """Causes that count, strongest first: all but those that are, or are not told from, what is neither."""
        causes = self.found.causes if self.found else []
        known, neither = self.plan.known, self.neither
        return [c for c in causes if c.effect not in neither and (c.effect in known or not neither & set(c.rivals))]

    @property
    def first(self) -> str:
        """The strongest cause that counts, "" for none."""
        return next((cause.effect for cause in self.claims), "")

    @property
    def all_named(self) -> bool:
        """Every hidden effect of the catalogue is named, one of them first."""
        known = self.plan.known
        return self.found is not None and self.first in known and known <= set(self.found.named)

    @property
    def all_suspected(self) -> bool:
        """Every hidden effect of the catalogue is named or in the group of a cause."""
        return self.found is not None and self.plan.known <= self.found.suspected

    @property
    def owned(self) -> list[bool]:
        """Of every hidden effect that is neither named nor in a group, whether it is said not to show in these logs."""
        if self.found is None:
            return []
        return [effect in self.found.unseen for effect in sorted(self.plan.known - self.found.suspected)]

    @property
    def wrong(self) -> list[str]:
        """Causes claimed of which neither they nor their group are there."""
        known = self.plan.known
        return [c.effect for c in self.claims if c.confidence > CONFIDENT and not {c.effect, *c.rivals} & known]

    @property
    def separable(self) -> bool | None:
        """Whether these flights show what is hidden and tell it from all else, by the fit of the true structure.

        The search has no part in this: the truth is fitted and compared with every rival in its place. Without that
        fit, what whoever recorded them knows; None for nothing.
        """
        if self.oracle is None:
            return self.plan.separable
        fitted = {cause.effect: cause for cause in self.oracle.causes}
        return all(effect in fitted and self._stands_out(fitted[effect]) for effect in self.plan.known)

    @staticmethod
    def _stands_out(cause: Named) -> bool:
        strength = next(iter(cause.parameters.values()))
        seen = abs(strength["value"] - strength["nominal"]) > SEEN * strength["std"]
        return seen and all(sigma >= APART for sigma in cause.rivals.values())

    @property
    def relative_gain(self) -> float | None:
        """Drop in held-out chi2 over the oracle's; None where the truth explains less than a tenth of the excess."""
        if self.found is None or self.oracle is None:
            return None
        before, best = self.oracle.chi2
        if before - best < 0.1 * max(before - 1.0, 0.5):
            return None
        return (before - self.found.chi2[1]) / (before - best)

    def as_dict(self) -> dict[str, Any]:
        """For JSON; `strength` and the marks are there for whoever reads the file."""
        strength = self.plan.strength if self.plan.hidden else None
        marks = {"strength": strength, "named": self.found.named if self.found else None, "wrong": self.wrong}
        return asdict(self) | {"marks": marks}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Case:
        """Read what `as_dict` made."""
        given = {f.name: content[f.name] for f in fields(cls) if f.name in content}  # older files lack some
        given["plan"] = (MechanismPlan if "family" in given["plan"] else Plan).from_dict(given["plan"])
        for name in ("found", "oracle"):
            given[name] = given[name] and Finding.from_dict(given[name])
        return cls(**given)
