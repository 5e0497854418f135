"""Effects as Warp functions return what numba makes of them, and what Warp cannot compile is told by line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from tests.effects.test_compile import COUNT, EVERY_STEP, call_one_by_one, draw_inputs, draw_parameters
from tests.twin.running_error import SMALLEST, Tracked, pick_tracked
from vpptwin.effects import CATALOGUE, Effect, Stage
from vpptwin.effects.base import Craft, Motion, Rotor
from vpptwin.errors import InputError
from vpptwin.twin import TwinSpec, load_twin
from vpptwin.twin.pipeline import Pipeline, function_name, write_pipeline
from vpptwin.twin.warp_text import SEEN, run_text, write_warp

DRONE = [e for e in CATALOGUE if e in EVERY_STEP]
MOST = 20
"""Numbers that go into an effect, and at most four come out."""
CLOSE = 1e-12
CHAIN_KERNEL = """

@wp.kernel
def chain(on: wp.array(dtype=wp.bool), p: wp.array(dtype=Real), s: wp.array(dtype=Real), rotor: Rotor, craft: Craft,
          results: wp.array(dtype=Real)):
    results[0] = shape_thrust(on, p, s, Real(3.0), rotor, Real(0.001))
    f_x, f_z, moment = push_craft(on, p, s, craft, Real(0.001))
    results[1] = f_x
    results[2] = f_z
    results[3] = moment
"""


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> TwinSpec:
    """The drone on its rig."""
    file = tmp_path_factory.mktemp("warp") / "rig.yaml"
    file.write_text("model: rail_rig.xml\nvehicle: vehicle.yaml\n")
    return load_twin(file)


@pytest.fixture(scope="module")
def pipeline(spec: TwinSpec) -> Pipeline:
    """Its effects as a page of Python."""
    return write_pipeline(spec.model, spec.catalogue)


def write_call(effect: Effect, i: int) -> list[str]:
    """The lines of a kernel that call effect i with row i of numbers and write down what it returns."""
    seen = "Motion" if effect.target or effect.stage in (Stage.FRICTION, Stage.SLIP) else "Craft"
    kinds = {
        Stage.FORCE: [seen], Stage.FRICTION: ["", "Motion"], Stage.SLIP: ["Motion", "", ""],
        Stage.THRUST: ["", "Rotor"],
    }[effect.stage]  # fmt: skip
    lines, given, column = [f"    if i == {i}:"], [], 0
    for kind in kinds + [""] * (len(effect.states) + bool(effect.states) + len(effect.parameters)):
        if kind:
            lines.append(f"        thing_{i} = {kind}()")
            for name in SEEN[kind]._fields:
                lines.append(f"        thing_{i}.{name} = numbers[i, k, {column}]")
                column += 1
            given.append(f"thing_{i}")
        else:
            given.append(f"numbers[i, k, {column}]")
            column += 1
    count = len(effect.states) + (3 if effect.stage is Stage.FORCE and not effect.target else 1)
    names = [f"out_{i}_{j}" for j in range(count)]
    lines.append(f"        {', '.join(names)} = {function_name(effect)}({', '.join(given)})")
    return lines + [f"        results[i, k, {j}] = {name}" for j, name in enumerate(names)]


def call_on_warp(pipeline: Pipeline, numbers: np.ndarray, single: bool) -> np.ndarray:
    """What all effects return, (effects, COUNT, 4), in one kernel of one module."""
    wp = pytest.importorskip("warp")
    wp.config.quiet = True
    array = "wp.array3d(dtype=Real)"
    kernel = ["@wp.kernel", f"def call(numbers: {array}, results: {array}):", "    i, k = wp.tid()"]
    text = "\n".join([write_warp(pipeline), *kernel, *(line for i, e in enumerate(DRONE) for line in write_call(e, i))])
    names = run_text(text + "\n", single)
    given = wp.array(numbers, dtype=names["Real"], device="cpu")
    results = wp.zeros((len(DRONE), COUNT, 4), dtype=names["Real"], device="cpu")
    wp.launch(names["call"], dim=(len(DRONE), COUNT), inputs=[given, results], device="cpu")
    return np.asarray(results.numpy(), dtype=float)


@pytest.fixture(scope="module", params=[False, True], ids=["float64", "float32"])
def case(request: pytest.FixtureRequest, pipeline: Pipeline) -> tuple[bool, list[Any], np.ndarray]:
    """Whether in float32, what each effect is called with, and what Warp returns."""
    drawn, numbers = [], np.zeros((len(DRONE), COUNT, MOST))
    for i, effect in enumerate(DRONE):
        rng = np.random.default_rng(i)
        inputs, parameters = draw_inputs(effect, rng), draw_parameters(effect, rng)
        columns = [f for given in inputs for f in (given if isinstance(given, tuple) else (given,))] + parameters
        if request.param:
            for column in columns:
                column[:] = column.astype(np.float32)
        numbers[i, :, : len(columns)] = np.transpose(columns)
        drawn.append((inputs, parameters))
    return request.param, drawn, call_on_warp(pipeline, numbers, request.param)


@pytest.mark.parametrize("effect", DRONE, ids=lambda effect: effect.id)
def test_warp_equals_numba(case: tuple[bool, list[Any], np.ndarray], effect: Effect) -> None:
    """To 1e-12 in float64; in float32 to what rounding after every operation may change."""
    single, drawn, results = case
    i = DRONE.index(effect)
    inputs, parameters = drawn[i]
    compiled = numba.njit(effect.apply)

    expected = np.reshape(call_one_by_one(compiled, inputs, parameters), (COUNT, -1))
    found = results[i, :, : expected.shape[1]]
    if not single:
        np.testing.assert_allclose(found, expected, rtol=CLOSE, atol=CLOSE)
        return
    for k, line in enumerate(found):
        told = effect.apply(*(pick_tracked(given, k) for given in (*inputs, *parameters)))
        for value, number in zip(line, told if isinstance(told, tuple) else (told,), strict=True):
            known = number if isinstance(number, Tracked) else Tracked(number)
            assert abs(value - known.value) <= known.error + SMALLEST


def test_chain_on_warp_equals_plain(pipeline: Pipeline) -> None:
    """With all effects on, and with every other one, thrust and force on the craft are those of plain Python."""
    wp = pytest.importorskip("warp")
    names = run_text(write_warp(pipeline) + CHAIN_KERNEL, False)
    plain: dict[str, Any] = dict(pipeline.functions)
    exec(pipeline.source, plain)
    rng = np.random.default_rng(5)
    p = np.array([q.off + 0.5 * q.size for e in DRONE for q in e.parameters])
    s = np.zeros(len(pipeline.starts))
    for every, side in ((1, -1.0), (1, 1.0), (2, -1.0), (2, 1.0)):
        on = np.arange(len(pipeline.places)) % every == 0
        rotor, craft = Rotor(side, 470.0, rng.uniform(-0.2, 0.2), 0.2, 1.0), Craft(*rng.uniform(0.1, 1.0, 11))
        both: list[Any] = [rotor, craft]
        seen = [names[type(given).__name__]() for given in both]
        for thing, given in zip(seen, both, strict=True):
            for name, value in given._asdict().items():
                setattr(thing, name, value)
        lists = [wp.array(a, dtype=k, device="cpu") for a, k in ((on, wp.bool), (p, wp.float64), (s, wp.float64))]
        results = wp.zeros(4, dtype=wp.float64, device="cpu")
        wp.launch(names["chain"], dim=1, inputs=[*lists, *seen, results], device="cpu")
        expected = plain["shape_thrust"](on, p, s, 3.0, rotor, 1e-3), *plain["push_craft"](on, p, s, craft, 1e-3)
        np.testing.assert_allclose(results.numpy(), expected, rtol=CLOSE, atol=CLOSE)


def add_up(motion: Motion, /, force: float) -> float:
    """What numba takes and Warp does not."""
    total = 0.0
    for value in [motion.velocity, force]:
        total += value
    return total


def take_root(motion: Motion, /, force: float) -> float:
    """A function that Warp has no word for."""
    return np.cbrt(force)


@pytest.mark.parametrize(("apply", "line", "said"), [(add_up, 4, "uses for"), (take_root, 3, "np.cbrt")])
def test_what_warp_cannot_compile_is_told(spec: TwinSpec, apply: Any, line: int, said: str) -> None:  # noqa: ANN401
    """The effect, the line of the file, and the processor as the way out."""
    effect = replace(next(e for e in DRONE if e.id == "rail_x.bias"), id="rail_x.own", apply=apply)
    with pytest.raises(InputError) as caught:
        write_warp(write_pipeline(spec.model, [effect]))
    where = apply.__code__.co_firstlineno + line - 1
    for part in ("rail_x.own", said, f"line {where} of {Path(__file__)}", "on the processor"):
        assert part in str(caught.value)


def test_warp_that_is_missing_is_told(pipeline: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the extra that brings it."""
    monkeypatch.setitem(__import__("sys").modules, "warp", None)
    with pytest.raises(InputError, match=r"needs warp.*pip install 'vpptwin\[gpu\]'"):
        run_text(write_warp(pipeline), False)


