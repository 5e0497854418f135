"""Files with effects of a user's own: what they define joins the catalogue, what is wrong is told in a line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.twin.own_effect_files import EFFECT, FUNCTION, HEAD, WARM, WAVE, write_effects, write_rig
from vpptwin.cli.main import main
from vpptwin.effects import CATALOGUE
from vpptwin.system.errors import InputError
from vpptwin.twin import load_twin


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """The twin of a cart on a rail whose second joint follows its log."""
    return write_rig(tmp_path)


def list_ids(twin: Path | str, *files: Path) -> list[str]:
    """Ids of a twin's catalogue."""
    return [effect.id for effect in load_twin(twin, files).catalogue]


def test_own_effects_follow_the_catalogue(rig: Path, tmp_path: Path) -> None:
    """Those of several files come last, in the files' order, and a file that is given twice counts once."""
    first = write_effects(tmp_path)
    second = write_effects(tmp_path, WAVE.replace("slide.wave", "slide.ripple"), "more.py")
    assert list_ids(rig, first, second, first) == [*list_ids(rig), "slide.wave", "slide.ripple"]
    assert [effect.id for effect in CATALOGUE] == list_ids("nominal")


def test_a_twin_names_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`effects_from` is read relative to the twin, from wherever it is loaded; its effects can be switched on there."""
    (tmp_path / "lib").mkdir()
    write_effects(tmp_path / "lib")
    twin = write_rig(tmp_path, "effects_from: [lib/own.py]\neffects: {slide.wave: {force: 0.4}}\n")
    monkeypatch.chdir("/")
    spec = load_twin(twin, [tmp_path / "lib/own.py"])
    assert spec.effects == {"slide.wave": {"force": 0.4}}
    assert spec.catalogue[-1].id == "slide.wave"
    assert [file.resolve() for file in spec.effect_files] == [tmp_path / "lib/own.py"]
    assert list_ids(twin, tmp_path / "lib/own.py").count("slide.wave") == 1


def test_effects_are_built_for_the_rig(rig: Path, tmp_path: Path) -> None:
    """`build_effects(model)` makes one for every joint it likes, with numbers of the model in them."""
    build = """
def build_effects(model):
    def make(name, mass):
        def hold(motion, /, force):
            return -force * mass * motion.position
        return Effect(f"{name}.hold", "a pull", "-force m x", (FORCE,), Stage.FORCE, hold, (), target=name)
    return [make("slide", float(model.body("cart").mass[0]))]
"""
    spec = load_twin(rig, [write_effects(tmp_path, HEAD + build)])
    assert spec.catalogue[-1].id == "slide.hold"


def test_imported_effects_of_ours_are_not_the_users(rig: Path, tmp_path: Path) -> None:
    """A file may import the catalogue's effects to look at them; only its own join."""
    ours = "from vpptwin.robots.planar_drone.effects.catalogue import DRAG\n"
    file = write_effects(tmp_path, ours + WAVE + "\nALIAS = OWN\n")
    assert list_ids(rig, file) == [*list_ids(rig), "slide.wave"]


def test_off_values_come_from_the_vehicle(tmp_path: Path) -> None:
    """A parameter with `nominal` is off at the vehicle's number."""
    text = """import numpy as np
from vpptwin.effects import Effect, Parameter, Prior, Stage
LAG = Parameter(name="lag", unit="s", off=0.05, low=0.0, high=0.2, prior=Prior("normal", 0.05, 0.01), size=0.01,
                nominal="servo.time_constant")

def apply(constants, site, /, *, lag):
    constants["actuator.time_constant"][:, 0] = lag

LEFT = Effect("servo.left", "a lag", "lag", (LAG,), Stage.CONSTANT, apply, (), writes=("actuator.time_constant",))
"""
    spec = load_twin("nominal", [write_effects(tmp_path, text)])
    assert spec.catalogue[-1].parameter("lag").off == spec.vehicle.servo.time_constant


def test_functions_compiled_by_the_user_are_taken(rig: Path, tmp_path: Path) -> None:
    """A function that is already numba's, and one that calls a helper of numba's, are as good as plain ones."""
    helper = "import numba\n@numba.njit\ndef wave(x):\n    return np.sin(10.0 * x)\n@numba.njit"
    text = WAVE.replace("def pull", helper + "\ndef pull").replace(
        "np.sin(10.0 * motion.position)", "wave(motion.position)"
    )
    assert load_twin(rig, [write_effects(tmp_path, text)]).catalogue[-1].apply.__name__ == "pull"


