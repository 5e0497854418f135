"""A twin out of a log and a model's name, where `vpptwin inspect` has no doubt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vpptwin.logs.spelling import list_flights
from vpptwin.mapping.free_body import guess_all
from vpptwin.mapping.inspect import compose_twin, list_entries, print_guesses
from vpptwin.mapping.models import find_model
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError
from vpptwin.system.files import write_whole
from vpptwin.twin.robot.model import compile_model


def make_twin(logs: Sequence[Path], model: str) -> Path:
    """Write MODEL_twin.yaml into the current folder, and show the mapping.

    Args:
        logs: of which the first tells what is what.
        model: as of `find_model`.

    Returns:
        The twin.

    Raises:
        InputError: if anything about the first log is in doubt, or another twin of that name is there.
    """
    path = find_model(model)
    log = list_flights(logs[0])[0]
    compiled, signals = compile_model(path), survey(log)[1]
    guesses = guess_all(compiled, signals)
    print_guesses(guesses)
    doubts = [f"{guess.target}: {doubt}" for guess in guesses for doubt in guess.doubts]
    if doubts or not guesses:
        found = (
            f"{len(doubts)} doubts about {log} ({doubts[0]})" if doubts else f"{path} has no hinge, slide or actuator"
        )
        action = f"run `vpptwin inspect {log} --model {model}`, correct what it writes, and give that as --twin"
        raise InputError(found, "none, to go on without a twin YAML", action)
    out = Path(f"{path.stem}_twin.yaml")
    content = compose_twin(path, out, str(log), guesses)
    if not out.exists():
        return write_whole(out, content, force=False)
    if list_entries(out.read_text()) != list_entries(content):
        raise InputError(f"{out} is there already, and says something else", "none", f"give --twin {out}, or move it")
    return out
