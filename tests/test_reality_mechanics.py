"""The independent simulation moves as mechanics says: fall, drag, sticking; twin/test_independent.py has the rest."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.reality.effects import Effects
from tests.reality.plant import Plant
from tests.reality.rig import Rig
from tests.reality.rotor import NODES, SUBSTEPS

WEIGHT = 4.905  # N, of craft and slider, 0.50 kg; with the carriage 0.58 kg move along x


def place(effects: Effects, state: list[float], free: bool = False) -> Plant:
    """One rig at x m, z m, theta rad and their rates."""
    return Plant(Rig([effects], [None], free), np.array(state[:3])[:, None], np.array(state[3:])[:, None])


def glide(effects: Effects, state: list[float], thrust: float, duration: float) -> np.ndarray:
    """Positions and velocities (steps + 1, 6) under a constant force along body z, N, without moment."""
    return push(place(effects, state), thrust, duration)


def push(plant: Plant, thrust: float, duration: float) -> np.ndarray:
    """Let a constant force along body z, N, act on a plant; its positions and velocities, (steps + 1, 6)."""
    thrusts = np.full((len(NODES), 2, 1), thrust / 2)
    path = [np.append(plant.position, plant.velocity)]
    for _ in range(round(duration * 1000)):
        plant.advance(thrusts, np.full_like(thrusts, 471.0), np.zeros((SUBSTEPS, 3, 1)))
        path.append(np.append(plant.position, plant.velocity))
    return np.array(path)


def test_thrown_craft_follows_the_parabola() -> None:
    """Without thrust and effects the craft falls freely, spins evenly and keeps its energy."""
    path = glide({}, [-0.5, 1.0, 0.3, 0.6, 3.0, 4.0], 0.0, 0.5)
    time = np.arange(len(path)) * 0.001
    np.testing.assert_allclose(path[:, 0], -0.5 + 0.6 * time, atol=1e-12)
    np.testing.assert_allclose(path[:, 1], 1.0 + 3.0 * time - 4.905 * time**2, atol=1e-12)  # midpoint rule: exact
    np.testing.assert_allclose(path[:, 2], 0.3 + 4.0 * time, atol=1e-12)
    energy = 0.5 * 0.5 * path[:, 4] ** 2 + 0.5 * 9.81 * path[:, 1]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-12)


@pytest.mark.parametrize(
    ("effects", "terminal"),
    [
        ({"rail_z.viscous": {"damping": 10.0}}, WEIGHT / 10.0),  # b v = m g
        ({"air.drag": {"k_d": 20.0}}, math.sqrt(WEIGHT / 20.0)),  # k_d v^2 = m g
        ({"rail_z.coulomb": {"force": 1.0}, "rail_z.viscous": {"damping": 10.0}}, 3.905 / 10.0),
    ],
)
def test_terminal_velocity(effects: Effects, terminal: float) -> None:
    """A falling craft reaches the speed at which its drag carries its weight."""
    path = glide(effects, [0.0, 2.0, 0.0, 0.0, 0.0, 0.0], 0.0, 1.5)
    assert path[-1, 4] == pytest.approx(-terminal, rel=1e-6)


@pytest.mark.parametrize("effect", [{"rail_x.coulomb": {"force": 0.3}}, {"rail_x.stiction": {"force": 0.3}}])
def test_below_breakaway_nothing_moves(effect: Effects) -> None:
    """A slider pushed with 97 % of breakaway stands exactly still, and creeps off at 103 %."""
    for share, stays in ((0.97, True), (1.03, False)):
        side = 0.3 * share
        angle = -math.atan2(side, WEIGHT)  # thrust carries the weight and pushes aside
        path = glide(effect, [0.1, 1.0, angle, 0.0, 0.0, 0.0], math.hypot(side, WEIGHT), 1.0)
        assert (np.ptp(path[:, 0]) == 0.0) == stays
