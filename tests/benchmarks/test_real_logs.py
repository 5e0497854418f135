"""The table of measured logs: every log has its data, its twin and a verdict that is weighed rightly."""

from __future__ import annotations

from pathlib import Path

import pytest
import real_logs

from vpptwin.twin import load_twin

ROOT = Path(__file__).resolve().parents[2]


def test_every_log_and_twin_is_there(shared_data: Path) -> None:
    """And a right answer ends as an effect of that twin does, so that no slip of the pen makes all answers wrong."""
    logs = real_logs.list_logs()
    assert len({(log.rig, log.log, log.twin) for log in logs}) == len(logs) == 20
    for log in logs:
        assert (shared_data / log.rig / log.log).exists()
    for rig, twin in sorted({(log.rig, log.twin) for log in logs}):
        known = [effect.id for effect in load_twin(ROOT / "examples" / rig / twin).catalogue]
        for log in (each for each in logs if (each.rig, each.twin) == (rig, twin)):
            assert not log.right or any(effect.endswith(log.right) for effect in known)


@pytest.mark.parametrize(
    ("causes", "expected"),
    [
        ([], "nothing named"), ([("a.coulomb", 0.5)], "right"), ([("a.coulomb", 0.5), ("a.mass", 0.89)], "in part"),
        ([("a.mass", 0.5)], "not so by hand"), ([("a.mass", 0.999)], "wrong"),
        ([("a.coulomb", 0.999), ("a.mass", 0.95)], "wrong"),
    ],
)  # fmt: skip
def test_what_is_claimed_and_not_so_is_wrong(causes: list[tuple[str, float]], expected: str) -> None:
    """What is suggested may differ from a fit by hand, what is claimed may not."""
    assert real_logs.weigh(causes, ("coulomb",)) == expected


def test_the_table_counts_its_marks(capsys: pytest.CaptureFixture[str]) -> None:
    """A line a log, and a refusal stands in its."""
    log = {"rig": "cart", "log": "run.csv", "twin": "cart.yaml", "by_hand": "friction"}
    found = log | {"causes": [("a.coulomb", 0.5)], "chi2": [30.0, 1.2], "left": False, "marks": "right"}
    real_logs.print_table([found, log | {"error": "run.csv: empty", "marks": "refused"}])
    told = capsys.readouterr().out
    assert "| cart, run (cart) | friction | `a.coulomb` 50 % | 30 → 1.2 | no | right |" in told
    assert "run.csv: empty" in told
    assert "right 1, refused 1, of 2" in told
