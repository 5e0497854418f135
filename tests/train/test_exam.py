"""Exams while training: always the same flights, nothing of training disturbed, the best policy kept."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from tests.train.conftest import BRIEF, EXAMINED, read_log, tiny_config
from vpptwin.train.config import TrainConfig
from vpptwin.train.env.observe import ObservationTerms
from vpptwin.train.evaluate.flights import FAILED_ERROR, Exam, Flights
from vpptwin.train.learn.checkpoint import read_checkpoint
from vpptwin.train.learn.networks import Policy
from vpptwin.train.main import run_train
from vpptwin.train.stored import BEST_NAME

SMALL = (*BRIEF, "randomize=all", "exam_every=100", "exam_from=0", "exam_tracks=8")


def some_policy(seed: int) -> Policy:
    """A policy that does something."""
    torch.manual_seed(seed)
    return Policy(ObservationTerms())


def advance(exam: Exam, steps: int, total: int = 1000) -> None:
    """Have so many steps of the run be done."""
    exam.trainer = SimpleNamespace(collected_frames=steps, total_frames=total)  # type: ignore[assignment]


def sit(config: TrainConfig, policy: Policy, folder: Path) -> dict[str, float]:
    """The result of one exam in a run of its own."""
    exam = Exam(config, policy, folder)
    advance(exam, 100)
    result = exam()
    assert result is not None
    return result


def test_the_same_policy_gets_the_same_score(tmp_path: Path) -> None:
    """Again in the same run, in a run with another seed, in one without curriculum; another policy gets another."""
    exam = Exam(tiny_config(*SMALL), some_policy(0), tmp_path)
    results = []
    for steps in (100, 200, 300):
        advance(exam, steps)
        results.append(exam())
    assert results[0] == results[1] == results[2]
    for overrides in (("seed=5", "num_envs=8"), ("curriculum.enabled=false",), ("desynchronize=false", "critic=lstm")):
        assert sit(tiny_config(*SMALL, *overrides), some_policy(0), tmp_path) == results[0]
    assert sit(tiny_config(*SMALL), some_policy(1), tmp_path) != results[0]
    assert sit(tiny_config(*SMALL, "noise=0"), some_policy(0), tmp_path) != results[0]


def test_exams_leave_random_numbers_alone(tmp_path: Path) -> None:
    """Neither torch's nor numpy's global state moves."""
    policy = some_policy(0)
    torch.manual_seed(7)
    before, numpy_before = torch.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002
    sit(tiny_config(*SMALL), policy, tmp_path)
    assert torch.equal(torch.get_rng_state(), before)
    np.testing.assert_array_equal(np.random.get_state()[1], numpy_before)  # noqa: NPY002


def test_training_is_the_same_with_and_without_exams(tiny_run: Path, tmp_path: Path) -> None:
    """Raw and averaged weights and every other log end bit-equal; without exams there is no best policy."""
    plain = run_train([*EXAMINED, f"out={tmp_path / 'plain'}", "exam_every=0"])
    contents = [read_checkpoint(run, flying=False) for run in (tiny_run, plain)]
    for weights in ([c["policy"] for c in contents], [c["training"]["trainer"]["loss_module"] for c in contents]):
        assert weights[0].keys() == weights[1].keys()
        assert all(torch.equal(weights[0][key], weights[1][key]) for key in weights[0])
    np.testing.assert_array_equal(read_log(plain, "return"), read_log(tiny_run, "return"))
    assert not (plain / BEST_NAME).exists()
    assert not list((plain / "log" / "scalars").glob("exam*"))


def test_exams_come_when_they_are_due(tiny_run: Path) -> None:
    """Every 256 of 1024 steps, and the share that is logged is of eight flights."""
    steps, score = read_log(tiny_run, "exam_score_m").T
    assert steps.tolist() == [256, 512, 768, 1024]
    assert ((score > 0.0) & (score <= FAILED_ERROR)).all()
    for name in ("exam_failures", "exam_success"):
        share = read_log(tiny_run, name)[:, 1]
        np.testing.assert_array_equal(8.0 * share, np.round(8.0 * share))


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (("exam_every=300", "exam_from=0"), [300, 600, 900, 1000]),
        (("exam_every=100", "exam_from=0.75"), [750, 850, 950, 1000]),
        (("exam_every=5000",), [1000]),
        (("exam_every=0",), []),
    ],
)
def test_schedule(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overrides: tuple[str], expected: list[int]) -> None:
    """With batches of 50 steps: every so many, none early, one at the end of training, none if they are off."""
    none = np.zeros(1, bool)
    monkeypatch.setattr(Exam, "_fly", lambda self: Flights(np.zeros(1), np.zeros(1), none, none, none, none, 0, 0))
    exam, taken = Exam(tiny_config(*overrides), some_policy(0), tmp_path), []
    for steps in range(50, 1001, 50):
        advance(exam, steps)
        if exam() is not None:
            taken.append(steps)
    assert taken == expected


def test_the_best_policy_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of scores 0.4, 0.2, 0.3, 0.2 and 0.45 the last of the lowest stays, as it was then, to fly but not to resume."""
    scores = iter([0.4, 0.2, 0.3, 0.2, 0.45])
    none = np.zeros(1, bool)
    monkeypatch.setattr(
        Exam, "_fly", lambda self: Flights(np.array([next(scores)]), np.zeros(1), none, none, none, none, 0, 0)
    )
    policy, kept = some_policy(0), []
    exam = Exam(tiny_config(*SMALL), policy, tmp_path)
    for k in range(5):
        with torch.no_grad():
            policy.body[1].bias.fill_(float(k))
        advance(exam, 100 * (k + 1))
        exam()
        content = read_checkpoint(tmp_path / BEST_NAME)
        kept.append((content["steps"], float(content["policy"]["body.1.bias"][0])))
    assert kept == [(100, 0.0), (200, 1.0), (200, 1.0), (400, 3.0), (400, 3.0)]
    assert exam.best == pytest.approx(0.2)
    assert read_checkpoint(tmp_path / BEST_NAME)["training"] is None


