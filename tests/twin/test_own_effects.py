"""Effects of a user's own act in the twin as ours do; the compiled step follows every edit of their file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.twin.own_effect_files import HEAD, WARM, WAVE, write_effects, write_rig
from vpptwin.effects import find_effect
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.stepping.pipeline import fingerprint

STEPS, DT, MASS, START = 100, 0.002, 3.0, 0.1  # -, s, kg, m
STRONG = WAVE.replace("-force * np", "-2.0 * force * np")
EVOLVING = (
    WARM
    + """
def rub(level, motion, /, heat, dt, force):
    return level + force * heat, heat + dt * (1.0 + motion.direction)

RUB = Effect(
    id="slide.rub", summary="a rail that wears", equation="force heat", parameters=(FORCE,), stage=Stage.FRICTION,
    apply=rub, shows=("/joint_states",), target="slide", states=(State("heat", "m", 0.1),),
)
"""
)
"""A force and a friction that evolve, compiled together."""


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with a rig, and what is compiled for it: the same file of effects is compiled once."""
    folder = tmp_path_factory.mktemp("own")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vpptwin.engine.store.user_cache_path", lambda name: folder / "cache" / name)
        yield folder


def coast(twin: Path, file: Path, effect: str = "slide.wave", force: float | None = 1.5) -> float:
    """Where the cart gets to from START at rest [m]; `force` None leaves the effect out."""
    spec = load_twin(twin, [file])
    made = Twin(spec, 1, active=[] if force is None else [effect], num_threads=1)
    if force is not None:
        made.set_parameter(effect, "force", force)
    state = made.initial_state(qpos=np.array([START, 0.0]))
    return float(made.replay_commands(state, np.zeros((1, STEPS, 1)))[0].qpos[0, 0])


def test_own_effects_push(folder: Path) -> None:
    """A wavy rail pulls the cart as its formula says, and at its off value changes not a bit."""
    twin, file = write_rig(folder), write_effects(folder)
    x, v = START, 0.0
    for _ in range(STEPS):  # the same formula by hand; a joint that follows its log carries no force over
        v = (v * MASS - DT * 1.5 * np.sin(10.0 * x)) / (MASS + 0.5 * DT)
        x += DT * v
    assert coast(twin, file) == pytest.approx(x, rel=1e-3)
    assert abs(x - START) > 0.005
    assert coast(twin, file, force=0.0) == coast(twin, file, force=None) == START


def test_own_effects_evolve(folder: Path) -> None:
    """What an effect keeps starts with its joint, changes by its formula, and acts by it; off it stays."""
    twin, file = write_rig(folder), write_effects(folder, EVOLVING)
    x, v, heat = START, 0.0, START
    for _ in range(STEPS):
        pull, heat = -1.5 * np.sin(10.0 * x) * heat, heat + DT * abs(v)
        v = (v * MASS + DT * pull) / (MASS + 0.5 * DT)
        x += DT * v
    assert coast(twin, file) == pytest.approx(x, rel=1e-3)
    assert START - x > 5e-4
    assert coast(twin, file, force=0.0) == START


def test_friction_that_evolves(folder: Path) -> None:
    """A FRICTION effect is called for both senses; what it keeps is what it returns for the sense of motion."""
    spec = load_twin(write_rig(folder), [write_effects(folder, EVOLVING)])
    made = Twin(spec, 2, active=["slide.rub"], num_threads=1)
    made.set_parameter("slide.rub", "force", 0.01)
    state = made.initial_state(qpos=np.array([START, 0.0]), qvel=np.array([[0.5, 0.0], [-0.5, 0.0]]))
    after = made.replay_commands(state, np.zeros((2, STEPS, 1)))[0].effects[:, -1]
    np.testing.assert_allclose(after, [START + 2.0 * STEPS * DT, START], rtol=1e-9)


@pytest.mark.slow
def test_the_example_of_the_docs(folder: Path) -> None:
    """The motors of docs/own_effects.md weaken as they get hot, each by its own load."""
    page = (Path(__file__).parents[2] / "docs/own_effects.md").read_text(encoding="utf-8")
    text = next(block for block in page.split("```")[1::2] if "motor.heat" in block).removeprefix("python\n")
    twin = Twin(load_twin("nominal", [write_effects(folder, text)]), 1, active=["motor.heat"], num_threads=1)
    twin.set_parameter("motor.heat", "loss", 0.3)
    state = twin.initial_state()
    state.actuators["horn"] = state.actuators["blade"] = state.actuators["history"] = blade = np.array(
        [0.0, 0.1]
    )  # rad
    after = twin.replay_commands(state, np.broadcast_to(blade, (1, 300, 2)))[0]
    thrust = twin.vehicle.rotor.k_t * twin.vehicle.rotor.speed * 0.1
    expected = thrust / 5.0 * (1.0 - np.exp(-0.3 / 60.0))
    np.testing.assert_allclose(after.effects[0, -2:], [0.0, expected], rtol=1e-3, atol=1e-12)


def test_an_edited_file_is_another_step(folder: Path) -> None:
    """In the same place, under the same id; with its old text it is the old one."""
    twin, keys = write_rig(folder), []
    for text in (WAVE, STRONG, WAVE):
        spec = load_twin(twin, [write_effects(folder, text)])
        keys.append(fingerprint("step", functions=[find_effect(spec.catalogue, "slide.wave").apply]))
    assert keys[0] == keys[2] != keys[1]


@pytest.mark.slow
def test_an_edited_file_is_compiled_anew(folder: Path) -> None:
    """A stronger wave in the same file, under the same id, pulls the cart farther; the old text its old way again."""
    twin = write_rig(folder)
    weak = coast(twin, write_effects(folder))
    strong = coast(twin, write_effects(folder, STRONG))
    assert abs(strong - START) > 1.5 * abs(weak - START)
    assert coast(twin, write_effects(folder)) == weak


@pytest.mark.slow
def test_files_with_the_same_ids_do_not_clash(folder: Path) -> None:
    """Two files of one name, with effects of one id, are two: each does what is written in it."""
    twin = write_rig(folder)
    (folder / "b").mkdir()
    weak, strong = write_effects(folder), write_effects(folder / "b", STRONG)
    assert 1.5 * (START - coast(twin, weak)) < START - coast(twin, strong)


def test_numbers_of_the_rig_are_compiled_in(folder: Path) -> None:
    """The same file makes another function for a heavier cart, and that is the one that acts."""
    build = """
def build_effects(model):
    mass = float(model.body("cart").mass[0])
    def hold(motion, /, force):
        return -force * mass * motion.position
    return [Effect("slide.wave", "a pull", "-force m x", (FORCE,), Stage.FORCE, hold, (), target="slide")]
"""
    file, twin = write_effects(folder, HEAD + build), write_rig(folder)
    light = coast(twin, file)
    model = folder / "slide.xml"
    model.write_text(model.read_text().replace('mass="2"', 'mass="4"'))
    heavy = coast(twin, file)
    # pull and mass grow alike: 1.5·2 x on 3 kg, 1.5·4 x on 5 kg
    assert (heavy - START) / (light - START) == pytest.approx((1.5 * 4 / 5) / (1.5 * 2 / 3), rel=0.02)
