"""Steps by mujoco_warp on Warp's processor device are those of numba in MuJoCo, within what float32 makes of them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vpptwin.effects import Stage
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin, TwinSpec, TwinState, load_twin
from vpptwin.twin.warp.mujoco import WarpMujoco
from vpptwin.twin.warp.step import load_warp

pytest.importorskip("mujoco_warp")
EPS = float(np.finfo(np.float32).eps)
ROUNDINGS = 64
"""Depth of an inner step: sums and products between a number and what comes of it."""
SHAKEN = 0.5 * np.sqrt(ROUNDINGS)
"""Units in the last place by which they are off together, at most half of one each and of either sign."""
COPIES = 15
BEYOND = 2.0
"""How much further than the farthest copy: where a joint sticks or slips a step later, or a wall is hit, all are off
alike, and the farthest copy is no farther than float32."""
Advance = Callable[[Twin, TwinState, np.ndarray, int], TwinState]
TREE = """<mujoco><option timestep="0.001" cone="elliptic"/>
<worldbody><geom type="plane" size="5 5 0.1"/>
<body name="cart" pos="0 0 1"><joint name="rail" type="slide" axis="1 0 0"/><geom size="0.05" mass="1"/>
<body name="arm" pos="0 0.2 0"><joint name="arm" type="hinge" axis="0 1 0"/><geom type="capsule" size="0.02"
fromto="0 0 0 0 0 -0.3" mass="0.3"/><body name="bob" pos="0 0 -0.3"><joint name="swivel" type="ball"/>
<geom size="0.03" pos="0 0 -0.1" mass="0.2"/></body></body>
<body name="leg" pos="0 -0.2 0"><joint name="leg" type="hinge" axis="0 1 0"/><geom type="capsule" size="0.02"
fromto="0 0 0 0 0 -0.3" mass="0.3"/></body></body>
<body name="ball" pos="0 1 0.2"><freejoint/><geom size="0.1" mass="0.5"/></body></worldbody>
<equality><connect body1="ball" anchor="0 0.4 0.05"/></equality>
<tendon><fixed name="cable"><joint joint="rail" coef="1"/><joint joint="arm" coef="0.2"/></fixed></tendon>
<actuator><motor name="winch" tendon="cable"/><position name="servo" joint="leg" kp="5" kv="0.2"/></actuator>
</mujoco>"""
SIGNALS = """model: tree.xml
signals:
  joints: {rail: /joint_states, arm: /joint_states, leg: /joint_states, swivel: /bob}
  bodies: {ball: /ball}
  actuators: {winch: /motors, servo: /motors}
