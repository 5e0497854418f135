"""The worlds: simulations of their own, from which sessions are drawn.

None shares physics with an entrant: they integrate their own equations of motion (Pinocchio's for arms), with friction,
drives and sensors of their own. In a session one thing is wrong with the nominal model, or nothing; in `pairs` two are.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from proving import quadrotor, servo_arm, servo_leg
from proving.simgap.causes import Deal, Made
from proving.simgap.crafts import draw_craft, draw_drone
from proving.simgap.jointed import draw_rig
from proving.simgap.scores import NOTHING, UNKNOWN

DECK = ("single",) * 8 + (NOTHING,) * 2 + (UNKNOWN,) * 2
"""Kinds of twelve sessions in a row, in a new order each time."""


def draw_session(world: str, seed: int, number: int) -> Made:
    """The session of that number: what entrants get, its logs, and the truth.

    Raises:
        ValueError: where there is no such world.
    """
    if world not in WORLDS:
        raise ValueError(f"no world {world}: there are {', '.join(WORLDS)}")
    place, (block, card) = zlib.crc32(world.encode()), divmod(number, len(DECK))
    deck = np.random.default_rng([seed, place, 1, block]).permutation(np.array(DECK))
    kind = str(deck[card])
    turn = block * DECK.count(kind) + int(np.sum(deck[:card] == kind))

    def deal(pool: Sequence[str]) -> str:
        """One of a pool; all take turns."""
        order = np.random.default_rng([seed, place, 3, turn // len(pool)]).permutation(np.array(sorted(pool)))
        return str(order[turn % len(pool)])

    session, logs, truth = WORLDS[world](np.random.default_rng([seed, place, 2, number]), number, kind, deal)
    salt = hashlib.sha256(f"simgap {seed} {world} {number}".encode()).hexdigest()
    return replace(session, name=f"{world}-{number:04d}"), logs, replace(truth, salt=salt)


WORLDS: dict[str, Callable[[np.random.Generator, int, str, Deal], Made]] = {
    "drones": draw_drone,
    "carts": partial(draw_rig, families=("carriage", "damped cart")),
    "pendula": partial(draw_rig, families=("pendulum",)),
    "cart-poles": partial(draw_rig, families=("cart-pole",)),
    "double-pendula": partial(draw_rig, families=("double pendulum",)),
    "arms": partial(draw_rig, families=("arm",)),
    "servos": partial(
        draw_craft, mjcf=servo_arm.MJCF, spans=servo_arm.SPANS, make=servo_arm.move, seconds=12.0,
        off={"stiffness": 1.0, "limit": 1.0}, units=dict.fromkeys(servo_arm.JOINTS, "rad"),
    ),
    "legs": partial(
        draw_craft, mjcf=servo_leg.MJCF, spans=servo_leg.SPANS, make=servo_leg.move, seconds=12.0,
        off={"stiffness": 1.0, "limit": 1.0}, units=dict.fromkeys(servo_leg.JOINTS, "rad"),
    ),
    "quadrotors": partial(
        draw_craft, mjcf=quadrotor.MJCF, spans=quadrotor.SPANS, make=quadrotor.fly, seconds=10.0,
        off={"gain": 1.0, "time_constant": quadrotor.LAG}, units=dict.fromkeys("xyz", "m"),
        known={"m1+m2+m3+m4.lag": quadrotor.LAG},
    ),
    "pairs": partial(draw_rig, families=("carriage", "damped cart", "cart-pole", "double pendulum"), many=2),
    "watched": partial(draw_rig, families=("carriage", "damped cart", "cart-pole", "double pendulum"), watch=True),
}  # fmt: skip
"""Name → what draws a session."""
