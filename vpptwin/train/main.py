"""`vpptwin train`: from Hydra overrides to a run's folder. Help and refusals come before torch is loaded."""

from __future__ import annotations

import difflib
import inspect
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from textwrap import wrap

from hydra import compose, initialize
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vpptwin.system.errors import InputError, suggest
from vpptwin.system.trust import trust
from vpptwin.train.config import HELP, PRESETS, Curriculum, Ramp, TrainConfig, to_config
from vpptwin.train.env.tasks import HOVER, TASKS
from vpptwin.train.stored import need_checkpoint

EXAMPLES = """\
Numbers inside a task or a ramp go by dotted names, for example:

  task.episode=8   'task.start.theta=[-3,3]'   task.weights.integral=0.4
  learning_rate.start=3e-4   exploration.finish=0.9   curriculum.difficulty.finish=0.4"""


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


def compose_config(overrides: Sequence[str]) -> TrainConfig:
    """Build the configuration from overrides such as `task=hover`; files of `effects` are run, as the user named them.

    Raises:
        InputError: on an unknown option or task, a value of the wrong type, or numbers that make no sense.
    """
    given = []
    for override in parse_overrides(overrides).values():  # a single name stands for a list of one: `randomize=all`
        key, value = override.key_or_group, override.value()
        alone = key in ("randomize", "effects", "loggers") and isinstance(value, str)
        given.append(f"{key}=[{value}]" if alone else str(override.input_line))
    store_options()
    try:
        with initialize(version_base="1.3", config_path=None):
            composed = OmegaConf.to_container(compose(config_name="train", overrides=given), resolve=True)
            assert isinstance(composed, dict)
            config = to_config({str(key): value for key, value in composed.items()})
            trust(config.effects)
            return config
    except (HydraException, OmegaConfBaseException) as error:
        reason = str(error.__cause__ or error).strip().splitlines()[0]
        raise InputError(f"{' '.join(overrides)}: {reason}", "values of an option's type", HELP) from error


@cache
def store_options() -> None:
    """Tell Hydra the options, once per process."""
    store = ConfigStore.instance()
    store.store(name="schema", node=TrainConfig)
    store.store(name="train", node={"defaults": ["schema", {"task": HOVER.name}, {"preset": "fast"}, "_self_"]})
    for name, changes in PRESETS.items():
        store.store(group="preset", name=name, package="_global_", node=changes | {"preset": name})
    for task in TASKS.values():
        store.store(group="task", name=task.name, node=task)


def parse_overrides(overrides: Sequence[str]) -> dict[str, Override]:
    """Overrides by the name of their option.

    Raises:
        InputError: on what is no override, an option that does not exist (naming the closest that do), or no task.
    """
    known = list_options()
    nested = {f.name: vars(value) for f in fields(TrainConfig) if is_dataclass(value := getattr(TrainConfig(), f.name))}
    del nested["task"]
    try:
        parsed = OverridesParser.create().parse_overrides(list(overrides))
    except HydraException as error:
        raise InputError(f"{' '.join(overrides)}: no overrides", "key=value, separated by spaces", HELP) from error
    for override in parsed:
        key = override.key_or_group
        if key not in known or override.is_delete() or override.is_add() or override.is_sweep_override():
            close = difflib.get_close_matches(key, known, n=3, cutoff=0.4) or known[:4]
            raise InputError(f"unknown option {override.input_line!r}", f"one such as {', '.join(close)}", HELP)
        choices: Collection[str] = {"task": [*TASKS], "preset": [*PRESETS]}.get(key, [])
        if choices and override.value() not in choices:
            advice = suggest(str(override.value()), choices, HELP)
            raise InputError(f"unknown {key} {override.value()!r}", f"one of {', '.join(choices)}", advice)
        if key in nested and not isinstance(override.value(), dict):
            parts = ", ".join(f"{key}.{name}" for name in nested[key])
            raise InputError(override.input_line or key, f"a value for each part: {parts}", HELP)
    return {override.key_or_group: override for override in parsed}


def list_options(node: object = None, prefix: str = "") -> list[str]:
    """Dotted names of every option."""
    node = TrainConfig() if node is None else node
    names = []
    assert is_dataclass(node)
    for f in fields(node):
        value = getattr(node, f.name)
        if prefix + f.name != "task.name":
            names.append(prefix + f.name)
        if is_dataclass(value):
            names += list_options(value, f"{prefix}{f.name}.")
    return names


def describe_options() -> str:
    """Every option with its default and its line of help, for `vpptwin train --help`."""
    texts = dict(re.findall(r"^    (\w+): (.+)$", inspect.getdoc(TrainConfig) or "", flags=re.MULTILINE))
    config = TrainConfig()
    lines = ["Options, as Hydra overrides key=value:", ""]
    for f in fields(config):
        value = getattr(config, f.name)
        if f.name == "task":
            shown, texts[f.name] = HOVER.name, f"{texts[f.name].rstrip('.')}: {', '.join(TASKS)}."
        elif isinstance(value, Ramp):
            shown = f"{value.start:g}→{value.end:g}"
        elif isinstance(value, Curriculum):
            shown = f"{value.difficulty.start:g}→{value.difficulty.end:g}"
        else:
            shown = "null" if value is None else str(value).replace(" ", "").replace("'", "")
        lines.append(f"  {f.name + '=' + shown:<30} {texts[f.name]}")
    for name, changes in PRESETS.items():
        if changes:
            changed = " ".join([f"preset={name} changes", *(f"{key}={value}" for key, value in flatten(changes))])
            lines += ["", *wrap(changed, 120, subsequent_indent="  ")]
    lines += ["", "  --trust                        run the Python files that a twin or a run to resume names, too"]
    return "\n".join([*lines, "", EXAMPLES])


def flatten(values: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Dotted names and values, as they are written on the command line."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flatten(value, f"{prefix}{key}.")
        else:
            yield prefix + key, "null" if value is None else str(value).replace(" ", "")
