"""What starting states and gusts do to twins that stick and twins that glide, measured once each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key, keep_last
from vpptwin.diagnosis.search.likelihood import Response, measure_response

KEPT = 12
"""Twins, those asked for last, whose own responses are kept."""
Regime = tuple[frozenset[str], frozenset[tuple[str, int]]]
"""Ids of the effects of dry friction, and what `Bench.regime` says of the large ones."""


class Responses:
    """Responses of twins on one bench; effects of dry friction, and large ones, change them: those are the key.

    Measured once for every set of such effects, with the parameters it is first asked for, and never again. With the
    floor of a frame added each has factors of its own: those of the last floor asked for are kept.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._measured: dict[Regime, Response] = {}
        self._floored: dict[Regime, Response] = {}
        self._floor = np.empty(0)
        self._own: dict[frozenset[str], tuple[dict[Key, float], Response]] = {}

    def find(
        self,
        sticking: frozenset[str],
        floor: np.ndarray,
        values: Mapping[Key, float],
        gust: np.ndarray | None = None,
    ) -> Response:
        """The response of a twin in which these effects make dry friction, nothing believed better than a floor (K, M).

        Args:
            sticking: ids of the effects.
            floor: of a frame.
            values: parameters, used if it has not been measured yet.
            gust: strength of the pulses it is then measured with, (nv,).
        """
        if floor is not self._floor:
            self._floor, self._floored = floor, {}
        key = sticking, self._bench.regime(values)
        if key not in self._measured:
            self._measured[key] = measure_response(self._bench, values, gust)
        if key not in self._floored:
            found = self._measured[key]
            self._floored[key] = replace(found, std=np.hypot(found.std, floor), sticking=sticking)
        return self._floored[key]

    def without_dry_friction(self, floor: np.ndarray, values: Mapping[Key, float]) -> Response:
        """That of a twin like the one with `values`, but without dry friction."""
        return self.find(frozenset(), floor, self._bench.loosen(values))

    def as_heavy(self, floor: np.ndarray, values: Mapping[Key, float]) -> Response:
        """That of a nominal twin without dry friction, but as heavy as one with `values`, or nearly so."""
        weights = self._bench.weights(values)
        effects = frozenset(effect for effect, _ in weights)
        known = self._own.pop(effects, None)
        if known is None or not self._bench.is_near(known[0], weights):
            known = weights, measure_response(self._bench, self._bench.without_dry_friction | weights)
        _, response = keep_last(self._own, effects, known, KEPT)
        return replace(response, std=np.hypot(response.std, floor))
