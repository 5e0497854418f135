"""Windows of logs beside a twin, as the inference sees them."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from vpptwin.diagnosis.evidence.bench import FAR, Bench
from vpptwin.diagnosis.evidence.runs import Variation
from vpptwin.diagnosis.search.likelihood import (
    Response,
    likeness_of_gusts,
    measure_response,
    middles_of_segments,
)
from vpptwin.diagnosis.search.suspects import Unknown as Suspect
from vpptwin.effects import find_effect
from vpptwin.inference.covariance import factor
from vpptwin.inference.fit import Key, Point, Unknown
from vpptwin.inference.model import Layout, Nuisance, ScalePrior

SHEET, ASSUMED = 0.1, 2.0
"""Standard deviations of the log of a sensor's noise: where it is known, and where the samples were looked at only."""
FARTHEST = 1e5
"""Assumed noises by which a simulation can miss: what diverges is wrong, however far."""
LESS = 1.0 / 3.0
"""Share of its tolerance that is believed of what only takes energy out: a model without friction knows of none."""
KEPT = 8
"""Responses that are kept."""
CALM, VARIED = 0.2, 2.0
"""Median of the process noise, in what the robot says of it, and standard deviation of its log."""


class BenchSimulator:
    """A bench as `inference` asks for it."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self._responses: dict[Hashable, tuple[Response, Nuisance]] = {}
        nv = bench.spec.model.nv
        noise = np.where(bench.valid, bench.std, np.inf)
        self.layout = Layout(noise, bench.columns, np.tile(np.arange(nv), bench.segments))
        self.scale_prior = ScalePrior(
            np.array([SHEET if is_known(bench, i) else ASSUMED for i in range(len(bench.channels))]),
            np.array([find_floor(bench, i) for i in range(len(bench.channels))]),
            np.full(nv, CALM),
            np.full(nv, VARIED),
        )

    def residuals(self, points: Sequence[Point], about: Point) -> np.ndarray:
        """Measured less simulated, (V, K, M)."""
        predicted = self.bench.predict([Variation(dict(point)) for point in points], dict(about))
        missed = np.clip(self.bench.miss(predicted), -FARTHEST * self.bench.std, FARTHEST * self.bench.std)
        return self._response(about)[0].restore(missed, self.bench.track)

    def respond(self, point: Point) -> Nuisance:
        """What starting states and force pulses do, in units of their priors."""
        return self._response(point)[1]

    def _response(self, point: Point) -> tuple[Response, Nuisance]:
        """The response at a point, measured once for every point of a coarse grid."""
        loose = self.loosen(point)
        key = frozenset(loose.items())
        if key not in self._responses:
            if len(self._responses) >= KEPT:
                del self._responses[next(iter(self._responses))]
            response = measure_response(self.bench, loose)
            self._responses[key] = response, self._name_columns(response)
        return self._responses[key]

    def _name_columns(self, response: Response) -> Nuisance:
        """The columns of a response, with pulses that are independent."""
        bench = self.bench
        alike = likeness_of_gusts(bench, middles_of_segments(bench))
        count, values, _ = response.push.shape
        root = factor(alike + 1e-9 * np.eye(bench.segments))
        push = response.push.reshape(count, values, bench.segments, -1)
        push = np.einsum("kmsd,kst->kmtd", push, root).reshape(count, values, -1)
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
    seen = bench.channels[channel]
    series = {"position": "positions", "velocity": "velocities"}.get(seen.kind)
    return series is None or all(getattr(m, series)[seen.axis].white for m in bench.flights)


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


def name_unknown(suspect: Suspect) -> Unknown:
    """A suspect as `inference` asks for it."""
    parameter, share = suspect.parameter, LESS if suspect.effect.dissipative else 1.0
    return Unknown(
        suspect.key, suspect.nominal, suspect.width, parameter.low, parameter.high, suspect.step_from,
        0.0 if suspect.is_limit else share * parameter.tolerance,
    )  # fmt: skip