def test_the_list_shows_own_effects(rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`vpptwin effects --effects FILE` has a line for each of their parameters, last."""
    assert main(["effects", "--twin", str(rig), "--effects", str(write_effects(tmp_path))]) == 0
    assert capsys.readouterr().out.splitlines()[-1].split() == [
        "slide.wave", "force", "N", "0", "0", "to", "2", "a", "wavy", "rail"
    ]  # fmt: skip


def wrong(old: str, new: str, text: str = WAVE) -> str:
    """The good file with one thing changed."""
    assert old in text
    return text.replace(old, new)


def constant(body: str, writes: str) -> str:
    """A file with a CONSTANT effect."""
    declared = EFFECT.replace("Stage.FORCE", "Stage.CONSTANT").replace(
        'target="slide"', f'target="slide", writes={writes}'
    )
    return HEAD + f"\ndef pull(constants, site, /, *, force):\n    {body}\n" + declared


MISTAKES = {
    "syntax": ("def (:\n", r"own\.py:1: .*expected a Python file"),
    "import": ("\n\nimport nothing_of_the_kind\n", r"own\.py:3: ModuleNotFoundError: .*nothing_of"),
    "exits": ("raise SystemExit(3)\n", r"own\.py:1: SystemExit: 3"),
    "empty": ("a = 1\n", r"own\.py: no effects in it; expected Effect objects"),
    "escapes": (wrong("a wavy rail", "\\x1b[2Ja wavy rail"), r"summary '\\x1b\[2J.*; expected a line of text"),
    "unit": (wrong('unit="N"', "unit=1"), "unit 1; expected a line of text"),
    "shows": (wrong('("/joint_states",)', '"/joint_states"'), "expected a tuple of topics"),
    "no effect": ("def build_effects(model):\n    return [3]\n", "build_effects returns a int"),
    "builder": ("def build_effects(model):\n    return 1 / 0\n", r"own\.py:2: ZeroDivisionError"),
    "taken": (wrong("slide.wave", "slide.coulomb"), "like 'slide.coulomb' of the catalogue"),
    "clash": (wrong("slide.wave", "slide_coulomb"), "like 'slide.coulomb' of the catalogue"),
    "the drone's": (wrong("slide.wave", "rail_x.coulomb"), "like 'rail_x.coulomb' of the catalogue"),
    "twice": (WAVE + EFFECT.replace("OWN", "TWO"), r"like 'slide.wave' of .*own\.py"),
    "id": (wrong("slide.wave", "wave"), "id 'wave'; expected two words with a dot"),
    "stage": (wrong("Stage.FORCE", '"force"'), "stage 'force'; expected one of"),
    "no parameters": (wrong("(FORCE,)", "()"), "no parameters"),
    "same names": (wrong("(FORCE,)", "(FORCE, FORCE)"), "each name once"),
    "positional": (wrong("name=", ""), r"own\.py:4: TypeError: .* positional"),
    "bounds": (wrong("low=0.0", "low=0.5"), "low 0.5, off 0, high 2"),
    "size": (wrong("size=0.1", "size=0.0"), "parameter force: size 0"),
    "start": (wrong('"position")', '"warm")', WARM), "heat starts at 'warm'; .* position or"),
    "endless start": (wrong('"position")', "np.inf)", WARM), "heat starts at inf"),
    "no state": (wrong('State("heat", "m", "position"),', '"heat",', WARM), r"states \('heat',\)"),
    "state's name": (wrong('"heat", "m"', '"he at", "m"', WARM), "state 'he at'"),
    "one name": (wrong('"heat", "m"', '"force", "m"', WARM), "force, force; expected each name once"),
    "no dt": (wrong("heat, dt, force", "heat, force", WARM), r"expected \(motion, heat, dt, force\)"),
    "loses its state": (wrong(", heat + dt * abs(motion.velocity)", "", WARM), "a number, then heat"),
    "state acts while off": (wrong("-force *", "heat - force *", WARM), "not off at its off values"),
    "constant with states": (wrong("Stage.FORCE", "Stage.CONSTANT", WARM), "states of Stage.CONSTANT"),
    "joint": (wrong('target="slide"', 'target="rail_x"'), "'rail_x'; expected a joint of the rig: slide"),
    "driven": (wrong('target="slide"', 'target="lift"'), "'lift', which follows its log"),
    "craft": (wrong(', target="slide"', ""), "acts on the craft; .*not the drone"),
    "thrust": (wrong("Stage.FORCE", "Stage.THRUST"), "acts on thrust"),
    "needs": (wrong('target="slide"', 'target="slide", needs=("guide",)'), "needs guide"),
    "look-alike": (wrong('target="slide"', 'target="slide", look_alikes=("slide.colomb",)'), "slide.coulomb"),
    "arguments": (wrong("motion, /, force", "level, motion, /, force"), r"expected \(motion, force\)"),
    "names": (wrong("motion, /, force", "motion, /, strength").replace("-force", "-strength"),
        r"pull\(motion, strength\); expected \(motion, force\)"),
    "never off": (wrong("-force * np", "1e-12 - force * np"), "not off at its off values .*force 0"),
    "NaN": (wrong("-force *", "np.log(force - 1.0) *"), "returns nan at force"),
    "infinite": (wrong("-force * np", "-force / (motion.velocity * 0.0) * np"), "returns (nan|-?inf)"),
    "plain helper": (WAVE.replace("np.sin(", "wave(") + "\ndef wave(x):\n    return x\n",
        r"does not compile: own\.py:\d+: .*wave.*numba\.njit"),
    "no such function": (wrong("np.sin(", "np.sine("), "no attribute 'sine'"),
    "two numbers": (wrong("return -force", "return 0.0, -force"), "returns .*; expected a number"),
    "replaces friction": (wrong("Stage.FORCE", "Stage.FRICTION").replace("(motion, /", "(level, motion, /"), "not off"),
    "undeclared": (constant('constants["dof_damping"][:, site.dof] += force', "()"), "writes nothing"),
    "no such constant": (constant('constants["dof_damping"][:, site.dof] += force', '("dof_dampin",)'),
        "'dof_dampin'; expected a constant such as dof_damping"),
    "other": (constant('constants["body_mass"][:, 1] += force', '("dof_damping",)'), "uses 'body_mass'"),
    "sensor": (constant('constants["rate.bias"][:] += force', '("dof_damping",)'), "uses 'rate.bias'"),
    "shape": (constant('constants["dof_damping"] = force', '("dof_damping",)'), "of shape"),
    "replaces": (constant('constants["dof_damping"][:] = 0.1', '("dof_damping",)'), "not off"),
    "raises": (constant('constants["dof_damping"][:] += force["a"]', '("dof_damping",)'), "raises .* in line"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_told_in_a_line(rig: Path, tmp_path: Path, mistake: str) -> None:
    """What is wrong, with file and place, what was expected, what to do; nothing of numba's pages."""
    text, line = MISTAKES[mistake]
    with pytest.raises(InputError, match=line) as caught:
        load_twin(rig, [write_effects(tmp_path, text)])
    said = str(caught.value)
    assert "own.py" in said
    assert "\n" not in said
    assert len(said) < 500
    assert caught.value.action


def test_missing_files_are_refused(rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On the command line and in a twin: exit code 2, and the path."""
    assert main(["effects", "--twin", str(rig), "--effects", "absent.py"]) == 2
    assert capsys.readouterr().err.startswith("vpptwin: no readable effects file absent.py; expected a Python file")
    twin = write_rig(tmp_path, "effects_from: [absent.py]\n")
    assert main(["effects", "--twin", str(twin), "--trust"]) == 2
    assert f"no readable effects file {tmp_path / 'absent.py'}" in capsys.readouterr().err


def test_a_repaired_file_is_read_anew(rig: Path, tmp_path: Path) -> None:
    """A file that was refused, and then corrected, is taken by the same process."""
    file = write_effects(tmp_path, HEAD + "\nnonsense\n")
    with pytest.raises(InputError, match="nonsense"):
        load_twin(rig, [file])
    write_effects(tmp_path)
    assert list_ids(rig, file)[-1] == "slide.wave"
    write_effects(tmp_path, WAVE.replace("high=2.0", "high=3.0"))
    assert load_twin(rig, [file]).catalogue[-1].parameter("force").high == np.float64(3.0)
    assert FUNCTION in file.read_text()
