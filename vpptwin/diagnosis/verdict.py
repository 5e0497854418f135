"""The verdict as data: verdict.json of SPEC 7, written whole or not at all."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path

from vpptwin.diagnosis.holdout import HORIZONS_S, Score


@dataclass(frozen=True)
class Estimate:
    """A fitted parameter: value and standard deviation in `unit`, and its value in the twin that was diagnosed."""

    value: float
    unit: str
    std: float
    nominal: float


@dataclass(frozen=True)
class Rival:
    """An effect that this data cannot tell from the named one, and how probable it is instead."""

    effect: str
    confidence: float


@dataclass(frozen=True)
class Cause:
    """A named effect; `gain` is the share of the held-out excess chi2 that it removes."""

    effect: str
    confidence: float
    parameters: dict[str, Estimate]
    gain: float
    also_explained_by: list[Rival]
    summary: str = ""


@dataclass(frozen=True)
class Unexplained:
    """What is left: whether it exceeds no-effect flights, its share of the excess, its channel and what it follows."""

    significant: bool
    share: float
    channel: str | None
    depends_on: list[str]


@dataclass(frozen=True)
class Verdict:
    """What the twin gets wrong (SPEC 7)."""

    logs: list[str]
    twin: str
    windows: int
    held_out_windows: int
    before: Score
    after: Score
    gap: bool
    causes: list[Cause]
    unexplained: Unexplained
    suggested_experiment: str | None = None
    warnings: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, object]:
        """The verdict in the form of SPEC 7."""
        causes = [{k: v for k, v in asdict(cause).items() if k != "summary"} for cause in self.causes]
        content: dict[str, object] = {
            "logs": self.logs,
            "twin": self.twin,
            "samples": {"windows": self.windows, "held_out_windows": self.held_out_windows},
            "horizons_s": list(HORIZONS_S),
            "before": self.before.as_dict(),
            "after": self.after.as_dict(),
            "gap": self.gap,
            "causes": causes,
            "unexplained": asdict(self.unexplained),
            "suggested_experiment": self.suggested_experiment,
            "warnings": self.warnings,
        }
        return content


def write_json(content: object, path: Path) -> None:
    """Write JSON through a temporary file; numbers that are not finite become null, which JSON lacks."""
    write_text(json.dumps(without_nan(content), indent=2, ensure_ascii=False) + "\n", path)


def write_text(text: str, path: Path) -> None:
    """Write a file through a temporary one beside it, so that a good one is never half overwritten."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def without_nan(content: object) -> object:
    """The same content with null for NaN and infinity."""
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    if isinstance(content, dict):
        return {key: without_nan(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [without_nan(value) for value in content]
    return content
