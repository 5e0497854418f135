"""Where the scalars of a run go."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from torchrl.record import CSVLogger
from torchrl.record.loggers import Logger, TensorboardLogger


class Loggers(Logger):
    """Several of TorchRL's loggers as one.

    Args:
        loggers: what each scalar goes to.
        folder: of the run.
    """

    def __init__(self, loggers: Sequence[Logger], folder: Path) -> None:
        self.loggers = list(loggers)
        super().__init__(exp_name="log", log_dir=str(folder))

    def _create_experiment(self) -> None:
        """Each has its own."""

    def log_scalar(self, name: str, value: float, step: int | None = None) -> None:
        """Log a number at a step."""
        for logger in self.loggers:
            logger.log_scalar(name, value, step)

    def log_video(self, name: str, video: object, **kwargs: object) -> None:
        """No run logs videos."""
        raise NotImplementedError

    def log_hparams(self, cfg: object) -> None:
        """No run logs hyperparameters: config.yaml holds them."""
        raise NotImplementedError

    def log_histogram(self, name: str, data: Sequence[float], **kwargs: object) -> None:
        """No run logs histograms."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"Loggers({self.loggers})"


def make_logger(names: Sequence[str], folder: Path) -> Logger:
    """The loggers of a run: `csv` writes log/scalars/*.csv, `tensorboard` tensorboard/."""
    made: list[Logger] = []
    if "csv" in names:
        made.append(CSVLogger("log", log_dir=str(folder)))
    if "tensorboard" in names:
        made.append(TensorboardLogger("tensorboard", log_dir=str(folder)))
    return Loggers(made, folder)
