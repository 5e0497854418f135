"""Where a run's scalars go: CSV, TensorBoard, or both alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tests.train.conftest import read_log
from vpptwin.train.config import LOGGERS
from vpptwin.train.learn.progress import make_logger


def read_events(run: Path) -> dict[str, np.ndarray]:
    """Rows (steps, value) of every scalar that TensorBoard is shown."""
    events = EventAccumulator(str(run / "tensorboard"))
    events.Reload()
    return {tag: np.array([(e.step, e.value) for e in events.Scalars(tag)]) for tag in events.Tags()["scalars"]}


def test_both_loggers_get_the_same(tiny_run: Path) -> None:
    """Every scalar of the CSV files is on TensorBoard, at the same steps with the same values."""
    shown = read_events(tiny_run)
    names = {path.stem for path in (tiny_run / "log" / "scalars").glob("*.csv")}
    assert names == set(shown)
    assert {"return", "success", "difficulty", "exam_score_m", "loss_critic"} <= names
    for name, rows in shown.items():
        np.testing.assert_allclose(read_log(tiny_run, name), rows, rtol=1e-6, err_msg=name)  # float32


@pytest.mark.parametrize("chosen", [*[[name] for name in LOGGERS], list(LOGGERS), []])
def test_only_the_chosen_ones_write(chosen: list[str], tmp_path: Path) -> None:
    """CSV files, TensorBoard's events, both or nothing."""
    logger = make_logger(chosen, tmp_path)
    for step in (1, 2):
        logger.log_scalar("return", 0.5 * step, step)
    assert (tmp_path / "log" / "scalars" / "return.csv").exists() == ("csv" in chosen)
    if "csv" in chosen:
        assert read_log(tmp_path, "return").tolist() == [[1.0, 0.5], [2.0, 1.0]]
    assert bool(list(tmp_path.glob("tensorboard/events*"))) == ("tensorboard" in chosen)
