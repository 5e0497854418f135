"""What a diagnosis searches: windows of logs on a bench, and the parameters that may be wrong."""

from __future__ import annotations

from dataclasses import dataclass

from vpptwin.diagnosis.criteria import Criteria
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.search.suspects import Unknown


@dataclass(frozen=True, eq=False)
class Search:
    """The windows that are fitted, and the parameters of all candidates."""

    bench: Bench
    unknowns: tuple[Unknown, ...]

    @property
    def criteria(self) -> Criteria:
        """Thresholds."""
        return self.bench.criteria
