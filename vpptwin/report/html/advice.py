"""What to do next: the steps that a report offers below its headline, with commands ready to copy."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from vpptwin.diagnosis.judgement.verdict import Verdict
from vpptwin.report.words import join_words, name_effect
from vpptwin.twin.robot.model import describe_joints
from vpptwin.twin.robot.robot import Robot, by_robot
from vpptwin.twin.spec import TwinSpec

FOLLOWED = ("velocity", "position")
"""What an effect of one's own on a joint may follow, most likely first."""
UNSAVED = Path("out")
"""Folder for results that were not saved yet, as in a notebook."""

SHORTER = "give a part of the log (LOG@0-10), put joints under `driven` in the twin, or name candidates with --only"
"""What makes a diagnosis shorter."""


@dataclass(frozen=True)
class NextStep:
    """A thing to do: in words, a command that does it, and a file to begin with; "" for none."""

    text: str
    command: str = ""
    source: str = ""


@dataclass(frozen=True)
class Session:
    """What was diagnosed, and how the results are called."""

    spec: TwinSpec  # the twin that was diagnosed
    logs: Sequence[str]  # as the command line names them
    options: Sequence[str]  # of the command line that other commands share, such as `--topic-map`
    out: Path | None  # folder of the results; None if they are not written

    def type(self, command: str, *words: str) -> str:
        """A command with its options as one types it."""
        return shlex.join(["vpptwin", command, *words, *self.options])

    @property
    def extended(self) -> str:
        """The extended twin's file."""
        return str((self.out or UNSAVED) / "twin.yaml")


def list_steps(
    verdict: Verdict, session: Session, experiment: str | None, meanings: Mapping[str, str]
) -> list[NextStep]:
    """What to do next, in order.

    Args:
        verdict: the verdict.
        session: what was diagnosed.
        experiment: the flight that would decide, in words; None if there is none.
        meanings: effect id → summary of the catalogue.
    """
    twin = session.extended if verdict.named else session.spec.name
    steps = [NextStep("Save the results, in Python.", f'result.save("{UNSAVED}")')] if session.out is None else []
    if verdict.stopped is not None:
        steps.append(NextStep(f"Diagnose again with more time, or make it shorter: {SHORTER}."))
    if verdict.named:
        told = "Compare both twins, best on a log that was not diagnosed."
        steps.append(
            NextStep(
                told, session.type("compare", *session.logs, "--twin", session.spec.name, "--twin", session.extended)
            )
        )
        words = ["vpptwin", "export", session.extended, "--format", "mjcf"]
        steps.append(NextStep("Use the extended twin elsewhere: write it as MJCF.", shlex.join(words)))
    shown = list(dict.fromkeys([session.spec.name, twin]))
    told = "View both twins beside a log." if len(shown) > 1 else "View the twin beside a log."
    beside = [part for each in shown for part in ("--twin", each)]
    steps.append(NextStep(told, session.type("play", session.logs[0], *beside)))
    if is_unexplained(verdict):
        steps.append(suggest_own_effect(verdict, session))
    else:
        steps += suggest_training(session.spec.robot, twin, bool(verdict.named))
    if experiment is not None and verdict.experiment is not None:
        steps.append(NextStep(f"Fly next: {experiment} See it in the twin first.", verdict.experiment.command))
    else:
        steps.append(NextStep(f"{advise_flight(verdict, meanings)} {advise_library(session.spec.robot)}".rstrip()))
    return steps


def is_unexplained(verdict: Verdict) -> bool:
    """Whether something is left that an effect of one's own might say."""
    return verdict.unexplained.significant or verdict.misfit is not None


def advise_flight(verdict: Verdict, meanings: Mapping[str, str]) -> str:
    """Which motion would tell more, where the library has no manoeuvre that decides."""
    rivals = [(cause, rival) for cause in verdict.named for rival in cause.also_explained_by]
    if rivals:
        cause, rival = max(rivals, key=lambda pair: pair[1].confidence)
        apart = f"{name_effect(cause.effect, meanings)} from {name_effect(rival.effect, meanings)}"
        return f"Log next: motion that separates {apart}: slower, faster or elsewhere than in these logs."
    hidden = [suspect for suspect in verdict.unseen if "which the twin lacks" not in suspect.reason]
    if hidden:
        named = join_words([name_effect(suspect.effect, meanings) for suspect in hidden[:3]])
        more = f" and {len(hidden) - 3} more" if len(hidden) > 3 else ""
        return f"Log next: motion that excites {named}{more}; the list of candidates says why these logs do not."
    return "Log next: another motion, as a check. Nothing here depends on it."


@by_robot
def advise_library(robot: Robot) -> str:
    """Where to find manoeuvres; nowhere for rigs of other people."""
    return ""


@by_robot
def suggest_training(robot: Robot, twin: str, extended: bool) -> list[NextStep]:
    """How to train on the twin: our tasks are for the drone."""
    return []


def suggest_own_effect(verdict: Verdict, session: Session) -> NextStep:
    """A file with an effect of one's own on the joint that is accused, and how to try it."""
    left = verdict.unexplained
    follows = f", which follows {join_words(left.depends_on)}" if left.depends_on else ""
    told = (
        f"Write an effect for the remainder{follows}: save these lines as own.py, put your law in, and diagnose again."
    )
    words = [*session.logs, "--twin", session.spec.name, "--effects", "own.py", "--out", str(session.out or UNSAVED)]
    return NextStep(told, session.type("diagnose", *words), write_own_effect(verdict, session.spec.robot))


def write_own_effect(verdict: Verdict, robot: Robot) -> str:
    """A Python file with an effect on the joint in which something is left; "" for a rig that only flies freely."""
    left, miss = verdict.unexplained, verdict.misfit
    told = " ".join([left.channel or "", *left.depends_on, miss.joint if miss is not None else ""])
    joints = {joint[0]: joint for joint in describe_joints(robot.model) if joint[0] not in robot.signals.driven}
    if not joints:
        return ""
    meant = [name for name in joints if re.search(rf"(?<!\w){re.escape(name)}(?!\w)", told)]
    joint, rotary, typical = joints[(meant or list(joints))[0]]
    follows = next((each for each in FOLLOWED if any(each in name for name in left.depends_on)), FOLLOWED[0])
    templates = Environment(loader=PackageLoader("vpptwin.report"), undefined=StrictUndefined)
    templates.filters["python"] = repr
    return templates.get_template("own_effect.py.j2").render(
        joint=joint, follows=follows, force="N m" if rotary else "N", size=float(f"{0.02 * typical:.1g}"),
        quantity=("rad" if rotary else "m") + ("/s" if follows == "velocity" else ""),
    )  # fmt: skip
