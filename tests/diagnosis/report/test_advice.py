"""What a report says to do next: commands that the command line takes, and a file with an effect that loads."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from tests.builders import CAUSE, VERDICT
from tests.diagnosis.made_up import EXPERIMENT, read_demo
from tests.twin.own_effect_files import write_rig
from vpptwin.cli.main import build_parser
from vpptwin.diagnosis.judgement.verdict import Misfit, Rival, Unexplained, Unseen, Verdict
from vpptwin.report.html.advice import NextStep, Session, list_steps
from vpptwin.train.main import parse_overrides
from vpptwin.twin.spec import TwinSpec, load_twin

NAMED = replace(VERDICT, causes=[replace(CAUSE, also_explained_by=[])], unseen=[])
LEFT = Unexplained(True, 0.4, "slide", ["slide velocity"], 7.0, 0.03)


def advise(verdict: Verdict, spec: TwinSpec, options: tuple[str, ...] = ()) -> list[NextStep]:
    """Steps of a diagnosis of one log, written into a folder with a space in its name."""
    session = Session(spec, ["a flight.mcap"], options, Path("out/x y"))
    told = "x_steps: apart." if verdict.experiment is not None else None
    return list_steps(verdict, session, told, {"rail_x.viscous": "viscous friction"})


def list_commands(steps: list[NextStep]) -> list[list[str]]:
    """Commands as words, every one of which the command line takes."""
    commands = [shlex.split(step.command)[1:] for step in steps if step.command]
    for words in commands:
        if words[0] == "train":
            parse_overrides(words[1:])
        else:
            build_parser().parse_args(words)
    return commands


def test_a_named_cause_is_compared_watched_and_trained_on() -> None:
    """In that order, with the extended twin's file, and the options that reading the log took."""
    options = ("--topic-map", "my topics.yaml")
    commands = list_commands(advise(NAMED, read_demo()[0], options))
    assert [words[0] for words in commands] == ["compare", "export", "play", "train"]
    assert all("out/x y/twin.yaml" in " ".join(words) for words in commands)
    assert commands[0][-2:] == list(options)
    assert commands[0][1:6] == ["a flight.mcap", "--twin", "nominal", "--twin", "out/x y/twin.yaml"]


def test_results_that_are_not_saved_are_saved_first() -> None:
    """As in a notebook; the commands below name the files that it writes."""
    first, compare, *_ = list_steps(NAMED, Session(read_demo()[0], ["a.mcap"], [], None), None, {})
    assert first.command == 'result.save("out")'
    assert compare.command.endswith("--twin out/twin.yaml")


def test_nobody_trains_on_a_rig_of_other_people(tmp_path: Path) -> None:
    """Our tasks and manoeuvres are for the drone."""
    steps = advise(NAMED, load_twin(write_rig(tmp_path)))
    assert [words[0] for words in list_commands(steps)] == ["compare", "export", "play"]
    assert "fly --list" not in steps[-1].text


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        (replace(NAMED, experiment=EXPERIMENT), "Fly next: x_steps: apart."),
        (
            replace(NAMED, causes=[replace(CAUSE, also_explained_by=[Rival("rail_x.viscous", 0.3, 1.0)])]),
            "Log next: motion that separates rail_x.coulomb from viscous friction (rail_x.viscous): slower",
        ),
        (replace(NAMED, unseen=[Unseen("air.drag", "too slow")]), "Log next: motion that excites air.drag;"),
        (replace(NAMED, unseen=[Unseen("a.b", "it only changes c, which the twin lacks")]), "as a check."),
        (NAMED, "Log next: another motion, as a check. Nothing here depends on it"),
    ],
)
def test_there_always_is_something_to_fly_next(verdict: Verdict, words: str) -> None:
    """The manoeuvre that decides, motion that tells rivals apart, what could not be seen, or a check."""
    step = advise(verdict, read_demo()[0])[-1]
    assert step.text.startswith(words) or words in step.text
    assert step.command == (EXPERIMENT.command if verdict.experiment is not None else "")


@pytest.mark.parametrize(
    "verdict",
    [
        replace(NAMED, unexplained=LEFT),
        replace(NAMED, causes=[], unexplained=replace(LEFT, channel=None, depends_on=[])),
        replace(NAMED, unexplained=replace(LEFT, significant=False), misfit=Misfit(9.2, "slide", 0.1, 0.36, "m")),
    ],
)
def test_what_is_unexplained_asks_for_an_effect(verdict: Verdict, tmp_path: Path) -> None:
    """The file that the report offers loads as it is, acts on the joint that moves, and the command names it."""
    twin = write_rig(tmp_path)
    (step,) = [step for step in advise(verdict, load_twin(twin)) if step.source]
    assert step.text.startswith("Write an effect for the remainder")
    (words,) = list_commands([step])
    assert words[0] == "diagnose"
    assert "own.py" in words
    (tmp_path / "own.py").write_text(step.source, encoding="utf-8")
    own = load_twin(twin, [tmp_path / "own.py"]).catalogue[-1]
    assert (own.id, own.target, own.follows) == ("slide.own", "slide", "velocity")
    assert not [step for step in advise(NAMED, load_twin(twin)) if step.source]