BEND = 0.25


def soften(speed: float, most: float) -> float:
    """Called by the effect below."""
    if speed > most:
        return most
    return max(speed, -most, -2 * BEND)


def hold_softly(motion: Motion, /, force: float) -> float:
    """A function of its own, a constant, a branch, a choice, a whole power."""
    pull = soften(motion.velocity, BEND) ** 2
    if motion.position > 0 and motion.velocity < 1:
        pull = -pull
    return force * (pull if motion.load > 0.0 else 2.0 * pull)


def test_own_effect_brings_what_it_calls(spec: TwinSpec) -> None:
    """Functions and constants of the user's file come along; branches and choices stay."""
    wp = pytest.importorskip("warp")
    effect = replace(next(e for e in DRONE if e.id == "rail_x.bias"), id="rail_x.own", apply=hold_softly)
    kernel = ["", "@wp.kernel", "def call(x: wp.array2d(dtype=Real), y: wp.array(dtype=Real)):", "    k = wp.tid()"]
    kernel += ["    motion = Motion(x[k, 0], x[k, 1], x[k, 2], x[k, 3], x[k, 4], x[k, 5])"]
    kernel += ["    y[k] = effect_rail_x_own(motion, x[k, 6])", ""]
    names = run_text(write_warp(write_pipeline(spec.model, [effect])) + "\n".join(kernel), False)
    (motion,) = draw_inputs(effect, np.random.default_rng(6))
    force = np.ones(COUNT)
    results = wp.zeros(COUNT, dtype=wp.float64, device="cpu")
    given = wp.array(np.transpose([*motion, force]), dtype=wp.float64, device="cpu")
    wp.launch(names["call"], dim=COUNT, inputs=[given, results], device="cpu")
    expected = call_one_by_one(hold_softly, (motion,), [force])
    np.testing.assert_allclose(results.numpy(), expected, rtol=CLOSE, atol=CLOSE)
