"""The compiled twin against the same Python run as it stands, one MjData at a time."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.rigs import Rig
from tests.twin.hover import assert_states
from tests.twin.plain import Inputs, fly_plain
from vpptwin.twin import Twin

ROWS, STEPS = 4, 60
KINDS = ("policy", "pitch", "speed", "throttle", "push", "cart", "cart pushed", "speed and throttle")
TOLERANCE = 1e-9
"""Share of the largest value of an array. They are bit-equal where numpy and the compiler call the same exp and sin;
elsewhere the last bit of these differs, 1e-16 in each step, which the rate loop's differentiator (1/dt) and a friction
that stops a joint within a step (another 1/dt) amplify by 1e3 to 1e6."""


@pytest.fixture(scope="module")
def twins(rigs: dict[str, Rig]) -> dict[str, Twin]:
    """Drone and cart with every effect on, at values drawn from the priors, some at off; kernels compile once."""
    made, rng = {}, np.random.default_rng(1)
    for name in ("flown", "cart"):
        catalogue = rigs[name].spec.catalogue
        made[name] = twin = rigs[name].twin(ROWS, {e.id: {} for e in catalogue})
        for effect in catalogue:
            for p in effect.parameters:
                twin.set_parameter(effect.id, p.name, np.where(rng.random(ROWS) < 0.2, p.off, p.draw(rng, ROWS)))
    return made


def draw_inputs(kind: str, nu: int, nv: int, rng: np.random.Generator) -> Inputs:
    """Inputs of one kind; commands change every 10 steps."""

    def hold(low: float, high: float) -> np.ndarray:
        return np.repeat(rng.uniform(low, high, (ROWS, STEPS // 10, nu)), 10, axis=1)

    if kind == "policy":
        return Inputs(STEPS, policy=rng.normal([5.0, 0.0], [2.0, 4.0], (ROWS, 2)))
    commands = hold(-2.0, 2.0) if kind.startswith("cart") else hold(-0.05, 0.18)
    return Inputs(
        STEPS,
        commands=commands,
        speed=hold(420, 520) if "speed" in kind else None,
        throttle=hold(0.2, 0.8) if "throttle" in kind else None,
        push=rng.normal(size=(ROWS, 7, nv)) if "push" in kind else None,
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("where", ["free", "at an end stop"])
def test_compiled_equals_plain(rigs: dict[str, Rig], twins: dict[str, Twin], kind: str, where: str) -> None:
    """With every effect on at random values, compiled and plain twin get to the same state in 60 steps."""
    name, rng = ("cart" if kind.startswith("cart") else "flown"), np.random.default_rng(KINDS.index(kind))
    rig, twin = rigs[name], twins[name]
    start = rig.start(twin, 3)
    if where == "at an end stop" and name == "flown":
        start.qpos[:, 0], start.qvel[:, 0] = 1.49, 0.5
        start.qpos[::2, 1], start.qvel[::2, 1] = 0.16, -0.5
        start.qpos[1, 2] = 1.5
    inputs = draw_inputs(kind, start.actuators["horn"].shape[1], start.qvel.shape[1], rng)
    after = inputs.fly(twin, start)
    assert_states(fly_plain(twin, start, inputs), after, TOLERANCE)
    assert np.abs(after.qpos - start.qpos).max() > 0.01
