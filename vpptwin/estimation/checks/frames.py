"""In which order, sense and frame attitudes and rates are, told by each other, or by what pushes or weighs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product as every
from typing import Any

import numpy as np

from vpptwin.estimation.series import integrate
from vpptwin.logs.check import MIN_TURN
from vpptwin.logs.streams.samples import euler_to_quaternion
from vpptwin.system.fields import FRAMES
from vpptwin.twin.robot.manifold import conjugate, difference_attitudes, follow_sign, read_angles, turn_to_world

ABOUT = {"body": "the body's axes", "world": "the world's axes", "euler": "roll, pitch and yaw"}

LONGEST, STEPS, FEWEST = 0.25, 60, 20
"""Turns are compared over steps of this length [s], or of so much of the log; with fewer steps nothing is told."""
LAGS = np.linspace(-0.2, 0.2, 21)
"""By how much attitudes may be later than rates [s]."""
FITS, CLEAR = 0.2, 2.0
"""A reading fits that misses less than this share of the turns; it is better than the given one if that misses so many
times as much."""
SLIGHT = {"turns": 0.01, "pushes": 0.005}
"""Shares of either that are too slight for the given reading to be wrong."""
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
NEAR = np.deg2rad(30.0)
"""Axes that are turned by less are taken for the same."""
BEND = 0.1
"""Accelerations are differences of positions so long before and after an instant [s]."""


@dataclass(frozen=True)
class Reading:
    """A way to read the numbers of an attitude or of rates: in another order, with other signs, about other axes.

    Attributes:
        of: attitude, rate or frame: what is read otherwise.
        order: which of the numbers given come first, second, ..., all of them.
        signs: factors on them, in their new order.
        frame: what rates are about, of `FRAMES`.
        missed, given: share of the turns or directions that it leaves unexplained, and that the numbers as given do.
        turned: by how much axes are turned even so [rad].
    """

    of: str
    order: tuple[int, ...] = ()
    signs: tuple[float, ...] = ()
    frame: str = "body"
    missed: float = 1.0
    given: float = 1.0
    turned: float = 0.0

    def read(self, numbers: np.ndarray) -> np.ndarray:
        """Numbers (n, k) as given, read so."""
        return np.asarray(numbers[:, self.order] * self.signs)


QUATERNIONS = tuple(
    Reading("attitude", tuple(int(i) for i in np.roll(range(4), shift)), (1.0, sense, sense, sense))
    for shift, sense in every((1, 0, 3, 2), (1.0, -1.0))
    if (shift, sense) != (0, 1.0)
)
"""Orders other than w, x, y, z that are cyclic, and the vector part with the other sign."""
ANGLES = tuple(Reading("attitude", (0, 1, 2), signs) for signs in every((1.0, -1.0), repeat=3) if min(signs) < 0.0)
"""Roll, pitch and yaw, of which some have the other sign."""
MIRRORS = (
    *(reading for reading in (replace(each, of="rate") for each in ANGLES) if np.prod(reading.signs) < 0.0),
    *(Reading("rate", order, (1.0, 1.0, 1.0)) for order in ((1, 0, 2), (2, 1, 0), (0, 2, 1))),
)
"""Rates of which one or all have the other sign, or two are swapped: none that an IMU's mount could be."""


