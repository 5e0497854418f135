"""Windows of logs beside a twin, as the inference sees them."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from functools import cached_property

import numpy as np

from vpptwin.diagnosis.criteria import Criteria
from vpptwin.diagnosis.evidence.bench import FAR, Bench
from vpptwin.diagnosis.evidence.runs import Track, Variation, keep_last
from vpptwin.diagnosis.search.likelihood import (
    Response,
    gust_std,
    likeness_of_gusts,
    measure_response,
    middles_of_segments,
    start_std,
)
from vpptwin.diagnosis.search.suspects import Unknown as Suspect
from vpptwin.effects import Stage, find_effect
from vpptwin.inference.covariance import factor
from vpptwin.inference.fit import Key, Point, Unknown
from vpptwin.inference.model import Layout, Nuisance, ScalePrior

SHEET, ASSUMED = 0.1, 2.0
"""Standard deviations of the log of a sensor's noise: where it is known, and where the samples were looked at only."""
FARTHEST = 1e5
"""Assumed noises by which a simulation can miss: what diverges is wrong, however far."""
LESS = 1.0 / 3.0
"""Share of its tolerance that is believed of what only takes energy out: a model without friction knows of none."""
FINE = 0.1
"""Share of its typical size by which what acts smoothly is moved for a derivative along a path."""
KEPT = 8
"""Responses that are kept."""
CALM, VARIED = 0.2, 2.0
"""Median of the process noise, in what the robot says of it, and standard deviation of its log."""


class BenchSimulator:
    """A bench as `inference` asks for it.

    Args:
        bench: the windows.
    """

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self._responses: dict[Hashable, Nuisance] = {}
        self._tracks: dict[bytes, Track] = {}
        nv = bench.spec.model.nv
        noise = np.where(bench.valid, bench.std, np.inf)
        self.layout = Layout(noise, bench.columns, np.tile(np.arange(nv), bench.segments))
        self.scale_prior = ScalePrior(
            np.array([SHEET if is_known(bench, i) else ASSUMED for i in range(len(bench.channels))]),
            np.array([find_floor(bench, i) for i in range(len(bench.channels))]),
            np.full(nv, CALM),
            np.full(nv, VARIED),
        )

    def residuals(self, points: Sequence[Point], about: Point, path: np.ndarray | None = None) -> np.ndarray:
        """Measured less simulated, (V, K, M)."""
        bench = self.bench if path is None else self.bench.about(self._track(path))
        predicted = bench.predict([Variation(dict(point)) for point in points], dict(about))
        return np.clip(bench.miss(predicted), -FARTHEST * bench.std, FARTHEST * bench.std)

    def respond(self, point: Point, path: np.ndarray | None = None) -> Nuisance:
        """What starting states and force pulses do, in units of their priors.

        Measured about a path as it is; about none once for every point of a coarse grid, what sticks left out.
        """
        loose = self.loosen(point) if path is None else dict(point)
        key = frozenset(loose.items()), None if path is None else path.tobytes()
        if key not in self._responses:
            bench = self.bench if path is None else self.bench.about(self._track(path))
            found = self._name_columns(measure_response(bench, loose))
            keep_last(self._responses, key, found, KEPT)
        return self._responses[key]

    @cached_property
    def _root(self) -> np.ndarray:
        """Factors of the correlation of every window's pulses, (K, segments, segments)."""
        alike = likeness_of_gusts(self.bench, middles_of_segments(self.bench))
        return factor(alike + 1e-9 * np.eye(self.bench.segments))

    def _track(self, path: np.ndarray) -> Track:
        """A path as a bench has it, the same object for the same path: what was simulated about it is kept by that."""
        nv, bench, key = self.bench.spec.model.nv, self.bench, path.tobytes()
        if key in self._tracks:
            return self._tracks[key]
        state = path[:, : 2 * nv] * start_std(bench)
        push = np.einsum("kst,ktd->ksd", self._root, path[:, 2 * nv :].reshape(len(path), bench.segments, nv))
        return keep_last(self._tracks, key, Track(state[:, :nv], state[:, nv:], push * gust_std(bench)), KEPT)

    def _name_columns(self, response: Response) -> Nuisance:
        """The columns of a response, with pulses that are independent."""
        bench = self.bench
        count, values, _ = response.push.shape
        push = response.push.reshape(count, values, bench.segments, -1)
        push = np.einsum("kmsd,kst->kmtd", push, self._root).reshape(count, values, -1)
        far = FARTHEST * bench.std[..., None]
        states = np.clip(response.state * response.state_std, -far, far)
        return Nuisance.of(states, np.clip(push, -far, far), self.layout)

    def loosen(self, point: Point) -> dict[Key, float]:
        """A point that responds nearly as another: without dry friction, and only what is far off, on a coarse grid."""
        bench = self.bench
        far, loose = dict(bench.regime(dict(point))), bench.loosen(dict(point))
        for key in loose:
            effect = find_effect(bench.spec.catalogue, key[0])
            if key[0] in far and effect.parameters[0].name == key[1]:
                nominal, parameter = bench.spec.value(effect, key[1]), effect.parameters[0]
                size = FAR * parameter.size * 2.0 ** (far[key[0]] + 0.5)
                away = float(np.copysign(size, loose[key] - nominal))
                loose[key] = float(parameter.clip(np.array(nominal + away)))
        return loose


def is_known(bench: Bench, channel: int) -> bool:
    """Whether the noise of a channel's sensor is known."""
    seen = bench.channels[channel]  # to what rates and forces show a roughness is added, whatever the sheet says
    return seen.kind == "position" and all(m.positions[seen.axis].white for m in bench.flights)


def find_floor(bench: Bench, channel: int) -> float:
    """Least noise of a channel over what is assumed: that of the steps in which it was logged, 1/√12 of one."""
    seen, steps = bench.channels[channel], []
    series = {"position": "positions", "velocity": "velocities"}.get(seen.kind)
    if series is None:
        return 1e-2
    for measured in bench.flights:
        apart = np.diff(np.unique(getattr(measured, series)[seen.axis].value))
        steps.append(float(apart[apart > 0.0].min()) if np.any(apart > 0.0) else 0.0)
    assumed = float(np.median(seen.std[bench.valid[:, bench.columns[channel]]]))
    return max(max(steps) / np.sqrt(12.0) / assumed, 1e-3)


def name_unknown(suspect: Suspect, criteria: Criteria) -> Unknown:
    """A suspect as `inference` asks for it."""
    parameter, effect = suspect.parameter, suspect.effect
    share = LESS if effect.dissipative else 1.0
    rough = suspect.is_limit or effect.placed or effect.stage in (Stage.FRICTION, Stage.SLIP)
    return Unknown(
        suspect.key, suspect.nominal, suspect.width, parameter.low, parameter.high, suspect.step_from,
        0.0 if suspect.is_limit else share * parameter.tolerance, criteria.tolerances * parameter.tolerance,
        1.0 if rough else FINE, suspect.typical if suspect.is_limit else None,
    )  # fmt: skip
