"""`vpptwin train`: from overrides to a run's folder. Help and refusals come before torch is loaded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vpptwin.train.overrides import compose_config, describe_options, parse_overrides
from vpptwin.train.stored import need_checkpoint


def run_train(overrides: Sequence[str]) -> Path:
    """Train a policy.

    Args:
        overrides: in Hydra's syntax, e.g. `["task=hover", "num_envs=256"]`; `--help` prints the options and exits.

    Returns:
        The run's folder, which holds checkpoint.pt, config.yaml and log/scalars/*.csv.

    Raises:
        InputError: on overrides that make no sense, a run that cannot be resumed, or an unwritable folder.
    """
    if "--help" in overrides or "-h" in overrides:
        print(describe_options())
        raise SystemExit(0)
    config = compose_config(overrides)
    if config.resume is not None:
        need_checkpoint(config.resume, flying=False)
    from vpptwin.train.run import start_run

    return start_run(config, parse_overrides(overrides))
