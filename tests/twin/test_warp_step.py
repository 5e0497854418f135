"""Steps on Warp's processor device are those of numba, for every effect; in float32 within a running bound."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.twin import running_error
from tests.twin.running_error import Tracked, Undecided
from vpptwin.effects import Effect, Stage
from vpptwin.effects.base import Motion
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin, TwinState, load_twin
from vpptwin.twin.twin import MANY
from vpptwin.twin.warp.step import WarpStep, load_warp

CLOSE = 1e-12
SPAN = 64
"""Rows that are followed in float32."""


def list_devices() -> list[str]:
    """Warp's processor device, and a card where there is one."""
    try:
        return ["cpu", "cuda:0"] if load_warp().is_cuda_available() else ["cpu"]
    except InputError:
        return ["cpu"]


def launch(
    step: WarpStep, state: TwinState, command: np.ndarray, device: str = "cpu"
) -> tuple[TwinState, np.ndarray]:  # fmt: skip
    """A state after a control step on a device, and which rows have touched something."""
    wp = pytest.importorskip("warp")
    kind = wp.float32 if step.single else wp.float64
    tables = [
        wp.array(t, dtype=kind, device=device) for t in (step.pack_state(state), step.pack_numbers(), command.T.copy())
    ]
    touched = wp.zeros(len(command), dtype=wp.int32, device=device)
    wp.launch(step.kernel, dim=len(command), inputs=[*tables, touched], device=device)
    return step.unpack_state(tables[0].numpy()), touched.numpy()


