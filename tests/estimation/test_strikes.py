"""When a rig strikes something, by its poses."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from proving.drone import fly_policy, write_mcap
from proving.drone.flight import FlightPlan
from proving.policy_flights import load_flyer
from vpptwin.estimation.gaps import usable_starts
from vpptwin.estimation.measurements import read_measurements
from vpptwin.estimation.series import Measurements, Series
from vpptwin.estimation.strikes import find_strikes, mark_strikes
from vpptwin.logs.read import read_flight
from vpptwin.twin import load_twin

NOISE, TIME = 5e-4, np.arange(0.0, 20.0, 0.008)
STOPPED = '<joint name="lift" type="slide" axis="0 0 1" range="0 9"/><geom size="0.1" contype="0" conaffinity="0"/>'
FALLS = '<joint name="lift" type="slide" axis="0 0 1"/><geom size="0.1"/>'
FLOOR = '<geom name="floor" type="plane" size="1 1 1"/>'
BAR = '<joint name="lift" type="slide" axis="0 0 1"/><joint name="tilt" axis="0 1 0"/>' + (
    '<geom type="capsule" size="0.1" fromto="-1 0 0 1 0 0"/>'
)


def model_of(body: str) -> mujoco.MjModel:
    """A rig of one body over a floor."""
    return mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{FLOOR}<body>{body}</body></worldbody></mujoco>")


def measure(*tracks: np.ndarray, noise: float = NOISE) -> Measurements:
    """Positions with noise."""
    rng = np.random.default_rng(1)
    seen = {i: Series("", "m", TIME, t + noise * rng.standard_normal(len(t)), NOISE) for i, t in enumerate(tracks)}
    command = Series("", "", TIME, np.zeros((len(TIME), 0)), 0.0)
    return Measurements("log", seen, {}, None, command, None, (), float(TIME[0]), float(TIME[-1]))


def bounce(time: np.ndarray, at: float = 8.0) -> np.ndarray:
    """Falls by 2 m/s for a second, and rises as long by 0.8 m/s from a blow at that time on."""
    return np.where(time < at, 2.0 * np.minimum(at - time, 1.0), 0.8 * np.minimum(time - at, 1.0))


@pytest.mark.parametrize(
    ("body", "height", "what"), [(STOPPED, 0.0, "the end stop of lift"), (FALLS, 0.1, "floor")], ids=["stop", "floor"]
)
def test_a_blow_is_found_and_named(body: str, height: float, what: str) -> None:
    """At 8 s, whether an end stop deals it or a floor 0.1 m below the middle of a ball; no window touches it."""
    measured = measure(height + bounce(TIME))
    spans, told, _ = find_strikes(model_of(body), measured)
    assert len(spans) == 1
    assert spans[0] == pytest.approx([8.0, 8.0], abs=0.06)
    assert spans[0, 0] < 7.99
    assert spans[0, 1] > 8.01
    assert told == [f"impacts on {what} at 8.0 s: windows there are left out"]
    usable = usable_starts(replace(measured, strikes=spans), np.array([7.0, 7.7, 7.9, 8.1, 8.3]), 0.3)
    assert usable.tolist() == [True, False, False, False, True]


def test_the_tip_of_a_bar_strikes_where_its_middle_does_not() -> None:
    """A bar of half length 1 m, 0.5 m up, turns by 1 rad/s: its tip of radius 0.1 m is at 0.1 m at 0.41 rad."""
    tilt = np.minimum(np.maximum(TIME - 5.0, 0.0), np.arcsin(0.4))
    spans, *_ = find_strikes(model_of(BAR), measure(np.full(len(TIME), 0.5), tilt))
    assert len(spans) == 1
    assert spans[0].mean() == pytest.approx(5.0 + np.arcsin(0.4), abs=0.03)


@pytest.mark.parametrize(
    "height",
    [
        np.zeros(len(TIME)),
        0.05 + 0.04 * np.cos(4.0 * TIME),
        np.interp(TIME, [0.0, 5.0, 6.0, 20.0], [1.0, 1.0, 0.0, 0.0]) ** 4,
        np.abs(np.sin(4.0 * TIME)),
    ],
    ids=["rests", "turns before", "lands softly", "bounces all the time"],
)
def test_all_else_is_no_strike(height: np.ndarray) -> None:
    """What rests on a stop, comes near it or comes to rest there; and what a rig does all the time is its motion."""
    assert find_strikes(model_of(STOPPED), measure(height))[1] == []


@pytest.mark.parametrize(
    ("body", "tracks"),
    [("<freejoint/><geom size='0.1'/>", 6), (BAR, 1), (STOPPED.replace('range="0 9"', ""), 1)],
    ids=["it flies freely", "a joint is not known", "nothing stops it"],
)
def test_nothing_is_found_where_nothing_tells(body: str, tracks: int) -> None:
    """Of free bodies, of rigs of which a joint is not measured, and where there is nothing to strike."""
    assert len(find_strikes(model_of(body), measure(*[bounce(TIME)] * tracks))[0]) == 0


STARTS = {
    "floor": (0.0, 0.6, 0.8, 0.0, -6.0, 0.0),
    "the end stop of rail_z": (0.0, 1.8, 0.0, 0.0, 6.0, 0.0),
    "wall": (0.8, 1.5, 0.0, 6.0, 0.0, 0.0),
}
"""What a craft is thrown at, and from where: x, z [m], θ [rad] and their rates."""


def touches(pose: np.ndarray) -> np.ndarray:
    """Whether the craft of proving/drone is inside of floor, wall or an end stop at poses (n, 3), (n,) bool."""
    x, z, theta = pose.T
    low, far = z - 0.2 * np.abs(np.sin(theta)), x + 0.2 * np.abs(np.cos(theta))
    return (low < 0.015) | (far > 1.685) | (np.abs(x) > 1.5) | (z < 0.15) | (z > 2.5)


def test_crashes_of_the_independent_simulation_are_found(tmp_path_factory: pytest.TempPathFactory) -> None:
    """A craft thrown at floor, stop and wall: spans hold every blow of its true motion, and little else."""
    policy, _ = load_flyer("flip")
    plans: list[FlightPlan] = [
        {"manoeuvre": "flip", "duration": 6.0, "seed": 11 + i, "initial": start}
        for i, start in enumerate(STARTS.values())
    ]
    targets = np.tile([0.0, 1.3, 0.0], (len(plans), 601, 1))
    for what, flight in zip(STARTS, fly_policy(policy, targets, plans)):
        log = write_mcap(flight, tmp_path_factory.mktemp("crash") / "0.mcap")
        measured = mark_strikes(load_twin().model, read_measurements(load_twin(), read_flight(log)))
        assert what in measured.warnings[-1]
        blows = 1e-3 * np.flatnonzero(touches(flight.truth["position"]))
        assert len(blows)
        assert np.ptp(measured.strikes, axis=1).sum() < 1.0
        for blow in blows:
            assert np.any((measured.strikes[:, 0] <= blow) & (blow <= measured.strikes[:, 1])), (what, blow)
