"""Progress in a file: a line now and then, not one a tenth of a second."""

import time

import pytest

from vpptwin.system.progress import open_bar, tell_stage, tell_wait


def test_a_file_gets_a_few_lines(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a hundred steps of a second each few are told, the last among them, and the stage that was named between."""
    now = 0.0
    with open_bar(desc="diagnose") as bar:
        monkeypatch.setattr(bar, "_time", lambda: now)
        bar.start_t = bar.last_print_t = now
        for step in range(100):
            now += 1.0
            bar.update()
            if step == 50:
                tell_stage(bar, "refitting")
    told = [line for line in capfd.readouterr().err.split("\r") if line.strip()]
    assert 2 <= len(told) <= 5
    assert "refitting" in told[-1]
    assert "100 steps" in told[-1]
    # What is refused at once leaves no bar.
    with open_bar(desc="diagnose") as bar:
        tell_stage(bar, "reading")
    assert capfd.readouterr().err.strip() == ""


def test_waiting_shows_itself_on_a_terminal_alone(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Text and time while it lasts, nothing left of it; a file gets nothing, or a line."""
    with tell_wait("compiling"):
        pass
    assert capfd.readouterr().err == ""
    monkeypatch.undo()
    with tell_wait("compiling", always=True):
        pass
    assert capfd.readouterr().err == "vpptwin: compiling\n"
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with tell_wait("compiling"):
        time.sleep(0.7)
    said = capfd.readouterr().err
    assert "compiling: 00:00" in said
    assert said.endswith("\r")
