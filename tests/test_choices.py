"""What a user says is in question, and what the Python interface takes: on a pendulum that is let go."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader

import vpptwin
from proving.kinds import write_kind
from vpptwin.cli.main import main
from vpptwin.diagnosis.judgement import diagnose as judgement
from vpptwin.diagnosis.search.suspects import list_unknowns
from vpptwin.report.result import parse_fixed, read_causes, settle_effects
from vpptwin.twin.spec import load_twin

TWIN = "model: rig.xml\nsignals:\n  joints:\n    hinge: {topic: run_1, position: hinge}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pendulum with dry and viscous friction that the twin lacks, and its diagnosis in `out`, a few seconds."""
    made = tmp_path_factory.mktemp("decay")
    case = write_kind("decay", 0, made)
    head = case.logs[0].read_text().splitlines()[0]
    (made / "twin.yaml").write_text(TWIN.replace("position: hinge", f"position: {head.split(',')[1]}"))
    given = [*map(str, case.logs), "--twin", str(made / "twin.yaml"), "--out", str(made / "out")]
    assert main(["diagnose", *given, "--only", "hinge.coulomb,hinge.viscous"]) == 0
    return made


def test_what_is_settled_is_no_candidate(folder: Path) -> None:
    """Left out by pattern, or fixed at a value that the twin then has."""
    spec = settle_effects(load_twin(folder / "twin.yaml"), ["hinge.v*"], {"hinge.coulomb": 0.01})
    named = {unknown.effect.id for unknown in list_unknowns(spec)}
    assert named
    assert not named & {"hinge.viscous", "hinge.coulomb"}
    assert spec.effects["hinge.coulomb"] == {"torque": 0.01}
    assert "hinge.viscous" not in spec.effects


@pytest.mark.parametrize(("without", "fix", "said"), [
    (["hinge.viscos"], {}, "--without hinge.viscos; expected ids of effects .* did you mean hinge.viscous"),
    ([], {"hinge.viscos": 1.0}, "--fix hinge.viscos; expected ids of effects"),
    ([], {"hinge.coulomb.mass": 1.0}, "--fix hinge.coulomb.mass=1; expected a parameter of hinge.coulomb: torque"),
    ([], {"hinge.coulomb": -1.0}, "hinge.coulomb.torque = -1 N m; expected 0 to"),
    (["*"], {}, "no candidate is left"),
])  # fmt: skip
def test_unknown_names_get_one_line(folder: Path, without: list[str], fix: dict[str, float], said: str) -> None:
    """With what was meant, or what there is."""
    with pytest.raises(vpptwin.InputError, match=said):
        vpptwin.diagnose([folder / "run_1.csv"], folder / "twin.yaml", progress=False, without=without, fix=fix)


def test_values_to_fix_are_numbers() -> None:
    """An effect without one is refused."""
    assert parse_fixed(["a.b=0.5"]) == {"a.b": 0.5}
    with pytest.raises(vpptwin.InputError, match=r"--fix a\.b=fast; expected EFFECT=VALUE"):
        parse_fixed(["a.b=fast"])


def test_priors_of_a_twin(folder: Path) -> None:
    """A probability of 0 settles an effect, others are kept; unknown names and impossible numbers are refused."""
    path = folder / "prior.yaml"
    path.write_text(TWIN + "priors: {hinge.coulomb: 0.5, hinge.viscous: 0.0}\n")
    spec = load_twin(path)
    assert spec.settled == {"hinge.viscous"}
    assert spec.priors["hinge.coulomb"] == 0.5
    for wrong, said in (("{hinge.coulom: 0.5}", "did you mean hinge.coulomb"), ("{hinge.coulomb: 1.5}", "less than 1")):
        path.write_text(TWIN + f"priors: {wrong}\n")
        with pytest.raises(vpptwin.InputError, match=said):
            load_twin(path)


def test_a_cause_is_rejected_after_the_run(folder: Path) -> None:
    """`--from` fits those that are left, to the same logs."""
    before = json.loads((folder / "out/verdict.json").read_text())
    assert {cause["effect"] for cause in before["causes"]} == {"hinge.coulomb", "hinge.viscous"}
    given = ["--from", str(folder / "out"), "--without", "hinge.viscous", "--out", str(folder / "revised")]
    assert main(["diagnose", *given]) == 0
    after = json.loads((folder / "revised/verdict.json").read_text())
    assert [cause["effect"] for cause in after["causes"]] == ["hinge.coulomb"]
    assert after["settled"] == ["hinge.viscous"]
    assert after["logs"] == before["logs"]
    assert yaml.safe_load((folder / "revised/twin.yaml").read_text())["effects"].keys() == {"hinge.coulomb"}


