"""Entrants: what people do with a log and a model that disagree, each as its users would run it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from proving.simgap.answers import make_answer
from proving.simgap.scores import NOTHING, UNKNOWN
from proving.simgap.session import Session

BASE_RATE = {NOTHING: 2.0 / 12.0, UNKNOWN: 2.0 / 12.0}
"""Of the public deck of sessions."""


@dataclass(frozen=True)
class Reply:
    """What an entrant found before it is turned into an answer.

    Attributes:
        evidence: cause → log evidence, which `settle` turns into probabilities; None where it names nothing.
        probabilities: where the entrant has its own.
        parts: further keys of the answer.
    """

    evidence: Mapping[str, float] | None = None
    probabilities: Mapping[str, float] | None = None
    parts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Entrant:
    """One way to answer.

    Attributes:
        title: as the board calls it.
        answer: session and its folder → reply.
        limits: what it was not made for.
        needs: distribution whose version the board tells.
    """

    title: str
    answer: Callable[[Session, Path], Reply]
    limits: str
    needs: str = ""


def say_nothing(session: Session, home: Path) -> Reply:
    """The model is right."""
    return Reply(probabilities={NOTHING: 1.0}, parts=predict_nominal(session))


def say_everything(session: Session, home: Path) -> Reply:
    """The base rates of sessions, all causes alike; sizes as the typical ones, either sign where they have one."""
    share = (1.0 - sum(BASE_RATE.values())) / len(session.causes)
    parts = predict_nominal(session)
    if "watch" in session.tracks:
        parts = {
            "onset": {"probability": 0.75, "times": [session.runs[-1].time[-1] * (0.35 + 0.03 * k) for k in range(11)]}
        }
    sizes = {name: [cause.off, cause.off + cause.scale] for name, cause in session.causes.items()}
    return Reply(probabilities=BASE_RATE | dict.fromkeys(session.causes, share), parts=parts | {"sizes": sizes})


def predict_nominal(session: Session) -> dict[str, Any]:
    """Forecasts with the model as it is."""
    if "predict" not in session.tracks:
        return {"onset": {"probability": 0.0}} if "watch" in session.tracks else {}
    from proving.simgap.entrants.lab import Lab

    return {"forecasts": Lab(session).forecast()}


def fit(place: str) -> Callable[[Session, Path], Reply]:
    """An entrant that fits something with MuJoCo at hand; `place` is module:function."""

    def answer(session: Session, home: Path) -> Reply:
        from proving.simgap.entrants.lab import Lab

        lab = Lab(session)
        if "watch" in session.tracks:
            if not place.startswith("fits:fit_spreadsheet"):
                return Reply()
            from proving.simgap.entrants.watch import find_change

            return Reply(parts={"onset": find_change(lab)})
        module, _, name = place.partition(":")
        evidence, sizes, corrections = getattr(import_module(f"proving.simgap.entrants.{module}"), name)(lab)
        return Reply(evidence, None, {"sizes": sizes, "forecasts": lab.forecast(corrections)})

    return answer


def learn_network(session: Session, home: Path) -> Reply:
    """See network.py."""
    from proving.simgap.entrants.lab import Lab
    from proving.simgap.entrants.network import learn

    if "predict" not in session.tracks:
        return Reply()
    lab = Lab(session)
    return Reply(parts={"forecasts": lab.forecast(push=learn(lab))})


def run_vpptwin(session: Session, home: Path) -> Reply:
    """See own.py and onset.py."""
    if "watch" in session.tracks:
        from proving.simgap.entrants.onset import find_onset

        return Reply(parts={"onset": find_onset(session, home)})
    from proving.simgap.entrants.lab import Lab
    from proving.simgap.entrants.own import diagnose

    evidence, sizes, corrections, note = diagnose(session, home)
    parts = {"sizes": sizes, "forecasts": Lab(session).forecast(corrections)}
    return Reply(evidence, None, parts | ({"note": note} if note else {}))


ENTRANTS = {
    "nothing": Entrant("nothing is wrong", say_nothing, "a baseline"),
    "everything": Entrant("base rates", say_everything, "a baseline"),
    "spreadsheet": Entrant(
        "spreadsheet: residual force against one column", fit("fits:fit_spreadsheet"),
        "delays, limits, encoders' zeros and centres of mass have no column", "numpy",
    ),
    "regressor": Entrant(
        "Pinocchio's regressor, least squares", fit("fits:fit_regressor"),
        "made for exciting trajectories of arms, not for delays, limits or zeros", "pin",
    ),
    "sindy": Entrant("PySINDy, STLSQ", fit("fits:fit_sparse"), "made to find laws, not to tell look-alikes", "pysindy"),
    "ranking": Entrant(
        "one cause at a time, RMSE", fit("shots:rank"), "has no notion of noise; names whatever fits best", "mujoco",
    ),
    "pace": Entrant(
        "CMA-ES over all, as PACE", fit("shots:evolve"),
        "made to fit simulations to arms and legs with position servos, not to name a cause", "cma",
    ),
    "sysid": Entrant(
        "mujoco.sysid", fit("shots:identify"),
        "fits masses, friction, damping and gains of joints; no delays, limits or zeros", "mujoco",
    ),
    "network": Entrant("neural residual force", learn_network, "predicts, and names nothing", "scikit-learn"),
    "vpptwin": Entrant(
        "vpptwin diagnose", run_vpptwin, "watches by a program on its simulation (`onset.py`), no command", "vpptwin"
    ),
}  # fmt: skip
"""Id → entrant."""


def answer_session(entrant: str, session: Session, home: Path) -> dict[str, Any]:
    """An entrant's answer to a session.

    Raises:
        ValueError: where there is no such entrant.
    """
    from proving.simgap.entrants.settle import read_settings, settle

    if entrant not in ENTRANTS:
        raise ValueError(f"no entrant {entrant}: there are {', '.join(ENTRANTS)}")
    reply = ENTRANTS[entrant].answer(session, home)
    parts = dict(reply.parts)
    if reply.probabilities is not None and "name" in session.tracks:
        parts["probabilities"] = dict(reply.probabilities)
    elif reply.evidence is not None and "name" in session.tracks:
        parts["probabilities"] = settle(reply.evidence, read_settings(entrant))
        parts["evidence"] = dict(reply.evidence)
    return make_answer(entrant, session, parts)