def tell_rates(
    time: np.ndarray, attitude: np.ndarray, clock: np.ndarray, rate: np.ndarray, frame: str = "body",
    angled: bool = False, base: np.ndarray = UPRIGHT,
) -> Reading | None:  # fmt: skip
    """How attitudes or rates must be read to turn alike, whichever way an IMU is mounted; None where they do as given.

    Or where none of the readings is clearly better than the given one.

    Args:
        time: of attitudes (n,) s.
        attitude: as given, w, x, y, z (n, 4).
        clock: of rates (m,) s.
        rate: about what `frame` says, (m, 3) in any unit.
        frame: of `FRAMES`.
        angled: whether attitudes came as roll, pitch and yaw.
        base: attitude in the world, (4,), of what they are from.
    """
    begin, end = max(time[0], clock[0]) - LAGS[0], min(time[-1], clock[-1]) - LAGS[-1]
    step = max(min(LONGEST, (end - begin) / STEPS), 2.0 * float(np.median(np.diff(time))))
    at = np.arange(begin, end, step)
    tracks = sum_turns(attitude, base)
    if len(at) <= FEWEST or np.ptp(tracks["body"], axis=0).max() < MIN_TURN:
        return None
    told = np.diff(look_up(at, clock, integrate(rate, clock)), axis=0)

    def fit(track: np.ndarray, fixed: bool, rates: np.ndarray = told) -> tuple[float, float]:
        """Share of rates missed and by how much axes are turned, at the lag at which they are alike."""
        return min(fit_turn(np.diff(look_up(at - lag, time, track), axis=0), rates, fixed) for lag in LAGS)

    given = fit(tracks[frame], frame == "euler")[0]
    if given < SLIGHT["turns"]:
        return None
    others: list[tuple[Reading, tuple[Any, ...]]]
    others = [(Reading("frame", frame=name), (tracks[name], name == "euler")) for name in FRAMES if name != frame]
    if frame != "euler":
        read = [(each, read_attitude(each, attitude)) for each in (ANGLES if angled else QUATERNIONS)]
        others += [(each, (sum_turns(numbers, base)[frame], False)) for each, numbers in read]
        others += [(each, (tracks[frame], False, each.read(told))) for each in MIRRORS]
    found = []
    for reading, compared in others:
        missed, turned = fit(*compared)
        if turned < NEAR or reading.of == "attitude" or reading.frame == "body" != frame:  # an IMU may be mounted so
            found.append(replace(reading, missed=missed, given=given, turned=turned))
    return choose(found)


def choose(found: Sequence[Reading]) -> Reading | None:
    """The reading that is clearly better than what was given; of those that are alike the one that turns axes least."""
    best = min(found, key=lambda each: each.missed, default=None)
    if best is None or best.missed > FITS or best.given < CLEAR * best.missed:
        return None
    good = [each for each in found if each.missed <= CLEAR * best.missed]
    good = [each for each in good if each.turned < NEAR] or good
    # About one axis a gyro of which all signs are turned is an attitude that is: that is the commoner of the two.
    good = [each for each in good if each.of != "rate"] or good
    kind = min(good, key=lambda each: each.missed).of
    return min((each for each in good if each.of == kind), key=lambda each: (each.turned, each.missed))


def tell_push(
    time: np.ndarray, pose: tuple[np.ndarray, np.ndarray], clock: np.ndarray, push: np.ndarray, gravity: np.ndarray,
    angled: bool = False,
) -> Reading | None:  # fmt: skip
    """How attitudes must be read for a body to go where it is pushed; None where they do as given, or none is better.

    Args:
        time: of poses (n,) s.
        pose: positions (n, 3) m and attitudes w, x, y, z (n, 4) as given.
        clock: of pushes (m,) s.
        push: force or specific force without weight in the body's axes, (m, 3) in any unit.
        gravity: in the world's axes (3,) m/s².
        angled: whether attitudes came as roll, pitch and yaw.
    """
    at = np.arange(max(time[0], clock[0]) + BEND, min(time[-1], clock[-1]) - BEND, BEND)
    if len(at) <= FEWEST or not gravity.any():
        return None
    before, place, after = (look_up(at + late, time, pose[0]) for late in (-BEND, 0.0, BEND))
    gained, attitude = (before - 2.0 * place + after) / BEND**2, look_up(at, time, follow_sign(pose[1]))
    told = np.mean([look_up(at + late, clock, push) for late in (-0.5 * BEND, 0.0, 0.5 * BEND)], axis=0)
    size = np.linalg.norm(told, axis=1)
    clear = size > 0.3 * np.median(size)
    told = told[clear] / np.maximum(size[clear, None], 1e-300)
    if len(told) <= FEWEST:
        return None

    def fit(read: np.ndarray, weight: np.ndarray, fixed: bool) -> float:
        """Share of the pushes' directions that is missed."""
        seen = turn_to_world(conjugate(read), gained - weight)[clear]
        return fit_turn(seen / np.linalg.norm(seen, axis=1, keepdims=True), told, fixed, False)[0]

    given = min(fit(attitude, gravity, fixed) for fixed in (True, False))
    if np.median(place @ gravity) > 0.0:  # heights below zero, as where z points down: then it is that which is wrong
        given = min(given, fit(attitude, -gravity, False))
    if given < SLIGHT["pushes"]:
        return None
    readings = ANGLES if angled else QUATERNIONS
    return choose(
        [replace(each, missed=fit(read_attitude(each, attitude), gravity, True), given=given) for each in readings]
    )