@pytest.mark.parametrize(("failed", "error"), [([False, True], 0.1), ([True, True], np.nan)])
def test_the_error_is_of_flights_that_did_not_fail(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failed: list[bool], error: float
) -> None:
    """A craft that fell metres away counts in the score, as `FAILED_ERROR`, and not in the error."""
    none = np.zeros(2, bool)
    flown = Flights(np.array([0.1, 7.0]), np.zeros(2), np.array(failed), none, none, none, 0, 0)
    monkeypatch.setattr(Exam, "_fly", lambda self: flown)
    exam = Exam(tiny_config(*SMALL), some_policy(0), tmp_path)
    advance(exam, 100, 100)
    logged = exam()
    assert logged is not None
    assert logged["exam_error_m"] == pytest.approx(error, nan_ok=True)
    assert logged["exam_score_m"] == pytest.approx(FAILED_ERROR if all(failed) else (0.1 + FAILED_ERROR) / 2.0)


def test_the_best_of_a_run_is_the_one_with_the_lowest_score(tiny_run: Path) -> None:
    """best.pt is from where the lowest score was logged; it flies, while training goes on from the last."""
    steps, score = read_log(tiny_run, "exam_score_m").T
    lowest = steps[len(score) - 1 - np.argmin(score[::-1])]
    best, last = read_checkpoint(tiny_run / BEST_NAME), read_checkpoint(tiny_run, flying=False)
    assert (best["steps"], last["steps"]) == (lowest, 1024)
    assert read_checkpoint(tiny_run)["steps"] == lowest
    again = sit(tiny_config(*SMALL), load(best), tiny_run.parent)
    assert again["exam_score_m"] == pytest.approx(score.min(), rel=1e-6)  # the log has fewer digits


def load(content: dict) -> Policy:
    """The policy in a checkpoint."""
    policy = Policy(ObservationTerms())
    policy.load_state_dict(content["policy"])
    return policy
