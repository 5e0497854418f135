"""The scripted pilot: hovers where it is told, upright and inverted, and flips between the two."""

from __future__ import annotations

import numpy as np

from vpptwin.robots.planar_drone.pilot import Script, pilot_commands
from vpptwin.twin import Twin, load_twin


def test_a_target_holds_until_the_next() -> None:
    """At the very time of a target it is the one that counts; before the first, the first does."""
    script = Script(np.array([0.0, 1.0]), np.array([[0.0, 1.0, 0.0], [0.5, 1.5, np.pi]]))
    np.testing.assert_array_equal(script.at(-1.0), script.target[0])
    np.testing.assert_array_equal(script.at(0.999), script.target[0])
    np.testing.assert_array_equal(script.at(1.0), script.target[1])


def test_commands_stay_within_the_vehicle() -> None:
    """From any state the pilot asks for no more than the vehicle's largest thrust and rate."""
    vehicle = load_twin().vehicle
    assert vehicle is not None
    rng = np.random.default_rng(4)
    commands = pilot_commands(vehicle, rng.uniform(-4, 4, (500, 3)), rng.uniform(-9, 9, (500, 3)), np.zeros(3))
    limit = np.array([vehicle.control.thrust_max, vehicle.control.rate_max])
    assert (np.abs(commands) <= limit).all()
    assert (np.abs(commands) == limit).any(axis=0).all()


def test_it_hovers_flips_and_hovers_inverted() -> None:
    """After 3 s the craft is within 2 cm and 0.1 rad of its target, three targets in a row, two of them flips."""
    twin = Twin(load_twin(), 1)
    state = twin.initial_state(np.array([-0.4, 1.2, 0.3]))
    for target in ([0.2, 1.4, 0.0], [0.2, 1.5, np.pi], [-0.3, 1.5, 0.0]):
        lowest = np.inf
        for _ in range(300):
            state = twin.step_policy(state, pilot_commands(twin.vehicle, state.qpos, state.qvel, np.array(target)))
            lowest = min(lowest, float(state.qpos[0, 1]))
        assert np.abs(state.qpos[0] - target)[:2].max() < 0.02
        assert abs(state.qpos[0, 2] - target[2]) < 0.1
        assert lowest > 0.3  # m, above the lower stop at 0.15
