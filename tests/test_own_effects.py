"""An effect of the user's own, examples/own_effects: in every command, found in flights that ship, as the docs say."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.builders import VERDICT
from vpptwin.cli.main import main
from vpptwin.effects import generic_place
from vpptwin.report.provenance import trace_origin
from vpptwin.report.twin_file import compose_twin
from vpptwin.system.errors import InputError
from vpptwin.train.main import compose_config
from vpptwin.twin import TwinSpec, load_twin

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples/own_effects"
COGGING = EXAMPLE / "cogging.py"
LOGS = [str(EXAMPLE / f"{name}.mcap") for name in ("aggressive", "mixed", "steps")]
HIDDEN = {"rail_x.cogging": {"force": 0.4, "place": 0.0}}  # N, m
PAGE = (ROOT / "docs/own_effects.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def extended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A twin as a diagnosis writes it, with the user's effect switched on and provenance."""
    folder = tmp_path_factory.mktemp("extended")
    spec = load_twin("nominal", [COGGING])
    origin = trace_origin(["diagnose", LOGS[0]], spec.name, [Path(LOGS[0])])
    (folder / "twin.yaml").write_text(compose_twin(spec, HIDDEN, VERDICT, origin, folder))
    return folder / "twin.yaml"


@pytest.fixture(scope="module")
def flown(extended: Path) -> Path:
    """8 s of steps along x, flown in that twin."""
    out = extended.parent / "x.mcap"
    command = ["fly", "--manoeuvre", "x_steps", "--set", "amplitude=0.5", "--set", "period=1.5", "--duration", "8"]
    assert main([*command, "--twin", str(extended), "--trust", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example's flights diagnosed with the example's effect among the suspects."""
    out = tmp_path_factory.mktemp("cogging") / "out"
    assert main(["diagnose", *LOGS, "--effects", str(COGGING), "--out", str(out)]) == 0
    return out


def test_the_extended_twin_names_the_file(extended: Path) -> None:
    """By a path from the twin, so that both can move together; provenance does not stand in the way."""
    content = yaml.safe_load(extended.read_text())
    assert {"effects_from", "provenance"} < set(content)
    assert not Path(content["effects_from"][0]).is_absolute()
    spec = load_twin(extended, [COGGING])
    assert spec.effects == HIDDEN
    assert [file.resolve() for file in spec.effect_files] == [COGGING]
    # A slip of the pen beside provenance is told.
    slip = extended.with_name("slip.yaml")
    slip.write_text(extended.read_text().replace("effects_from", "effect_from"))
    with pytest.raises(InputError, match="unknown key effect_from"):
        load_twin(slip)


def test_fly_and_compare_take_the_extended_twin(extended: Path, flown: Path, tmp_path: Path) -> None:
    """Flown in the twin that cogs, a flight is noise to that twin, and to the nominal one with a file it is not."""
    chi2 = []
    for twin in (["--twin", str(extended), "--effects", str(COGGING)], ["--effects", str(COGGING)]):
        assert main(["compare", str(flown), *twin, "--json", str(tmp_path / "score.json")]) == 0
        chi2.append(json.loads((tmp_path / "score.json").read_text())["error"]["chi2"])
    assert chi2[0] == pytest.approx(1.0, abs=0.15)
    assert chi2[1] > 2.0


def test_play_takes_the_extended_twin(extended: Path, flown: Path, tmp_path: Path) -> None:
    """The page shows the log beside the twin."""
    page = tmp_path / "x.html"
    assert main(["play", str(flown), "--twin", str(extended), "--trust", "--html", str(page)]) == 0
    assert "twin.yaml" in page.read_text(encoding="utf-8")


def test_diagnose_takes_the_extended_twin(extended: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is diagnosed has the user's effect switched on, and in its catalogue once, even if the file is given too."""
    seen: list[TwinSpec] = []

    def stop(spec: TwinSpec, *given: object, **named: object) -> None:
        seen.append(spec)
        raise InputError("enough", "no more", "stop")

    monkeypatch.setattr("vpptwin.report.result.judge", stop)
    given = ["--twin", str(extended), "--effects", str(COGGING), "--out", str(tmp_path / "out")]
    assert main(["diagnose", LOGS[0], *given]) == 2
    assert seen[0].effects == HIDDEN
    assert [effect.id for effect in seen[0].catalogue].count("rail_x.cogging") == 1


@pytest.mark.parametrize("given", ["twin", "effects"])
def test_train_takes_the_extended_twin(extended: Path, given: str) -> None:
    """In the environment of a run the user's effect is on with the twin's value, or drawn from its prior."""
    from vpptwin.train.env.vpp_env import make_env

    small = ["num_envs=2", "rollout=2", "minibatch=4", "sim_threads=1", "desynchronize=false"]
    if given == "twin":
        env = make_env(compose_config([*small, f"twin={extended}", f"effects={COGGING}"]))
        assert env.twin.parameter("rail_x.cogging", "force").tolist() == [0.4, 0.4]
        return
    env = make_env(compose_config([*small, f"effects={COGGING}", "randomize=[rail_x.cogging]"]))
    env.reset()
    forces = env.twin.parameter("rail_x.cogging", "force")
    assert len(set(forces)) == 2
    assert (forces > 0.0).all()


@pytest.mark.slow
def test_the_example_names_the_users_effect(diagnosed: Path) -> None:
    """Cogging is the first cause, sure, within 15 % of the 0.40 N that the flights hide; nothing else is as large."""
    verdict = json.loads((diagnosed / "verdict.json").read_text())
    first = verdict["causes"][0]
    assert first["effect"] == "rail_x.cogging"
    assert first["confidence"] > 0.9
    assert first["parameters"]["force"]["value"] == pytest.approx(0.4, rel=0.15)
    assert first["parameters"]["place"]["value"] == pytest.approx(0.0, abs=0.01)
    assert verdict["after"]["position_rmse_m"][2] < 0.5 * verdict["before"]["position_rmse_m"][2]


@pytest.mark.slow
def test_the_diagnosis_writes_a_twin_that_cogs(diagnosed: Path) -> None:
    """Its twin.yaml names the file, and takes it if the user names it again."""
    assert load_twin(diagnosed / "twin.yaml", [COGGING]).effects["rail_x.cogging"]["force"] == pytest.approx(
        0.4, rel=0.15
    )


@pytest.mark.slow
def test_without_the_file_something_is_unexplained(tmp_path: Path) -> None:
    """The catalogue has no such force: the verdict says so and what it follows; 2 min of a core."""
    assert main(["diagnose", *LOGS, "--out", str(tmp_path / "out")]) == 0
    verdict = json.loads((tmp_path / "out/verdict.json").read_text())
    assert verdict["unexplained"]["significant"]
    assert "rail_x position" in verdict["unexplained"]["depends_on"]
    assert sum(cause["gain"] for cause in verdict["causes"]) < 0.3


def test_the_page_shows_the_example() -> None:
    """The code in docs/own_effects.md defines the effect that the example's file defines."""
    code, _, law = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)  # the second evolves: tests/twin
    names: dict[str, Any] = {}
    exec(code, names)
    exec(law, names)
    settling = names["settling"](generic_place("slide", False, 2.0))
    assert settling.id == "slide.settling"
    assert settling.summary == "friction on joint slide that falls with speed"
    assert settling.apply(0.5, names["Motion"](0.0, -0.1, -1.0, 0.0, 0.0, 1.0), np.e) == pytest.approx(1.5)
    shown, shipped = names["COGGING"], load_twin("nominal", [COGGING]).catalogue[-1]
    for field in ("id", "summary", "equation", "parameters", "stage", "look_alikes", "target", "follows"):
        assert getattr(shown, field) == getattr(shipped, field)


def test_documented_mistakes_are_told_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The lines that the page shows are what a user sees."""
    monkeypatch.chdir(tmp_path)
    good = COGGING.read_text().replace("rail_x.cogging", "rail_x.wave").replace("apply_cogging", "pull")
    good = good.replace(", place: float", "").replace(" - place", "")
    good = re.sub(r'\n +Parameter\(name="place".*?\),(?=\n    \),)', "", good, flags=re.DOTALL)
    mistakes = (
        None, "\n\na b\n", "a = 1\n", good.replace("rail_x.wave", "rail_x.coulomb"),
        good.replace('target="rail_x"', 'target="rail_y"'),
        good.replace("Stage\n", "Stage, State\n").replace(
            'target="rail_x"', 'target="rail_x", states=(State("heat", "K", "warm"),)'
        ),
        good.replace("force: float", "strength: float").replace("-force * np", "-strength * np"),
    )  # fmt: skip
    _, shown = re.findall(r"```text\n(.*?)```", PAGE, flags=re.DOTALL)  # the first: tests/test_trust.py
    for text, line in zip(mistakes, shown.splitlines(keepends=True), strict=True):
        if text is not None:
            Path("own.py").write_text(text)
        assert main(["effects", "--effects", "absent.py" if text is None else "own.py"]) == 2
        assert capsys.readouterr().err == line
