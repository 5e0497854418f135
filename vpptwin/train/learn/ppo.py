"""PPO assembled from TorchRL: collector, clipped loss, generalized advantages, trainer and its hooks."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torchrl.modules import ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.trainers import LRSchedulerHook
from torchrl.trainers.algorithms import PPOTrainer

from vpptwin.system.errors import InputError
from vpptwin.train.config import TrainConfig
from vpptwin.train.env.environments import find_device
from vpptwin.train.env.observe import OBSERVATION
from vpptwin.train.evaluate.flights import Exam
from vpptwin.train.learn.checkpoint import SaveCheckpoint, build_policy, make_policy, read_checkpoint
from vpptwin.train.learn.collect import make_collector, start_env
from vpptwin.train.learn.networks import Critic, Exploration, Policy, make_actor
from vpptwin.train.learn.progress import EpisodeStatistics, ProgressBar, Simulations, make_logger
from vpptwin.train.learn.updates import Advantages, Averaging, ExplorationRamp, LipschitzBound, Minibatches
from vpptwin.train.stored import FILE_NAME

FAULTS = "faults"
"""Folder in that of a run for simulations that diverged."""
VALUE_SCALE = 10.0
"""Value of resting on the target for ever, in the critic's units: rewards are scaled to it."""


@dataclass
class Training:
    """The parts of a run that are put together."""

    trainer: PPOTrainer  # TorchRL's trainer, ready to `train()`
    simulations: Simulations  # what it collects from
    policy: Policy  # what it trains
    bar: ProgressBar  # the progress bar


def start_from(policy: Policy, config: TrainConfig) -> None:
    """Take over the weights of `config.init_from`.

    Raises:
        InputError: if it is no checkpoint, or its network or inputs are others than those of this run.
    """
    content = read_checkpoint(str(config.init_from))
    other, trained = build_policy(content, config.init_from)
    if trained.observation != config.observation or trained.hidden != config.hidden:
        found, expected = (
            f"setup={c.setup} paper_inputs={c.paper_inputs} hidden={c.hidden}" for c in (trained, config)
        )
        raise InputError(f"init_from={config.init_from} has {found}", expected, "give both the same options")
    policy.load_state_dict(other.state_dict())


def build_training(config: TrainConfig, folder: Path, saved: dict[str, Any] | None = None) -> Training:
    """Put a run together.

    Raises:
        InputError: if the twin or an effect is unknown, or `saved` does not fit the configuration.
    """
    torch.set_num_threads(config.torch_threads)
    torch.manual_seed(config.seed)
    device = find_device(config.device)
    env = start_env(config, folder / FAULTS, saved, device)
    policy = make_policy(config).to(device)
    if saved is None and config.init_from is not None:
        start_from(policy, config)
    exploration = Exploration(policy, config.exploration.at(0.0), config.learn_exploration).to(device)
    actor = make_actor(exploration)
    names = OBSERVATION if config.privileged else config.observation.names
    lstm = config.critic_lstm if config.critic == "lstm" else 0
    width = env.episodes.seen.shape[-1]
    values = Critic(names, width, config.critic_hidden, lstm, config.magnify)
    critic = ValueOperator(values, in_keys=["critic_observation"]).to(device)
    collection = make_collector(config, actor, env, folder / FAULTS, saved["steps"] if saved else 0)
    batch = config.num_envs * config.rollout
    loss = ClipPPOLoss(
        actor, critic, clip_epsilon=config.clip, entropy_bonus=False, critic_coeff=config.critic_weight,
        loss_critic_type="l2", functional=False,
    )  # fmt: skip
    optimizer = torch.optim.Adam(loss.parameters(), lr=config.learning_rate.start, fused=True)
    ramp, batches = config.learning_rate, -(-config.total_steps // batch)
    scheduler = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda n: ramp.at(n / batches) / ramp.start)
    reward_scale = (1.0 - config.discount) * VALUE_SCALE / config.task.weights.best
    advantages = Advantages(critic.module, config.discount, config.lmbda, reward_scale, config.advantage_groups)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PPOTrainer announces that it is a prototype
        trainer = PPOTrainer(
            collector=collection.collector, total_frames=config.total_steps, frame_skip=1, optim_steps_per_batch=None,
            loss_module=loss, optimizer=optimizer, num_epochs=config.epochs, clip_norm=config.max_grad_norm,
            gae=advantages,
            logger=make_logger(config.loggers, folder), log_interval=0, enable_logging=False, progress_bar=False,
        )  # fmt: skip
    statistics = EpisodeStatistics(collection.simulations)
    bar = ProgressBar(statistics, batches * batch, config.progress)
    averaging, explore = Averaging(policy, config.average), ExplorationRamp(exploration, config.exploration)
    hooks = (
        Minibatches(config.minibatch), LipschitzBound(policy, config.lipschitz), statistics,
        LRSchedulerHook(scheduler), *([] if config.learn_exploration else [explore]), averaging, bar,
        Exam(config, averaging.averaged, folder),
        SaveCheckpoint(folder / FILE_NAME, config, averaging.averaged, collection.env),
    )  # fmt: skip
    for hook in hooks:
        hook.register(trainer)
    if saved is not None:
        trainer.load_state_dict(saved["training"]["trainer"])
        if not config.learn_exploration:
            exploration.std.fill_(config.exploration.at(trainer.collected_frames / config.total_steps))
        torch.set_rng_state(saved["training"]["torch_random"])
    return Training(trainer, collection.simulations, policy, bar)
