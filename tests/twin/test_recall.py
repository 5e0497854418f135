"""What evolves of effects, run alone along a motion that is known, is what it was as the twin moved."""

from __future__ import annotations

import numpy as np
import pytest

from tests.twin.hover import make_twin
from tests.twin.test_flex import BRISTLES, MODE, draw_pushes
from tests.twin.test_friction import Effects, level_poses
from vpptwin.twin import Twin
from vpptwin.twin.stepping.recall import Past

PUSHES = np.zeros((4, 50, 3))
PUSHES[..., 0] = draw_pushes()
LEAD = 100
"""Steps before the end that are known apart from the rest."""
TRACK = ("qpos", "qvel")


def fly_along(twin: Twin, sim: int) -> tuple[Past, np.ndarray]:
    """A simulation's way under random pushes, as two flights of half a second, and its states at their ends."""
    start = twin.initial_state(qpos=level_poses(4))
    steps, paths = 500, []
    for half in (PUSHES[:, :25], PUSHES[:, 25:]):
        flown = twin.replay_commands(start, np.zeros((4, steps, 2)), disturbance=half)
        paths.append([np.concatenate([getattr(start, n)[:, None], getattr(flown, n)], axis=1)[sim] for n in TRACK])
        paths[-1].append(flown.state.effects[sim])
    qpos, qvel, ends = (np.array(each) for each in zip(*paths))
    first = np.tile(np.arange(steps + 1) == 0, 2)
    stops = (steps - LEAD) + (steps + 1) * np.arange(2)
    lead = [track[:, steps - LEAD :] for track in (qpos, qvel)]
    time = np.tile(twin.dt * np.arange(steps + 1), 2)
    return Past(time, qpos.reshape(-1, 3), qvel.reshape(-1, 3), first, stops, *lead), ends


@pytest.mark.parametrize("effects", [BRISTLES, MODE], ids=["lugre", "mode"])
def test_states_are_those_of_the_flight(effects: Effects) -> None:
    """In each of two flights, which start at rest, bristles and mode end where the twin's own did, to rounding."""
    twin = make_twin(4, effects)
    for sim in range(4):
        past, ends = fly_along(twin, sim)
        rest = twin.initial_state(past.lead_qpos[:, -1], past.lead_qvel[:, -1], ids=np.arange(2)).effects
        found = rest + twin.recall_effects(past, np.array([sim]))[0]
        assert np.abs(ends - rest).max() > 1e-5  # m, m/s: something has bent or swings
        np.testing.assert_allclose(found, ends, rtol=0, atol=1e-12)


def test_order_of_windows_is_kept() -> None:
    """Windows may come in any order, and several simulations are run side by side."""
    twin = make_twin(4, MODE)
    past, _ = fly_along(twin, 1)
    turned = past._replace(stops=past.stops[::-1], lead_qpos=past.lead_qpos[::-1], lead_qvel=past.lead_qvel[::-1])
    both = twin.recall_effects(past, np.array([0, 1])), twin.recall_effects(turned, np.array([0, 1]))
    np.testing.assert_array_equal(both[0], both[1][:, ::-1])
    np.testing.assert_array_equal(both[0][1:], twin.recall_effects(past, np.array([1])))
