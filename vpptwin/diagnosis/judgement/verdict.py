"""The verdict as data: verdict.json (keys: docs/diagnose.md), written whole or not at all."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from vpptwin.diagnosis.evidence.flights import HORIZONS_S, SHOWN
from vpptwin.diagnosis.judgement.case import Rule
from vpptwin.diagnosis.judgement.holdout import Score
from vpptwin.effects import SIGMAS_90

MOST = 0.5
"""Share of an error up to which most of it is gone."""


@dataclass(frozen=True)
class Estimate:
    """A fitted parameter: value and standard deviation in `unit`, and its value in the twin that was diagnosed."""

    value: float
    unit: str
    std: float
    nominal: float

    @property
    def interval(self) -> tuple[float, float]:
        """Its 90 % interval."""
        return self.value - SIGMAS_90 * self.std, self.value + SIGMAS_90 * self.std


@dataclass(frozen=True)
class Rival:
    """An effect that this data cannot tell from the named one: how probable it is instead, and how many sigma apart.

    Its `parameters` are those of the fit with it in the place of the cause; none where nobody fitted it.
    """

    effect: str
    confidence: float
    sigma: float = 0.0
    parameters: dict[str, Estimate] = field(default_factory=dict)
    summary: str = ""
    kind: str = ""


@dataclass(frozen=True)
class Cause:
    """A named effect; `gain` is the share of the held-out excess chi2 that it removes, with its 90 % interval.

    Of a contact's, which so many `blows` show, each held out in its turn, of the error there. `kind_confidence` is the
    probability that anything of its `kind` acts there, such as dry friction of some law. Of a `weak` one both are below
    `Criteria.named`: it stays out of the extended twin. `log_odds` are those of the posterior, before calibration; None
    where nothing was compared.
    """

    effect: str
    confidence: float
    parameters: dict[str, Estimate]
    gain: float
    also_explained_by: list[Rival]
    summary: str = ""
    gain_interval: tuple[float, float] | None = None
    blows: int = 0
    kind: str = ""
    kind_confidence: float = 0.0
    weak: bool = False
    log_odds: float | None = None


@dataclass(frozen=True)
class Unexplained:
    """What is left: whether it is more than noise and gusts, its share of what was missing, where, and what it follows.

    `sigma` is how far it is predicted by what it follows, in standard deviations; `force`, on rigs whose scales come
    from a log, is the random force that would make the held-out error, as a share of what drives
    the joint.
    """

    significant: bool
    share: float
    channel: str | None
    depends_on: list[str]
    sigma: float = 0.0
    force: float | None = None


@dataclass(frozen=True)
class Misfit:
    """Held-out error far above what the sensors make, explained or not.

    Attributes:
        times: of what the sensors make, root mean square.
        joint: where most of it is.
        horizon_s: from which on it stands out there; None if at none.
        rmse: the error there at the last horizon, in `unit`.
        unit: of the joint.
        within: effects that together take half of its excess chi² and more away without leaving their build tolerance,
            those that move most first.
        explained: the share that they take away.
    """

    times: float
    joint: str
    horizon_s: float | None
    rmse: float
    unit: str
    within: list[str] = field(default_factory=list)
    explained: float = 0.0


@dataclass(frozen=True)
class Cleared:
    """A candidate that is ruled out: with 90 % probability its parameter lies between low and high."""

    effect: str
    parameter: str
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Unseen:
    """A candidate that is not identifiable from these data, and why."""

    effect: str
    reason: str


@dataclass(frozen=True)
class Experiment:
    """The manoeuvre of the library that separates what is confused best.

    Attributes:
        manoeuvre: its name.
        parameters: its parameters.
        separates: the effects that it tells apart.
        sigma: how far apart they are predicted to be after it.
        command: what to type to see it flown in the twin.
    """

    manoeuvre: str
    parameters: dict[str, float]
    separates: list[str]
    sigma: float
    command: str


@dataclass(frozen=True)
class Cut:
    """Why a diagnosis was stopped, how long it had gone on [s], and what was not done."""

    why: str
    after_s: float
    not_done: list[str]


@dataclass(frozen=True, repr=False)
class Verdict:
    """What the twin gets wrong; of a diagnosis that was stopped so far, or of `only` some candidates."""

    logs: list[str]
    twin: str
    windows: int
    held_out_windows: int
    before: Score
    after: Score
    gap: bool
    causes: list[Cause]
    unexplained: Unexplained
    cleared: list[Cleared] = field(default_factory=list)
    unseen: list[Unseen] = field(default_factory=list)
    improvement: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    """90 % interval of the change in error per horizon, as a share of the error before, from blocks of flight."""
    experiment: Experiment | None = None
    misfit: Misfit | None = None
    warnings: list[str] = field(default_factory=list)
    stopped: Cut | None = None
    only: list[str] = field(default_factory=list)
    settled: list[str] = field(default_factory=list)  # effects that were no candidates, as the user said
    suggested: Score | None = None  # errors with the weak causes too, where there are any
    decisions: dict[str, list[Rule]] = field(default_factory=dict)  # effect → rules that it passed, or not

    def __repr__(self) -> str:
        """What is named, and errors `SHOWN` ahead."""
        named = ", ".join(f"{cause.effect} {100.0 * cause.confidence:.3g} %" for cause in self.named)
        errors = [f"{name} {error:.3g} → {self.after.ahead[name]:.3g}" for name, error in self.before.ahead.items()]
        return f"Verdict({named or 'nothing named'}; {HORIZONS_S[SHOWN]:g} s ahead {', '.join(errors)})"

    @property
    def named(self) -> list[Cause]:
        """The causes that the extended twin has."""
        return [cause for cause in self.causes if not cause.weak]

    @property
    def weak(self) -> list[Cause]:
        """The others."""
        return [cause for cause in self.causes if cause.weak]

    @property
    def suggests(self) -> bool:
        """Whether the weak causes take most of an error of the pose `SHOWN` ahead away, however unsure their names."""
        pairs = () if self.suggested is None else zip(self.after.ahead.values(), self.suggested.ahead.values())
        return any(less < MOST * error for error, less in pairs)

    @property
    def partial(self) -> bool:
        """Whether less was looked at than a diagnosis looks at."""
        return self.stopped is not None or bool(self.only)

    def as_dict(self) -> dict[str, object]:
        """The verdict under the keys of verdict.json (docs/diagnose.md)."""
        causes = [trim(asdict(cause)) for cause in self.causes]
        for cause in causes:
            cause["also_explained_by"] = [trim({**rival, "kind": ""}) for rival in cause["also_explained_by"]]
        content: dict[str, object] = {
            "logs": self.logs, "twin": self.twin,
            "samples": {"windows": self.windows, "held_out_windows": self.held_out_windows},
            "horizons_s": list(HORIZONS_S), "before": self.before.as_dict(), "after": self.after.as_dict(),
            "gap": self.gap, "misfit": asdict(self.misfit) if self.misfit is not None else None, "causes": causes,
            "unexplained": asdict(self.unexplained),
            "suggested_experiment": self.experiment.manoeuvre if self.experiment is not None else None,
            "experiment": asdict(self.experiment) if self.experiment is not None else None,
            "cleared": [asdict(suspect) for suspect in self.cleared],
            "unseen": [asdict(suspect) for suspect in self.unseen], "improvement": self.improvement,
            "warnings": self.warnings,
            "decisions": {effect: [rule._asdict() for rule in rules] for effect, rules in self.decisions.items()},
            "stopped": asdict(self.stopped) if self.stopped is not None else None, "only": self.only or None,
        }  # fmt: skip
        content |= {"settled": self.settled} if self.settled else {}
        content |= {"suggested": self.suggested.as_dict()} if self.suggested is not None else {}
        return content


def trim(told: dict[str, Any]) -> dict[str, Any]:
    """A cause or a rival without words, and without keys that say nothing: what reads verdicts may not know them."""
    sparse = ("blows", "kind", "kind_confidence", "weak", "parameters", "log_odds")
    return {name: value for name, value in told.items() if name != "summary" and (value or name not in sparse)}
