"""Whether a run fits into memory: told before it starts, not by a kill."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

from vpptwin.system.errors import InputError
from vpptwin.system.trust import check_trusted
from vpptwin.train.config import TrainConfig
from vpptwin.train.env.observe import privileged_size
from vpptwin.train.env.randomize import Priors, name_effects
from vpptwin.twin import load_twin

GIB = 2**30
ADVICE = "lower num_envs or rollout"
CONTAINER = Path("/sys/fs/cgroup")
"""Where Linux tells what a container may use."""


def check_run(config: TrainConfig) -> None:
    """Refuse a run that does not fit into this machine's memory.

    Raises:
        InputError: saying what it needs and what is free; as `load_twin` and `name_effects` too.
    """
    simulations, step = size_simulation(config), size_step(config)
    batch = config.num_envs * config.rollout
    needed = 0 if config.on_device and config.device != "cpu" else batch * step  # a card tells of its own memory
    if config.exam_every:
        needed += config.exam_tracks * simulations
    if config.collector == "local" or os.environ.get("RAY_ADDRESS", "") in ("", "local"):
        needed += config.num_envs * simulations
    compare(config, needed)


def check_share(config: TrainConfig) -> None:
    """Refuse one worker's share of a run if it does not fit into the memory of the machine that it runs on.

    Raises:
        InputError: saying what it needs and what is free; as `load_twin` and `name_effects` too.
    """
    share = config.num_envs // config.workers
    # The steps are in the collector's buffer and in the message to the head.
    compare(config, share * (size_simulation(config) + 2 * config.rollout * size_record(config)))


def compare(config: TrainConfig, needed: int) -> None:
    """Raise an InputError if fewer than `needed` bytes are free."""
    free = find_free()
    if needed > free:
        found = f"num_envs={config.num_envs} with rollout={config.rollout} needs about {needed / GIB:.1f} GiB of memory"
        raise InputError(found, f"at most the {free / GIB:.1f} GiB that are free", ADVICE)


def size_simulation(config: TrainConfig) -> int:
    """Bytes of a simulation: its constants, its state and the one before, its sensors and its episode.

    Measured, as growth of the resident memory by 20000 simulations that were made and flown: 4.9 kB with the defaults
    (20 parameters), 6.4 kB with randomize=all (51), 6.0 kB with preset=paper; this gives 5.3, 7.1 and 6.6 kB.
    """
    memory, width = critic_shape(config)
    return 4000 + 50 * count_parameters(config) + 8 * memory * width


def size_record(config: TrainConfig) -> int:
    """Bytes that a collector keeps of a step: what the critic sees before and after it, and 166 of all else."""
    memory, width = critic_shape(config)
    return 166 + 8 * memory * width


def size_step(config: TrainConfig) -> int:
    """Bytes that a run needs at its peak for every step of a batch: copies of the record, the critic's layers.

    Measured, as growth of the peak of resident memory from 8 to 24 or 32 steps of 2000 simulations: 2.4 kB with the
    defaults, 3.2 kB with randomize=all, 10.5 kB with preset=paper; this gives 2.6, 3.5 and 11.6 kB. A whole run of 8000
    simulations with 16 steps took 0.40 GB more than one of a single simulation, and is estimated at 0.38 GB.
    """
    memory, width = critic_shape(config)
    lstm = config.critic_lstm if config.critic == "lstm" else 0
    return 3 * size_record(config) + 8 * max(config.critic_hidden) + 4 * memory * (width + lstm)


def critic_shape(config: TrainConfig) -> tuple[int, int]:
    """Steps and numbers of each that the critic sees."""
    width = privileged_size(count_parameters(config)) if config.privileged else len(config.observation.names)
    return config.critic_memory, width


def count_parameters(config: TrainConfig) -> int:
    """Parameters that are drawn at every reset."""
    check_trusted(config.effects, "the configuration of training")
    spec = load_twin(config.twin, config.effects)
    randomized = name_effects(config.randomize, spec.catalogue, spec.intervals)
    return len(Priors.of([effect for effect in spec.catalogue if effect.id in randomized]).keys)


def find_free() -> int:
    """Bytes that this process can still get, by the machine and by the container that it may be in."""
    free = int(psutil.virtual_memory().available)
    try:
        limit = int((CONTAINER / "memory.max").read_text())
        used = int((CONTAINER / "memory.current").read_text())
        counts = dict(line.split() for line in (CONTAINER / "memory.stat").read_text().splitlines())
    except (OSError, ValueError):  # no container, or one without a limit, which reads "max"
        return free
    return min(free, limit - used + int(counts.get("inactive_file", 0)))


@contextmanager
def explain_exhaustion(config: TrainConfig) -> Iterator[None]:
    """Turn memory that ran out in spite of the checks into one line.

    Raises:
        InputError: in place of a MemoryError, or of what torch raises instead.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not isinstance(error, MemoryError) and not any(sign in str(error) for sign in TORCH_SIGNS):
            raise
        found = f"memory ran out with num_envs={config.num_envs} and rollout={config.rollout}"
        raise InputError(found, "a run that fits into memory", ADVICE) from error


TORCH_SIGNS = ("can't allocate memory", "bad_alloc", "CUDA out of memory")
"""What tells torch's RuntimeError of memory that ran out from others."""
