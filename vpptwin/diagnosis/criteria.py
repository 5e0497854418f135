"""Every threshold that decides a verdict: what it is, in which unit, and where it comes from.

`diagnose(..., criteria=Criteria(named=0.2))` diagnoses under others; docs/criteria.md has all as a table, with what
halving and doubling them does (benchmarks/criteria.py). What only costs time or accuracy (steps of differences, bins,
iterations, how flights are cut) stays where it is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any


def declare(kind: str) -> Callable[[float, str, str, str], Any]:
    """How fields of one kind of origin are declared; units "" are shares, origins name commits and what they set."""

    def add(default: float, unit: str, meaning: str, origin: str) -> Any:  # noqa: ANN401 (as dataclasses.field)
        return field(default=default, metadata={"unit": unit, "meaning": meaning, "origin": f"{kind}: {origin}"})

    return add


assumed = declare("assumed")
"""A belief about rigs, before any data."""
proposed = declare("proposed")
"""By the study of this rig that the diagnosis was designed on; it does not ship."""
calibrated = declare("calibrated")
"""On sessions that are named."""
by_hand = declare("by hand")
"""While sessions with hidden effects were looked at: which is not on record, those of seed 8001 among them."""


# As a table.
# fmt: off
@dataclass(frozen=True)
class Criteria:
    """Thresholds of a diagnosis; `fields(Criteria)` tell unit, meaning and origin of each."""

    # Evidence: below which roughness no twin is believed, added to the sensors' noise.
    velocity_floor: float = assumed(0.02, "rad/s", "roughness of velocities: stick-slip that switches early", "85fc87b")
    specific_force_floor: float = assumed(0.1, "m/s²", "roughness of specific forces: vibration, blades", "85fc87b")
    rotor_speed_floor: float = assumed(0.3, "rad/s", "roughness of a motor's speed: 0.6 % of drag", "4221221")
    current_floor: float = assumed(0.05, "A", "roughness of a motor's current: 1 % of that in hover", "4221221")

    # Likelihood: what differs without blame.
    start_pose: float = assumed(0.02, "m", "prior of a window's starting pose, which it pins down itself", "85fc87b")
    start_angle: float = assumed(0.1, "rad", "the same of angles", "85fc87b")
    start_velocity: float = assumed(0.3, "m/s", "prior of a window's starting velocity", "85fc87b")
    start_rate: float = assumed(1.0, "rad/s", "the same of angular rates", "85fc87b")
    gust: float = assumed(1.0, "", "process noise, in multiples of what the robot states",
        "1 % of the drone's weight (85fc87b), 0.2 % of a typical force elsewhere (487b378)")
    least_gust: float = assumed(0.2, "", "bound of the gusts' strength, in multiples of what is assumed", "e1272d1")
    gust_doubt: float = assumed(2.0, "log", "standard deviation of the log of that strength", "e1272d1")
    tails: float = assumed(4.0, "", "degrees of freedom of Student's t, for every pulse, of the gusts of a window",
        "68f7aa5 for their strength, 8838ea8 for stronger ones where it is assumed")

    # Judgement: what becomes a cause.
    tolerances: float = by_hand(2.5, "tolerance", "by which a parameter must leave its nominal", "85fc87b")
    even: float = by_hand(0.02, "", "share by which an error ahead may grow",
        "tests allow no more since 85fc87b")
    block: float = by_hand(1.5, "s", "windows that count as one when errors are resampled", "e1272d1 (5 gust times)")

    # Rivals and confidence.
    temper: float = by_hand(1.5, "", "divides evidence before it becomes a probability: no noise model is exact",
        "4 at 85fc87b, 1.5 since e1272d1")
    suggested: float = assumed(0.89, "", "confidence at most while something material is unexplained", "aede6c2")
    named: float = assumed(0.1, "", "probability of a cause, or of its kind, below which the extended twin lacks it",
        "50287d2, as much as each of ten rivals that fit alike has")
    comes_again: float = calibrated(1.5, "", "waves along the way from which a force is cogging, not any of its place",
        "6c1d7bc, five seeds of other rigs, 13989 to 96897: six that were there have 2.1 to 12, three 0.8 to 1.0")
    sober: float = by_hand(0.5, "", "confidence left where half is unexplained, or errors grow",
        "e1272d1, b200008; 077fd87: of 19 causes that did harm, in eight seeds of other rigs, 7 were right")
    has_a_say: float = assumed(0.2, "", "standard error of the share of a force up to which inverse dynamics has a say",
        "4608193, rigs whose sensors are assumed; development seeds 701 to 720")
    sigmas_denied: float = assumed(3.0, "sigma", "by which a share must leave the next two to be denied", "4608193")
    least_seen: float = assumed(0.4, "", "share of a cause's force that inverse dynamics must see", "4608193")
    most_seen: float = assumed(2.5, "", "share of it that it may see at most", "4608193")
    obeyed: float = assumed(0.25, "", "share of what moves a joint below which logged inputs do not explain it",
        "98149db, a quadrotor's PWM at a fifth of its controller's rate")
    led: float = calibrated(0.6, "", "share of what turns a free body below which its attitude follows its log",
        "8838ea8: eight quadrotors of seed 37597 have 0.74 to 0.97, five flights of nanobench 0.17 to 0.34")
    late: float = assumed(0.01, "s", "by which a log's accelerations may be late", "4608193: a low pass at 16 Hz")
    distorted: float = assumed(0.03, "", "share by which they may be too small or too large", "4608193")
    blurred: float = assumed(0.7, "", "share of a force's square left in its mean over 75 ms; below, it is blurred",
        "4608193")
    unbalanced: float = assumed(1.5, "", "times the largest force that inputs, inertia and weight balance, for a cause",
        "4608193")
    inexact: float = calibrated(0.02, "", "error of the law of an effect, as a share of its strength",
        "sessions of seed 8001 at 99e2077: nine in ten 90 % intervals held the truth")
    inexact_friction: float = calibrated(0.05, "", "the same of laws of dry friction",
        "sessions of seed 8001 at 99e2077")

    # Leftover, power, the next experiment.
    longest_gust: float = assumed(1.0, "s", "over which gusts stay alike at most: what outlasts that is no gust",
        "caaeec4")
    storm: float = assumed(3.0, "gust", "strength at most by which a leftover is whitened", "681dcd4: 3 % of weight")
    gale: float = assumed(5.0, "gust", "strength from which a force that follows nothing is no weather indoors either",
        "681dcd4: 5 % of weight on one joint; gusts of proving/drone reach 6")
    followed: float = calibrated(5.5, "sigma", "by which a missing force must follow something to be no gust",
        "681dcd4, sessions of seeds 8001, 8100 to 8105 and 8203: 4.8 without, 6.2 with an effect")
    doubted: float = calibrated(3.5, "sigma", "the same from which a cause beside it is but suggested",
        "b6dc5e6, sessions of seeds 8001, 8100 to 8105")
    push: float = calibrated(0.25, "gust", "strength of it that must be predicted: tolerances make less",
        "caaeec4, sessions of seeds 8001, 8100 to 8105")
    channel_level: float = by_hand(1.6, "", "the same of a channel's whitened residual", "e1272d1")
    astray: float = by_hand(6.0, "median", "which a window's square counts at most there", "5844f9d")
    depends: float = by_hand(0.1, "", "share of a missing force that a quantity must predict to be named",
        "0.2 at 85fc87b, 0.1 since e1272d1")
    structure: float = by_hand(0.25, "", "the same for other rigs to have something unexplained", "85407b0")
    material: float = assumed(0.02, "", "share of what drives a joint from which an unexplained force matters",
        "aede6c2: gusts and bumps indoors are some 0.1 to 1 %")
    noticed: float = assumed(0.005, "", "the same of a force that follows something", "aede6c2")
    missed: float = assumed(4.0, "", "held-out chi² from which there is a gap, named cause or not: twice the noise",
        "aede6c2")
    matters: float = by_hand(0.05, "", "share of the missing force that must remain for it", "85407b0, 668e32f")
    missing_force: float = assumed(30.0, "gust", "prior of the force that is missing: any effect, bounded if unseen",
        "169bbb3")
    seen: float = by_hand(4.0, "sigma", "by which a typical size must stand out to be ruled out",
        "e1272d1; a family-wise 1 % over 44 effects would be 3.7 sigma")
    known_width: float = by_hand(0.5, "width", "of the range looked through that a parameter must be known to",
        "e1272d1")
    worth_flying: float = by_hand(1.0, "sigma", "that an experiment must separate", "ff3d8cb")

    # Blows: what contacts do, which they alone show.
    fewest_blows: int = assumed(6, "", "impacts below which contacts are not judged", "c68b8f3")
    by_chance: float = assumed(0.05, "", "odds at most against the named cause predicting impacts better", "c68b8f3")
    most_told: float = by_hand(3.0, "log odds", "that one impact gives at most: none decides alone", "aa5a677")
    eased: float = by_hand(0.2, "", "share of the error of impacts that a cause must explain", "c68b8f3")
    nothing_left: float = by_hand(1.5, "", "chi² of impacts, geometric mean, below which no contact is a candidate",
        "c68b8f3")


# fmt: on


CRITERIA = Criteria()
