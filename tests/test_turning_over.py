"""Flights that turn over, by the policy that ships: what pushes along thrust changes sign there, and is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proving.drone import Wind, fly_policy, write_mcap
from proving.drone.flight import FlightPlan
from proving.policy_flights import draw_targets, load_flyer
from proving.sessions import Effects, Flown, diagnose_session, find_faults, read_seed

DURATION = 20.0  # s


def fly_flips(hidden: Effects, seed: int, folder: Path) -> Flown:
    """Two flights of one rig that flip and hover either way up, gusts, noise and distractors on.

    With rotors so weak one pair in seven strikes floor, wall or a stop: that must not hide anything.
    """
    policy, task = load_flyer("flip")
    rng, task = np.random.default_rng([seed, 5]), replace(task, episode=DURATION)
    rig, targets = int(rng.integers(2**31)), np.stack([draw_targets(task, rng)[0] for _ in range(2)])
    plans: list[FlightPlan] = [
        {"effects": hidden, "manoeuvre": "flip", "duration": DURATION, "seed": rig + 1 + i, "session": rig,
         "distractors": True}
        for i in range(2)
    ]  # fmt: skip
    logs = [write_mcap(flight, folder / f"{i}.mcap") for i, flight in enumerate(fly_policy(policy, targets, plans))]
    return Flown(hidden, {}, Wind(), rig, logs, f"VPPTWIN_SEED={read_seed()} pytest tests/test_turning_over.py")


@pytest.mark.slow
def test_an_asymmetry_of_either_sign_is_named_beside_weak_rotors(tmp_path: Path) -> None:
    """Drawn: rotors that lack a tenth of their thrust and differ by a tenth. Both are named, with their sizes.

    The moment of the difference is pitch's, as the pulses are about which flights are linearised: no twin feels it
    twice, upright or inverted.
    """
    rng = np.random.default_rng([read_seed(), *b"turning over"])
    hidden = {
        "rotor.thrust_gain": {"gain": float(rng.uniform(0.85, 0.9))},
        "rotor.asymmetry": {"fraction": float(rng.choice((-1.0, 1.0)) * rng.uniform(0.05, 0.08))},
    }
    session = diagnose_session(fly_flips(hidden, read_seed(), tmp_path))
    if faults := find_faults(session):
        pytest.fail("\n".join([*faults, session.story]))
