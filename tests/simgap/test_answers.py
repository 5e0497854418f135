"""Answers: what is wrong with one is told in one line; every entrant's is valid."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from proving.simgap.answers import check_answer, read_answer
from proving.simgap.entrants import answer_session
from proving.simgap.session import Session
from proving.simgap.sets import list_sessions
from proving.simgap.storage import read_session, read_truth
from tests.simgap.builders import draw_small_set

pytest.importorskip("mujoco")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cart and a pendulum."""
    return draw_small_set(tmp_path_factory.mktemp("set"), pendula=[0], carts=[0])


@pytest.fixture(scope="module")
def session(drawn: Path) -> Session:
    """The cart."""
    return read_session(list_sessions(drawn)[0])


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no key of the schema": ({"guess": 1}, "guess"),
    "another session": ({"session": "carts-0099"}, "answers carts-0099, not carts-0000"),
    "sum": ({"probabilities": {"nothing": 0.5}}, "sum to 0.5"),
    "negative": ({"probabilities": {"nothing": 1.2, "unknown": -0.2}}, "1.2 is greater than the maximum"),
    "unknown cause": ({"probabilities": {"gremlins": 1.0}}, "gremlins"),
    "sizes of what is no cause": ({"sizes": {"gremlins": [1.0]}}, "gremlins"),
    "no sizes": ({"sizes": {"x": []}}, "non-empty"),
    "windows missing": ({"forecasts": []}, "held_out.csv has 12"),
    "shape": ({"forecasts": [[[[0.0]]]] * 12}, r"has shape \(1, 1, 1\)"),
    "unequal": ({"forecasts": [[[[0.0]], [[0.0], [1.0]]]] * 12}, "unequal length"),
    "onset": ({"onset": {"probability": 2.0}}, "maximum"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_answer_is_told(session: Session, name: str) -> None:
    """In one line, with what was expected."""
    change, said = WRONG[name]
    content = {"simgap": 1, "entrant": "me", "session": session.name} | change
    with pytest.raises(ValueError, match=said) as raised:
        check_answer(content, session)
    assert "\n" not in str(raised.value)


def test_broken_file_is_told(session: Session, tmp_path: Path) -> None:
    """No JSON, and no file."""
    path = tmp_path / "answer.json"
    for text in ("{", "[]"):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"answer\.json"):
            read_answer(path, session)
    with pytest.raises(ValueError, match="write one JSON object"):
        read_answer(tmp_path / "none.json", session)


@pytest.mark.parametrize("entrant", ["nothing", "everything", "spreadsheet", "regressor"])
def test_answers_of_entrants_are_valid(drawn: Path, entrant: str) -> None:
    """On both rigs, JSON and back."""
    for home in list_sessions(drawn):
        session = read_session(home)
        check_answer(json.loads(json.dumps(answer_session(entrant, session, home))), session, entrant)


def test_true_correction_predicts_better(tmp_path: Path) -> None:
    """Ids and sizes mean to MuJoCo what they mean to the worlds: the truth lowers the error of a second's forecast."""
    import numpy as np

    from proving.simgap.entrants.corrections import Correction
    from proving.simgap.entrants.lab import Lab

    checked = set()
    folder = draw_small_set(tmp_path, 11, carts=list(range(6)), quadrotors=[0, 1], servos=[0, 1])
    for home in list_sessions(folder):
        session, truth = read_session(home), read_truth(folder, home)
        kind = Correction(truth.answer + ".", 0.0).kind
        if truth.answer not in session.causes or kind in ("stiction", "spring", "cogging", "dead_band", "offset"):
            continue
        if kind in checked or (truth.seen is not None and truth.seen < 20.0):
            continue
        lab = Lab(session)
        corrected = [Correction(truth.answer, truth.sizes[truth.answer])]
        before, after = (float(np.sqrt(np.nanmean(lab.miss(some)[:, 4] ** 2))) for some in ((), corrected))
        assert after < 0.8 * before, (home.name, truth.answer, before, after)
        checked.add(kind)
    assert len(checked) >= 4, checked