"""


def draw_parameters(twin: Twin, more: Twin, size: float, rng: np.random.Generator) -> None:
    """Every effect in every simulation, by a share of what is drawn, and again and again in a twin of more."""
    for effect in twin.effects.values():
        for p in effect.parameters:
            values = (p.off + size * (p.draw(rng, twin.num_sims) - p.off)).astype(np.float32)
            for each in (twin, more):
                each.set_parameter(effect.id, p.name, np.tile(values, each.num_sims // twin.num_sims))


def shake(state: TwinState, rng: np.random.Generator) -> None:
    """Let every number be off by as much as an inner step in float32 may make it."""
    for array in state.arrays().values():
        if array.dtype.kind == "f":
            array *= 1.0 + SHAKEN * EPS * rng.uniform(-1.0, 1.0, array.shape)


def find_shares(
    spec: TwinSpec, start: Callable[[Twin], TwinState], commands: np.ndarray, advance: Advance, size: float = 1.0,
    without: tuple[Stage, ...] = (),
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """How far float32 is off after each control step, as a share of what rounding explains, (steps, 2, N).

    Also how far commands are in the end that are off by a thousandth, (2, N), and what was touched, (N,).

    What rounding explains is what it makes of the twin itself: twice the largest deviation so far among copies that
    are shaken before every inner step, of all positions and of all velocities of a simulation.

    Args:
        spec: the rig.
        start: where simulations start.
        commands: held for ten inner steps each, (steps, N, nu).
        advance: steps a twin's state under commands (N, nu) for a number of inner steps.
        size: of the effects, as a share of what is drawn from their priors.
        without: stages whose effects are left out.
    """
    wp, rng, n = load_warp(), np.random.default_rng(0), commands.shape[1]
    active = [e.id for e in spec.catalogue if e.stage not in without and not (without and e.touching)]
    twin, more = (Twin(spec, k * n, active, num_threads=1) for k in (1, COPIES))
    draw_parameters(twin, more, size, rng)
    state = wrong = start(twin)
    shaken = state.take(np.tile(np.arange(n), COPIES))
    step = WarpMujoco(twin)
    numbers, table, command = (
        wp.array(np.ascontiguousarray(a), dtype=wp.float32)
        for a in (step.pack_numbers(), step.pack_state(state), commands[0].T)
    )
    recorded = step.record(table, numbers, command, wp.zeros(n, dtype=wp.int32))
    shares, touched, largest = [], np.zeros(n, bool), np.zeros((2, n))
    for given in commands:
        wp.copy(command, wp.array(np.ascontiguousarray(given.T), dtype=wp.float32))
        recorded.launch()
        state, wrong = (advance(twin, s, k * given, 10) for s, k in ((state, 1.0), (wrong, 1.001)))
        for _ in range(10):
            shake(shaken, rng)
            shaken = advance(more, shaken, np.tile(given, (COPIES, 1)), 1)
        found, deviations = step.unpack_state(table.numpy()), []
        for k, name in enumerate(("qpos", "qvel")):
            expected = getattr(state, name)
            copies = getattr(shaken, name).reshape(COPIES, n, -1)
            largest[k] = np.maximum(largest[k], np.abs(copies - expected).max(axis=(0, 2)))
            deviations.append(np.abs(getattr(found, name) - expected).max(axis=1))
        shares.append(np.array(deviations) / (BEYOND * largest))
        touched |= (state.memory[:, 2:] != 0.0).any(axis=1)
    ends = [np.abs(getattr(wrong, name) - getattr(state, name)).max(axis=1) for name in ("qpos", "qvel")]
    return np.array(shares), np.array(ends) / (BEYOND * largest), touched


def to_single(values: np.ndarray) -> np.ndarray:
    """Numbers that float32 holds."""
    return values.astype(np.float32).astype(float)


@pytest.mark.slow
@pytest.mark.parametrize("without", [(), (Stage.SLIP,)], ids=["all effects", "sticking friction"])
def test_drone_at_the_wall_equals_numba(without: tuple[Stage, ...]) -> None:
    """An open-loop second with every effect drawn, half of the rigs thrown at the wall, within rounding; as is a step.

    Where friction slips by a law of its own, nothing sticks.
    """
    n, rng = 16, np.random.default_rng(1)

    def start(twin: Twin) -> TwinState:
        pose = rng.uniform([-0.5, 1.0, -0.5], [0.5, 1.5, 0.5], (n, 3))
        velocity = rng.normal(0.0, 0.5, (n, 3))
        pose[::2, 0], velocity[::2, 0] = rng.uniform(1.2, 1.4, n // 2), rng.uniform(1.0, 2.0, n // 2)
        return twin.initial_state(to_single(pose), to_single(velocity))

    def advance(twin: Twin, state: TwinState, command: np.ndarray, steps: int) -> TwinState:
        return twin.step_policy(state, command, steps * twin.dt)

    commands = to_single(rng.normal([4.9, 0.0], [1.0, 2.0], (100, n, 2)))
    shares, wrong, touched = find_shares(load_twin("nominal"), start, commands, advance, without=without)
    assert shares.max() <= 1.0, shares.max(axis=(0, 1))
    assert (wrong[:, ~touched] > 1.0).all(), wrong  # what hits the wall may hit it a step earlier or later
    assert touched[::2].mean() > 0.5
    assert not touched.all()


@pytest.mark.slow
def test_any_tree_equals_numba(tmp_path: Path) -> None:
    """Ball and free joints, an equality, a tendon, a servo, contact and friction that sticks, for 0.3 s."""
    (tmp_path / "tree.xml").write_text(TREE)
    (tmp_path / "tree.yaml").write_text(SIGNALS)
    n, rng = 8, np.random.default_rng(2)

    def start(twin: Twin) -> TwinState:
        velocity = rng.normal(0.0, 0.5, (n, int(twin.model.nv)))
        return twin.initial_state(qvel=to_single(velocity))

    def advance(twin: Twin, state: TwinState, command: np.ndarray, steps: int) -> TwinState:
        return twin.replay_commands(state, np.repeat(command[:, None], steps, axis=1)).state

    commands = to_single(rng.normal(0.0, [1.0, 0.3], (30, n, 2)))
    shares, _, touched = find_shares(load_twin(tmp_path / "tree.yaml"), start, commands, advance, 0.25, (Stage.SLIP,))
    assert shares.max() <= 1.0, shares.max(axis=(0, 1))
    assert touched.all()


def test_mujoco_warp_that_is_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """With what needs it, and the extra that brings it."""
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    with pytest.raises(InputError, match=r"touches something needs mujoco_warp.*pip install 'vpptwin\[gpu\]'"):
        WarpMujoco(Twin(load_twin("nominal"), 1, num_threads=1))