def read_attitude(reading: Reading, attitude: np.ndarray) -> np.ndarray:
    """Attitudes w, x, y, z, (n, 4), as given, read so."""
    if len(reading.order) == attitude.shape[1]:
        return reading.read(attitude)
    return euler_to_quaternion(reading.read(read_angles(attitude)))


def sum_turns(attitude: np.ndarray, base: np.ndarray = UPRIGHT) -> dict[str, np.ndarray]:
    """What attitudes (n, 4) from a `base` have turned by since the first, about what rates may be, (n, 3) rad each."""
    attitude = follow_sign(attitude)
    steps = difference_attitudes(attitude[:-1], attitude[1:])
    summed = (
        np.concatenate([np.zeros((1, 3)), np.cumsum(way, axis=0)])
        for way in (steps, turn_to_world(base, turn_to_world(attitude[:-1], steps)))
    )
    return dict(zip(FRAMES, (*summed, np.unwrap(read_angles(attitude), axis=0)), strict=True))


def turn_rates_to_body(attitude: np.ndarray, rate: np.ndarray, frame: str) -> np.ndarray:
    """Rates (n, 3) about the axes of `frame`, about those of the body, which has attitudes (n, 4)."""
    if frame == "world":
        return turn_to_world(conjugate(attitude), rate)
    if frame == "euler":
        (roll, pitch, _), (rolled, pitched, yawed) = read_angles(attitude).T, rate.T
        level = yawed * np.cos(pitch)
        return np.column_stack([
            rolled - yawed * np.sin(pitch), pitched * np.cos(roll) + level * np.sin(roll),
            level * np.cos(roll) - pitched * np.sin(roll),
        ])  # fmt: skip
    return rate


def fit_turn(seen: np.ndarray, told: np.ndarray, fixed: bool, centred: bool = True) -> tuple[float, float]:
    """Share of vectors (n, 3) that others miss, turned and scaled as they fit best, and by how much they are [rad].

    Args:
        seen: what explains, (n, 3).
        told: what is explained, (n, 3).
        fixed: whether axes are those given, not turned.
        centred: whether what is constant is left out of it, such as a bias.
    """
    if centred:
        seen, told = seen - seen.mean(axis=0), told - told.mean(axis=0)
    product = told.T @ seen
    left, sizes, right = np.linalg.svd(product)
    handed = np.array([1.0, 1.0, -1.0 if np.linalg.det(left @ right) < 0.0 else 1.0])  # no turn is a reflection
    turn, sizes = (left * handed) @ right, sizes * handed
    alike = np.trace(product) if fixed else sizes.sum()
    alike = alike / max(float(np.linalg.norm(seen) * np.linalg.norm(told)), 1e-300)
    angle = 0.0 if fixed else np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))
    return float(1.0 - alike * abs(alike)), float(angle)


def look_up(at: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Columns (n, k) between their times (n,), at other times (m,), (m, k)."""
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)