@pytest.fixture(scope="module")
def twin() -> Twin:
    """The drone with all effects on: in each row one of them, in the last quarter of the rows all."""
    spec = load_twin("nominal")
    twin = Twin(spec, MANY, active=[effect.id for effect in spec.catalogue], num_threads=1)
    rng, rows = np.random.default_rng(0), np.arange(MANY)
    for i, effect in enumerate(twin.effects.values()):
        here = (rows % len(twin.effects) == i) | (rows >= 3 * MANY // 4)
        for p in effect.parameters:
            twin.set_parameter(effect.id, p.name, np.where(here, p.draw(rng, MANY), p.off).astype(np.float32))
    return twin


@pytest.fixture(scope="module")
def flight(twin: Twin) -> tuple[TwinState, np.ndarray]:
    """Where the rigs are, moving, a control step after the start; and a command for the next, (N, 2)."""
    rng, n = np.random.default_rng(1), twin.num_sims
    pose = np.column_stack([rng.uniform(-0.5, 0.5, n), rng.uniform(1.0, 1.5, n), rng.uniform(-3.0, 3.0, n)])
    commands = rng.uniform([0.0, -10.0], [20.0, 10.0], (2, n, 2)).astype(np.float32).astype(float)
    state = twin.step_policy(twin.initial_state(pose, rng.normal(size=(n, 3))), commands[0])
    arrays = {
        name: a if a.dtype.kind == "i" else a.astype(np.float32).astype(float) for name, a in state.arrays().items()
    }
    return TwinState.from_arrays(arrays), commands[1]


@pytest.mark.parametrize("device", list_devices())
def test_every_effect_equals_numba(twin: Twin, flight: tuple[TwinState, np.ndarray], device: str) -> None:
    """To 1e-12 of everything that evolves, over a control step of ten inner ones."""
    state, command = flight
    found, touched = launch(WarpStep(twin), state, command, device)
    expected = twin.step_policy(state, command)
    assert not touched.any()
    for name, values in expected.arrays().items():
        np.testing.assert_allclose(found.arrays()[name], values, rtol=CLOSE, atol=CLOSE, err_msg=name)
    nominal = Twin(twin.spec, MANY, num_threads=1).step_policy(state, command)
    rows = np.arange(MANY) < len(twin.effects)
    differ = np.abs(expected.qvel - nominal.qvel).max(axis=1) > 1e-9
    late = [e.id for e in twin.effects.values() if not differ[rows][list(twin.effects).index(e.id)]]
    assert len(late) < len(twin.effects) / 3, late  # sensors, ends of ranges, what takes longer to show


@pytest.mark.slow
def test_adaptive_controller_equals_numba(flight: tuple[TwinState, np.ndarray]) -> None:
    """What it learns too: a filter for each rotor, with branches, and parts of its memory that are copied."""
    twin = Twin(load_twin("nominal").with_controller("adaptive"), MANY, active=["servo.trim"], num_threads=1)
    twin.set_parameters([("servo.trim", p.name) for p in twin.effects["servo.trim"].parameters], 0.01)
    command = flight[1]
    state = twin.step_policy(twin.initial_state(), command)
    found, _ = launch(WarpStep(twin), state, command)
    for name, values in twin.step_policy(state, command).arrays().items():
        np.testing.assert_allclose(found.arrays()[name], values, rtol=CLOSE, atol=CLOSE, err_msg=name)


def test_contact_is_told(twin: Twin, flight: tuple[TwinState, np.ndarray]) -> None:
    """At the end of the rail a row stops where it is, and says so."""
    state, command = flight
    state = state.copy()
    state.qpos[3, 0], state.qvel[3, 0] = 1.499, 3.0
    _, touched = launch(WarpStep(twin), state, command)
    assert np.flatnonzero(touched).tolist() == [3]


@pytest.mark.slow
def test_it_compiles_for_a_card(tmp_path: Path) -> None:
    """Without one: Warp's compiler makes code for an H100 of it, in float32 alone but for sine and cosine."""
    wp = pytest.importorskip("warp")
    spec = load_twin("nominal")
    step = WarpStep(Twin(spec, 1, active=[e.id for e in spec.catalogue], num_threads=1), single=True)
    wp.compile_aot_module(step.kernel.module, arch=90, module_dir=tmp_path, use_ptx=True)
    (made,) = tmp_path.glob("*.ptx")
    code = made.read_text(errors="replace")
    assert "_kernel_forward" in code
    assert code.count("mul.f64") < 20


@pytest.mark.slow
@pytest.mark.parametrize("device", list_devices())
def test_float32_is_within_its_bound(twin: Twin, flight: tuple[TwinState, np.ndarray], device: str) -> None:
    """The kernel's own text, run on numbers that know their error, bounds what float32 makes of it in an inner step."""
    state, command = flight
    step = WarpStep(twin, steps=1, single=True)  # over ten, worst cases that never meet leave a bound that says little
    found, _ = launch(step, state, command, device)
    table = step.pack_state(found)
    names: dict[str, Any] = {"wp": running_error.warp, "Real": Tracked, "sign": running_error.sign,
                             "expm1": running_error.grow}  # fmt: skip
    body = step.source[step.source.index("    i = wp.tid()") :].replace("i = wp.tid()", "pass")
    exec("def fly(s, c, command, touched, i):\n" + body, names)
    start, numbers = step.pack_state(state), step.pack_numbers()
    followed, worst, moving = 0, 0.0, step.state["qvel"]
    for row in np.linspace(0, MANY - 1, SPAN).astype(int).tolist():
        s = {(k, 0): Tracked(value) for k, value in enumerate(start[:, row])}
        c = {(k, 0): Tracked(value) for k, value in enumerate(numbers[:, row])}
        try:
            names["fly"](s, c, {(k, 0): Tracked(v) for k, v in enumerate(command[row])}, [0], 0)
        except Undecided:
            continue
        followed += 1
        for (k, _), told in s.items():
            known = Tracked(told)
            assert abs(table[k, row] - known.value) <= known.error + running_error.SMALLEST, (k, row)
            if moving.start <= k < moving.stop:
                worst = max(worst, known.error / max(abs(known.value), 1.0))
    assert followed >= SPAN // 2
    assert worst < 1e-3  # a bound that says something


def add_roots(motion: Motion, /, force: float) -> float:
    """What numba takes and Warp has no word for."""
    return np.cbrt(force)


def wait(motion: Motion, /, force: float) -> float:
    """A loop whose length depends on a number that changes."""
    while force > 1.0:
        force = 0.5 * force
    return force


def own_effect(apply: Any) -> tuple[Twin, Effect]:  # noqa: ANN401
    """The drone with one effect, of one's own."""
    spec = load_twin("nominal")
    bias = next(effect for effect in spec.catalogue if effect.id == "rail_x.bias")
    effect = replace(bias, id="rail_x.own", apply=apply, stage=Stage.FORCE)
    twin = Twin(replace(spec, catalogue=(effect,)), 4, active=[effect.id], num_threads=1)
    twin.set_parameter(effect.id, "force", np.array([0.0, 0.1, 0.2, 0.3]))
    return twin, effect


@pytest.mark.parametrize(("apply", "line", "said"), [(add_roots, 3, "np.cbrt"), (wait, 3, "uses while")])
def test_what_warp_cannot_compile_is_told(apply: Any, line: int, said: str) -> None:  # noqa: ANN401
    """The effect, the line of the file, and the processor as the way out."""
    with pytest.raises(InputError) as caught:
        WarpStep(own_effect(apply)[0])
    where = apply.__code__.co_firstlineno + line - 1
    for part in ("rail_x.own", said, f"line {where} of {Path(__file__)}", "on the processor"):
        assert part in str(caught.value)


def test_warp_that_is_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the extra that brings it."""
    monkeypatch.setitem(__import__("sys").modules, "warp", None)
    with pytest.raises(InputError, match=r"needs warp.*pip install 'vpptwin\[gpu\]'"):
        _ = WarpStep(Twin(load_twin("nominal"), 1, num_threads=1)).kernel
