"""A diagnosis that is stopped, or that is asked for some candidates only: what it keeps, claims, and leaves alone."""

from __future__ import annotations

import json
import os
import re
import signal
from pathlib import Path

import pytest
import yaml
from tqdm import tqdm

import vpptwin
from tests.diagnosis.rigs import CARTS, record
from vpptwin.cli.main import main
from vpptwin.report import command, result
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import load_twin


@pytest.fixture(scope="module")
def cart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with eleven seconds of a cart that rubs with 1.1 N, and its twin, which does not."""
    folder = tmp_path_factory.mktemp("cart")
    record(CARTS, 1.1, folder, seed=3, part=0.45)
    return folder


def stop_at(monkeypatch: pytest.MonkeyPatch, stage: str, *signals: int) -> None:
    """Send this process signals as a diagnosis comes to a stage, later ones once the first is told."""
    sent = list(signals)

    def tell(bar: tqdm, text: str) -> None:
        if sent and text.startswith(stage):
            os.kill(os.getpid(), sent.pop(0))

    stop = command.stop

    def stop_twice(*given: object) -> bool:
        kept = stop(*given)  # type: ignore[arg-type]
        if sent:
            raise KeyboardInterrupt  # as of a second one, a second later
        return kept

    monkeypatch.setattr(result, "tell_stage", tell)
    monkeypatch.setattr(command, "stop", stop_twice)


def run(cart: Path, out: Path, *more: str) -> int:
    """`vpptwin diagnose` of the cart."""
    return main(["diagnose", str(cart / "log.mcap"), "--twin", str(cart / "rig.yaml"), "--out", str(out), *more])


def test_a_signal_keeps_what_was_found(
    cart: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """As others are fitted beside it: the friction is there, not sure, with what was not done, in all files."""
    stop_at(monkeypatch, "comparing hypotheses (slide.coulomb, slide.", signal.SIGTERM)
    assert run(cart, tmp_path) == 143
    said = capfd.readouterr()
    assert "vpptwin: SIGTERM: what was found so far is kept" in said.err
    assert re.search(r"Partial, stopped by SIGTERM: Dry friction of 1\.(09|1)", " ".join(said.out.split()))
    verdict = json.loads((tmp_path / "verdict.json").read_text())
    assert set(verdict) >= {"logs", "twin", "samples", "before", "after", "gap", "unexplained", "suggested_experiment"}
    (cause,) = verdict["causes"]
    assert cause["effect"] == "slide.coulomb"
    assert cause["parameters"]["force"]["value"] == pytest.approx(1.1, abs=0.1)
    assert cause["confidence"] <= 0.89
    assert verdict["after"]["chi2"] < verdict["before"]["chi2"]
    assert verdict["stopped"]["why"] == "SIGTERM"
    assert "fitting further sets of effects" in verdict["stopped"]["not_done"]
    assert verdict["cleared"] == []
    report = (tmp_path / "report.html").read_text()
    assert "This verdict is partial: SIGTERM stopped the run" in report.replace("\N{NO-BREAK SPACE}", " ")
    assert "stopped the run" in yaml.safe_load((tmp_path / "twin.yaml").read_text())["provenance"]["partial"]
    assert load_twin(tmp_path / "twin.yaml").effects["slide.coulomb"]["force"] == pytest.approx(1.1, abs=0.1)
    assert (tmp_path / "prediction.mcap").exists()


@pytest.mark.parametrize(
    ("stage", "signals"),
    [
        ("linearising", [signal.SIGINT]),
        pytest.param(
            "comparing hypotheses (slide.coulomb, slide.", [signal.SIGINT, signal.SIGINT], marks=pytest.mark.slow
        ),
    ],
)
def test_a_signal_before_anything_and_a_second_one_end_it(
    cart: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str, signals: list[int]
) -> None:
    """At once, and what was there stays as it was."""
    (tmp_path / "verdict.json").write_text('{"horizons_s": [], "logs": []}')
    stop_at(monkeypatch, stage, *signals)
    assert run(cart, tmp_path) == 130
    assert [file.name for file in tmp_path.iterdir()] == ["verdict.json"]
    assert (tmp_path / "verdict.json").read_text() == '{"horizons_s": [], "logs": []}'


def test_a_limit_that_is_too_short_says_what_to_do(
    cart: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line, exit code 2, the old file as it was."""
    (tmp_path / "twin.yaml").write_text("# vpptwin diagnose")
    assert run(cart, tmp_path, "--limit", "1e-3") == 2
    assert "expected a time such as 90s" in capsys.readouterr().err
    assert run(cart, tmp_path, "--limit", "0.001s") == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "the time limit of 0.001 s was over before every candidate had been tried once" in said
    assert "--only" in said
    assert [file.name for file in tmp_path.iterdir()] == ["twin.yaml"]


def test_candidates_can_be_named(cart: Path) -> None:
    """Of laws of friction that leave the right one out the best is not sure; a name that is none is told."""
    log, twin = cart / "log.mcap", cart / "rig.yaml"
    found = vpptwin.diagnose(log, twin, only=["slide.visc*", "motor.delay"], progress=False)
    assert found.verdict.only == ["motor.delay", "slide.viscous"]
    assert {cause.effect for cause in found.verdict.causes} <= set(found.verdict.only)
    assert all(cause.confidence <= 0.89 for cause in found.verdict.causes)
    assert "Only motor.delay and slide.viscous were tried" in found.summary.partial
    assert {entry.effect for entry in (*found.verdict.cleared, *found.verdict.unseen)} <= {
        "motor.delay",
        "slide.viscous",
    }
    with pytest.raises(InputError, match=r"--only slide\.viscus; .*; did you mean slide\.viscous\?"):
        vpptwin.diagnose(log, twin, only=["slide.viscus"], progress=False)
