"""`vpptwin evaluate`: fly a policy from many random initial states, in randomized twins, at once and measure."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vpptwin.robots.planar_drone.vehicle import Vehicle, weigh
from vpptwin.system.errors import InputError
from vpptwin.system.files import write_json
from vpptwin.system.trust import trust
from vpptwin.train.config import ESTIMATORS, TrainConfig
from vpptwin.train.env.randomize import PAPER
from vpptwin.train.env.rotors import load_trained_twin
from vpptwin.train.env.tasks import Task, check_task, check_task_name
from vpptwin.train.env.vpp_env import make_env
from vpptwin.train.evaluate.flights import fly_tracks
from vpptwin.train.evaluate.pilot import choose_task
from vpptwin.train.learn.checkpoint import build_policy, read_checkpoint
from vpptwin.train.learn.networks import Policy
from vpptwin.train.stored import find_commit, find_versions


def load_policy(checkpoint: Path | str) -> Policy:
    """The policy of a checkpoint: a torch module from observations (N, inputs) to actions (N, 2) in [-1, 1].

    Raises:
        InputError: if the file is no checkpoint of this version.
    """
    return build_policy(read_checkpoint(checkpoint), checkpoint)[0]


@dataclass(frozen=True)
class Conditions:
    """What a policy is measured under.

    Attributes:
        task: name; None, or that of training, for the task of training with its overrides.
        tracks: number of flights, one episode each.
        seed: of initial states, targets, noise and twins.
        twin: `nominal` or a twin YAML; None for that of training.
        noise: sensor noise, 1 = that of vehicle.yaml.
        randomize: effects, or groups of them, drawn from their priors for every flight.
        thrust_to_weight: of the rotors, None for the task's; what is commanded is scaled as in training either way.
        effects: Python files with effects of the user's own; those of training come with its twin, if trusted.
        estimator: what the policy is shown, `sensors` or `kalman`; None for that of training.
    """

    task: str | None = None
    tracks: int = 100
    seed: int = 1_000_000
    twin: str | None = None
    noise: float = 1.0
    randomize: Sequence[str] = (PAPER,)
    thrust_to_weight: float | None = None
    effects: Sequence[str] = ()
    estimator: str | None = None


def evaluate(checkpoint: Path | str, conditions: Conditions | None = None) -> dict[str, Any]:
    """Measure a policy on random initial states, with noise, in randomized twins.

    Args:
        checkpoint: file, folder of a run, or name of a shipped policy.
        conditions: by default 100 flights of the task of training.

    Returns:
        Plain data: position errors [m] of the flights that did not fail, upright and inverted, fail rate, success
        share, full turns made, and provenance.

    Raises:
        InputError: if the checkpoint, the task or the twin is not what it should be.
    """
    given = conditions or Conditions()
    if given.tracks < 1:
        raise InputError(f"tracks={given.tracks}", "at least 1", "ask for more, e.g. --tracks 100")
    content = read_checkpoint(checkpoint)
    policy, trained = build_policy(content, checkpoint)
    config = configure_flights(trained, given)
    env = make_env(config)
    flown = fly_tracks(env, policy)
    limits, kept = env.task.success, ~flown.failed
    return {
        "task": env.task.name, "twin": given.twin or trained.twin, "tracks": given.tracks, "seed": given.seed,
        "noise": given.noise, "randomized": list(env.randomized), "thrust_to_weight": env.task.thrust_to_weight,
        "estimator": config.estimator, "window_s": limits.window, "success_distance_m": limits.position,
        "success_angle_rad": limits.angle,
        "fail_rate": float(flown.failed.mean()), "success_share": float(flown.success.mean()),
        "position_error_m": summarize(flown.position_error[kept]),
        "upright_error_m": summarize(flown.position_error[kept & ~flown.inverted]),
        "inverted_error_m": summarize(flown.position_error[kept & flown.inverted]),
        "angle_error_rad": summarize(flown.angle_error[kept]),
        "full_turns": {"asked": flown.turns, "made": flown.turned},
        "lipschitz": policy.lipschitz(), "lipschitz_si": policy.lipschitz_si(),
        "checkpoint": {"path": str(checkpoint), "steps": content["steps"], "commit": content["commit"]},
        "commit": find_commit(), "versions": find_versions(), "evaluated": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }  # fmt: skip


def configure_flights(trained: TrainConfig, given: Conditions) -> TrainConfig:
    """The configuration of training with everything that evaluation decides for itself.

    Raises:
        InputError: on an unknown task or estimator.
    """
    if given.estimator not in (None, *ESTIMATORS):
        raise InputError(f"unknown estimator {given.estimator!r}", f"one of {', '.join(ESTIMATORS)}", "check the name")
    check_task_name(given.task)
    task = choose_task(trained, given.task)
    own = trained.effects if given.twin is None else []
    trust(given.effects)
    config = replace(
        trained, task=task, num_envs=given.tracks, seed=given.seed, twin=given.twin or trained.twin, noise=given.noise,
        randomize=list(given.randomize), desynchronize=False, effects=[*own, *given.effects],
        estimator=given.estimator or trained.estimator,
    )  # fmt: skip
    if given.thrust_to_weight is None:
        return config
    return replace(config, task=arm(task, given.thrust_to_weight, load_trained_twin(config).vehicle))


def arm(task: Task, thrust_to_weight: float, vehicle: Vehicle) -> Task:
    """The task with rotors of another strength, under the thrusts that are commanded of the task's own.

    Raises:
        InputError: if the ratio makes no sense.
    """
    own = task.thrust_to_weight or vehicle.control.thrust_max / weigh(vehicle)
    armed = replace(task, thrust_to_weight=thrust_to_weight, commanded=task.commanded or own)
    check_task(armed)
    return armed


def summarize(errors: np.ndarray) -> dict[str, float | None]:
    """Median, mean and worst; None when no flight is left to measure."""
    if not len(errors):
        return {"median": None, "mean": None, "worst": None}
    return {"median": float(np.median(errors)), "mean": float(errors.mean()), "worst": float(errors.max())}


def describe(result: dict[str, Any]) -> str:
    """What `evaluate` found, in a sentence or two."""
    count, lost = result["tracks"], round(result["tracks"] * result["fail_rate"])
    told = [f"{count} flights of {result['task']} in twin {result['twin']}: {lost} failed"]
    for side in ("upright", "inverted"):
        mean = result[f"{side}_error_m"]["mean"]
        told += [f"{1e3 * mean:.1f} mm {side}"] if mean is not None else []
    turns, drawn = result["full_turns"], ", ".join(result["randomized"])
    told += [f"{turns['made']} of {turns['asked']} full turns made"] if turns["asked"] else []
    how = f"sensor noise × {result['noise']:g}; {f'drawn for each flight: {drawn}' if drawn else 'nothing drawn'}"
    return f"{', '.join(told)}\n(mean error over the last {result['window_s']:g} s; {how})"


def run_evaluate(checkpoint: Path | str, conditions: Conditions, json_path: Path | str | None) -> dict[str, Any]:
    """`evaluate`, and write the result as JSON unless `json_path` is None.

    Raises:
        InputError: as `evaluate`, and if the file cannot be written.
    """
    result = evaluate(checkpoint, conditions)
    if json_path is not None:
        write_json(result, Path(json_path))
    return result
