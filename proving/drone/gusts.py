"""Gusts: force and moment that nobody modelled, of several kinds, as strong and as lasting as a session draws them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import fftconvolve, lfilter

from .size import round_size

STEP = 0.001  # s
SHARE = 0.01  # of weight, and of weight times half the arm length: rms of gusts of strength 1
STRENGTHS, TIMES, AXES = (0.3, 3.0), (0.1, 1.0), (0.5, 2.0)  # what is drawn: times SHARE; s; one axis against another
WAVES = 12  # sinusoids per axis
LENGTHS = (0.4, 1.6)  # m, of the field's waves
BURST, CALM = 3.0, 3.0  # correlation times that a burst lasts, and between two on average


@dataclass(frozen=True)
class Wind:
    """What gusts are like; the default is what the diagnosis assumes."""

    kind: str = "ou"  # One of KINDS
    strength: float = 1.0  # rms, in multiples of SHARE
    time: float = 0.3  # s over which the force stays alike
    axes: tuple[float, float, float] = (1.0, 1.0, 1.0)  # Factors on x, z and moment

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Wind:
        """Read what `asdict` made."""
        return cls(**{**content, "axes": tuple(content["axes"])})

    def scale(self, nominal: dict) -> np.ndarray:
        """Rms on x N, z N and of the moment N m. (3,)."""
        airframe = nominal["airframe"]
        weight = airframe["mass"] * nominal["gravity"]
        return self.strength * SHARE * weight * np.array(self.axes) * np.array([1.0, 1.0, airframe["half_length"]])


def draw_wind(rng: np.random.Generator, most: float = STRENGTHS[1]) -> Wind:
    """Draw a kind, a strength up to `most`, a correlation time and how the axes differ; sizes are log-uniform."""

    def draw(low: float, high: float) -> float:
        return round_size(np.exp(rng.uniform(np.log(low), np.log(high))))

    kind = KINDS[int(rng.integers(len(KINDS)))]
    return Wind(kind, draw(STRENGTHS[0], most), draw(*TIMES), (draw(*AXES), draw(*AXES), draw(*AXES)))


def _draw_walk(rng: np.random.Generator, steps: int, time: float) -> np.ndarray:
    """Ornstein-Uhlenbeck: what the likelihood assumes."""
    decay = np.exp(-STEP / time)
    kicks = rng.standard_normal((steps, 3)) * np.sqrt(1 - decay**2)
    kicks[0] /= np.sqrt(1 - decay**2)
    path = np.empty_like(kicks)
    path[0] = kicks[0]
    for k in range(1, steps):
        path[k] = decay * path[k - 1] + kicks[k]
    return path


def _draw_smooth(rng: np.random.Generator, steps: int, time: float) -> np.ndarray:
    """Second-order low pass, as Dryden's across the wind: two equal lags, each half the time."""
    lead, decay = round(5 * time / STEP), np.exp(-2 * STEP / time)
    noise = rng.standard_normal((steps + lead, 3))
    path = lfilter([(1 - decay) ** 2], [1.0, -2 * decay, decay**2], noise, axis=0)[lead:]
    return path / np.sqrt((1 - decay) * (1 + decay**2) / (1 + decay) ** 3)  # white noise through the lags


def _draw_waves(rng: np.random.Generator, steps: int, time: float) -> np.ndarray:
    """Sinusoids within two octaves about the corner of a lag of that time."""
    omega = 2.0 ** rng.uniform(-1, 1, (WAVES, 1, 3)) / time
    phase = rng.uniform(0, 2 * np.pi, (WAVES, 1, 3))
    when = np.arange(steps)[None, :, None] * STEP
    return np.sqrt(2 / WAVES) * sum(np.sin(w * when[0] + p) for w, p in zip(omega, phase))


def _draw_steps(rng: np.random.Generator, steps: int, time: float) -> np.ndarray:
    """Jumps to a new force, on average every `time` s: the walk's spectrum, another distribution."""
    jumps = np.cumsum(rng.random((steps, 3)) < STEP / time, axis=0)
    levels = rng.standard_normal((jumps.max() + 1, 3))
    return np.take_along_axis(levels, jumps, axis=0)


def _draw_bursts(rng: np.random.Generator, steps: int, time: float) -> np.ndarray:
    """Calm, and now and then a push that swells and fades."""
    length = round(BURST * time / STEP)
    rate = 1 / ((BURST + CALM) * time)
    shape = 0.5 * (1 - np.cos(2 * np.pi * (np.arange(length) + 0.5) / length))
    size = (steps + length, 3)
    pushes = np.where(rng.random(size) < STEP * rate, rng.standard_normal(size), 0.0)
    path = fftconvolve(pushes, shape[:, None], axes=0)[length : length + steps]
    return path / np.sqrt(rate * 3 / 8 * length * STEP)  # Campbell: rate times the mean square of a push


SERIES: dict[str, Callable[[np.random.Generator, int, float], np.ndarray]] = {
    "ou": _draw_walk,
    "smooth": _draw_smooth,
    "waves": _draw_waves,
    "steps": _draw_steps,
    "bursts": _draw_bursts,
}
"""Kind → series of variance 1, (steps, 3), from a source of randomness, steps of STEP and a correlation time s."""
KINDS = (*SERIES, "field")


def draw_gust(wind: Wind, rng: np.random.Generator, steps: int, nominal: dict) -> np.ndarray:
    """Force and moment at the whole milliseconds, N, N, N m; none of a field, which is felt in flight. (steps, 3)."""
    if wind.kind == "field":
        return np.zeros((steps, 3))
    if wind.kind not in SERIES:
        raise ValueError(f"unknown gusts {wind.kind!r}; there are {', '.join(KINDS)}")
    return SERIES[wind.kind](rng, steps, wind.time) * wind.scale(nominal)


class Field:
    """Gusts that depend on place: waves of force over x and z that travel, so that they change at rest too."""

    def __init__(self, flights: Sequence[Mapping[str, Any]], nominal: dict) -> None:
        """Draw the fields of those flights of a batch that fly in one; each has `seed`, `gusts` and `wind`."""
        self.rows = np.array([i for i, f in enumerate(flights) if f["gusts"] and f["wind"].kind == "field"], dtype=int)
        winds = [flights[i]["wind"] for i in self.rows]
        drawn = [np.random.default_rng([flights[i]["seed"], 1]).random((4, WAVES, 3)) for i in self.rows]
        length, heading, pace, phase = np.stack(drawn, axis=-1) if drawn else np.zeros((4, WAVES, 3, 0))
        number = 2 * np.pi / (LENGTHS[0] * (LENGTHS[1] / LENGTHS[0]) ** length)  # rad/m
        self.along = number * np.cos(2 * np.pi * heading), number * np.sin(2 * np.pi * heading)
        self.omega = 2.0 ** (2 * pace - 1) / np.array([wind.time for wind in winds])  # rad/s
        self.phase = 2 * np.pi * phase
        scales = [wind.scale(nominal) for wind in winds]
        self.scale = np.sqrt(2 / WAVES) * (np.stack(scales, axis=-1) if scales else np.zeros((3, 0)))

    def feel(self, time: float, position: np.ndarray) -> np.ndarray:
        """Force and moment at `time` s and a position (3, flights), N, N, N m. (3, flights with a field)."""
        x, z = position[:2, self.rows]
        return self.scale * np.sin(self.along[0] * x + self.along[1] * z + self.omega * time + self.phase).sum(0)
