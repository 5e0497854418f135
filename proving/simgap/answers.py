"""An entrant's answer to a session: one JSON file, in any language; what is wrong with it is told in one line."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jsonschema import Draft202012Validator

from proving.simgap.scores import complete_answer
from proving.simgap.session import HORIZONS, VERSION, Session

SCHEMA = json.loads(Path(__file__).with_name("answer.schema.json").read_text())


def read_answer(path: Path, session: Session) -> dict[str, Any]:
    """Read and check an answer.

    Raises:
        ValueError: where it is none, with what was found, what was expected and where.
    """
    try:
        content = json.loads(path.read_text())
    except (OSError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: {error}; write one JSON object as answer.schema.json has it") from None
    check_answer(content, session, str(path))
    return dict(content)


def check_answer(content: object, session: Session, where: str = "answer") -> None:
    """Check an answer against the schema and the session.

    Raises:
        ValueError: where something is missing, not known or of another shape.
    """
    for error in sorted(Draft202012Validator(SCHEMA).iter_errors(content), key=lambda e: list(e.path)):
        place = "/".join(map(str, error.path)) or "the object"
        raise ValueError(f"{where}: {place}: {error.message[:200]}")
    assert isinstance(content, dict)  # says the schema
    if content["session"] != session.name:
        raise ValueError(f"{where} answers {content['session']}, not {session.name}")
    try:
        if "probabilities" in content:
            complete_answer(content["probabilities"], list(session.causes))
        if strange := sorted(set(content.get("sizes", {})) - set(session.causes)):
            raise ValueError(f"sizes of {', '.join(strange)}: write ids of session.json's causes")
        if "forecasts" in content:
            check_forecasts(content["forecasts"], session)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def check_forecasts(forecasts: Sequence[object], session: Session) -> None:
    """Check that there are windows of samples of horizons of columns, all finite."""
    if len(forecasts) != len(session.windows):
        raise ValueError(f"forecasts of {len(forecasts)} windows: held_out.csv has {len(session.windows)}")
    for k, window in enumerate(forecasts):
        try:
            values = np.array(window, float)
        except ValueError:
            raise ValueError(f"forecasts/{k}: trajectories of unequal length") from None
        if values.shape[1:] != (len(HORIZONS), len(session.predicted)):
            wanted = f"(samples, {len(HORIZONS)} horizons, {len(session.predicted)} columns)"
            raise ValueError(f"forecasts/{k} has shape {values.shape}: write {wanted}")
        if not np.isfinite(values).all():
            raise ValueError(f"forecasts/{k} has values that are not finite")


def make_answer(entrant: str, session: Session, parts: Mapping[str, Any]) -> dict[str, Any]:
    """An answer with its head; numbers in six digits."""

    def trim(value: object) -> object:
        if isinstance(value, Mapping):
            return {str(k): trim(v) for k, v in value.items()}
        if isinstance(value, (list, tuple, np.ndarray)):
            return [trim(v) for v in value]
        return float(f"{value:.6g}") if isinstance(value, (float, np.floating)) else value

    head = {"simgap": VERSION, "entrant": entrant, "session": session.name}
    return {**head, **{name: trim(part) for name, part in parts.items()}}