def test_what_cannot_be_revised_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder without a verdict, and no log at all."""
    assert main(["diagnose", "--from", str(folder / "nowhere"), "--out", str(folder / "x")]) == 2
    assert "no readable verdict.json" in capsys.readouterr().err
    assert main(["diagnose", "--out", str(folder / "x")]) == 2
    assert "no logs" in capsys.readouterr().err


def test_predictions_hold_what_was_measured(folder: Path) -> None:
    """Beside what both twins say, at the same stamps."""
    with (folder / "out/prediction_run_1.mcap").open("rb") as file:
        counts = {}
        for _, channel, _ in make_reader(file).iter_messages():
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
    assert counts["/measured/joint_states"] == counts["/twin/before/joint_states"] > 100


def test_what_now_offers_to_export(folder: Path) -> None:
    """The extended twin as MJCF."""
    page = re.sub("<span>([^<]*)</span>", r"\1", (folder / "out/report.html").read_text())
    assert f"vpptwin export {folder / 'out/twin.yaml'} --format mjcf" in page


def test_logs_are_read_as_a_twin_names_them(folder: Path) -> None:
    """`read_log(path, twin=...)` takes the twin's name or the twin; what it gives can be compared."""
    for twin in (folder / "twin.yaml", load_twin(folder / "twin.yaml")):
        log = vpptwin.read_log(folder / "run_1.csv", twin=twin)
        assert np.ptp(log.joints["/joint_states"]["hinge"]["position"]) > 0.5
    comparison = vpptwin.compare(log, twin=[twin, folder / "out/twin.yaml"], progress=False)
    page = comparison._repr_html_()
    assert page.count("<table>") == len(comparison.twins[0].tabulate())
    assert "twin.yaml" in page
    assert "chi²" in page


def test_the_command_alone_prints_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    """With exit code 0."""
    assert main([]) == 0
    told = capsys.readouterr()
    assert "commands" in told.out
    assert "diagnose" in told.out
    assert not told.err


def test_doubts_are_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`-y` goes on with the likeliest mapping, and warns of each doubt."""
    case = write_kind("decay", 0, tmp_path)
    head, *rows = case.logs[0].read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join([f"{head},hinge_b", *(f"{row},{row.split(',')[1]}" for row in rows)]))
    monkeypatch.chdir(tmp_path)
    command = ["compare", "log.csv", "--model", "rig.xml"]
    if main(command) == 2:
        assert "doubt" in capsys.readouterr().err
    assert main([*command, "-y"]) == 0


def test_environments_take_twins_that_were_read() -> None:
    """What `load_twin` gives, with its effects."""
    pytest.importorskip("torch")
    spec = load_twin("nominal").with_effects({"rail_x.coulomb": {"force": 0.3}})
    env = vpptwin.make_env("hover", twin=spec)
    assert "rail_x.coulomb" in env.twin.spec.effects


def test_weak_causes_are_not_taken_for_granted(tmp_path: Path) -> None:
    """`--from` takes what twin.yaml has."""
    told = {"logs": ["a.csv"], "twin": "rig.yaml", "causes": [{"effect": "a.coulomb"}, {"effect": "b", "weak": True}]}
    (tmp_path / "verdict.json").write_text(json.dumps(told))
    assert read_causes(tmp_path) == ([Path("a.csv")], "rig.yaml", ["a.coulomb"])


def test_what_some_error_grows_with_is_suggested(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Left out of twin.yaml in the end, it takes most of the error half a second ahead: there is a twin with it."""
    monkeypatch.setattr(
        judgement, "keep_better", lambda m, found: judgement.leave_out(m, found, sorted(found.fit.effects))
    )
    given = [*map(str, sorted(folder.glob("run_*.csv"))), "--twin", str(folder / "twin.yaml"), "--out", str(tmp_path)]
    assert main(["diagnose", *given]) == 0
    told = json.loads((tmp_path / "verdict.json").read_text())
    assert [(cause["weak"], cause["confidence"] <= 0.5) for cause in told["causes"]] == [(True, True)] * 2
    assert told["before"] == told["after"]
    assert told["suggested"]["angle_rmse_rad"][3] < 0.5 * told["before"]["angle_rmse_rad"][3]
    assert told["gap"]
    assert load_twin(tmp_path / "twin.yaml").effects == {}
    assert set(load_twin(tmp_path / "twin_suggested.yaml").effects) == {"hinge.coulomb", "hinge.viscous"}
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("Not in twin.yaml, but in twin_suggested.yaml: ")
    assert "What may help" not in said
