"""What keeps a policy off its target: the reward that rest still lacks, dry friction, randomized parameters.

    python benchmarks/precision.py flip --tracks 1000 --seed 1
    python benchmarks/precision.py flip --linear 200          (and the least error of a linear controller, 15 minutes)

Flights as `vpptwin evaluate` flies them; everything is of the last second of those that did not fail. With --linear a
linear controller of the same inputs, which begins as the policy's derivative at its upright target, is tuned for the
least position error in hovering (Nelder-Mead), and both fly twins that it was not tuned in.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402
import torch  # noqa: E402
from scipy.optimize import minimize  # noqa: E402
from tensordict import TensorDict  # noqa: E402

from vpptwin.system.errors import InputError  # noqa: E402
from vpptwin.system.files import check_target, write_whole  # noqa: E402
from vpptwin.train.env.observe import OBSERVATION, wrap_angle  # noqa: E402
from vpptwin.train.env.reward import compute_reward  # noqa: E402
from vpptwin.train.env.vpp_env import VppEnv, make_env  # noqa: E402
from vpptwin.train.evaluate.evaluate import Conditions, configure_flights  # noqa: E402
from vpptwin.train.learn.checkpoint import build_policy, read_checkpoint  # noqa: E402

Controller = Callable[[torch.Tensor], torch.Tensor]
"""From observations (N, 11) to actions (N, 2)."""
REACH = {"delta_x": 0.1, "delta_z": 0.1, "integral_x": 1.0, "integral_z": 1.0, "velocity_x": 0.3, "velocity_z": 0.3,
         "rate": 0.5}  # fmt: skip
"""Distances over which a policy is made linear, in the units of its inputs."""
BANDS = (0.0, 0.1, 0.25, 0.5, np.inf)
"""Of dry friction, N."""
VERTICAL = ("delta_z", "velocity_z", "integral_z")
LATERAL = ("delta_x", "velocity_x", "sin_delta_theta", "rate", "integral_x")
"""Inputs of a linear controller's thrust and of its rate."""
STEP = np.array([0.03, *[0.35] * (len(VERTICAL) + len(LATERAL))])
"""First steps of the search, as shares of trim and gains."""
LOST = 0.5
"""What a failed flight counts as, m."""


@dataclass
class Rest:
    """The last second of N flights."""

    delta: np.ndarray  # target - pose, (steps, N, 3) m, m, rad
    velocity: np.ndarray  # (steps, N, 3) m/s, m/s, rad/s
    integral: np.ndarray  # Γ, (steps, N, 2) m
    failed: np.ndarray  # (N,) bool

    @property
    def error(self) -> np.ndarray:
        """Mean distance of each flight, (N,) m."""
        mean: np.ndarray = np.hypot(self.delta[..., 0], self.delta[..., 1]).mean(axis=0)
        return mean


@torch.no_grad()
def fly(env: VppEnv, controller: Controller, seed: int) -> Rest:
    """Fly one episode in every simulation."""
    env.set_seed(seed)
    rate = env.twin.vehicle.control.policy_rate
    steps, window = (round(time * rate) for time in (env.task.episode, env.task.success.window))
    failed, kept = np.zeros(env.twin.num_sims, bool), []
    now = env.reset()
    for k in range(steps):
        now = env.step(TensorDict({"action": controller(now["observation"])}, env.batch_size))["next"]
        failed |= now["terminated"].numpy()[:, 0]
        if k >= steps - window:
            delta = env.episodes.target - env.state.qpos
            kept.append((delta, env.state.qvel.copy(), env.episodes.integral.copy()))
    delta, velocity, integral = (np.array(part) for part in zip(*kept))
    return Rest(delta, velocity, integral, failed)


def split_reward(env: VppEnv, rest: Rest) -> dict[str, float]:
    """What the reward would gain if one quantity were perfect, as shares of the best reward."""
    weights, kept = env.task.weights, ~rest.failed
    parts = [part[:, kept].reshape(-1, part.shape[-1]) for part in (rest.delta, rest.velocity, rest.integral)]

    def reward(delta: np.ndarray, velocity: np.ndarray, integral: np.ndarray) -> float:
        return float(compute_reward(weights, delta, velocity, integral).mean()) / weights.best

    now = reward(*parts)
    place, turn = np.array([0.0, 0.0, 1.0]), np.array([1.0, 1.0, 0.0])
    delta, velocity, integral = parts
    perfect = {
        "position": (delta * place, velocity, integral), "angle": (delta * turn, velocity, integral),
        "velocity": (delta, velocity * place, integral), "rate": (delta, velocity * turn, integral),
        "integral": (delta, velocity, 0.0 * integral),
    }  # fmt: skip
    return {"all": 1.0 - now} | {name: reward(*given) - now for name, given in perfect.items()}


def list_causes(env: VppEnv, rest: Rest, drawn: np.ndarray) -> list[tuple[str, float, float]]:
    """Change of the mean offset with each randomized parameter, x and z [m per standard deviation], largest first."""
    upright = ~rest.failed & (np.abs(wrap_angle(env.episodes.target[:, 2])) < 0.5 * np.pi)
    offset = rest.delta[:, upright, :2].mean(axis=0)
    inputs = np.column_stack([np.ones(len(offset)), drawn[upright]])
    slopes = np.linalg.lstsq(inputs, offset, rcond=None)[0][1:]
    names = [".".join(key) for key in env._priors.keys]
    order = np.argsort(-np.abs(slopes).max(axis=1))
    return [(names[i], float(slopes[i, 0]), float(slopes[i, 1])) for i in order]


def tune_linear(env: VppEnv, policy: torch.nn.Module, evaluations: int, seed: int) -> dict[str, list[float]]:
    """Position error [m] and share of the best reward that rest lacks, of a policy and a tuned linear controller."""
    target = torch.zeros(1, len(OBSERVATION))
    target[0, OBSERVATION.index("cos_delta_theta")] = target[0, OBSERVATION.index("cos_target_theta")] = 1.0
    # Over these distances, not at the target itself: there its inputs are magnified.
    moves = torch.diag(torch.tensor([REACH.get(name, 0.1) for name in OBSERVATION]))
    with torch.no_grad():
        ahead, back = policy(target + moves).atanh(), policy(target - moves).atanh()
    gains = ((ahead - back) / (2.0 * moves.diagonal()[:, None])).T
    up, along = ([OBSERVATION.index(name) for name in names] for names in (VERTICAL, LATERAL))
    with torch.no_grad():
        trim = float(policy(target).atanh()[0, 0])
    start = np.array([trim, *gains[0, up].tolist(), *gains[1, along].tolist()])

    def linear(values: np.ndarray) -> Controller:
        matrix, offset = torch.zeros(len(OBSERVATION), 2), torch.tensor([float(values[0]), 0.0])
        matrix[up, 0] = torch.tensor(values[1 : 1 + len(up)], dtype=torch.float32)
        matrix[along, 1] = torch.tensor(values[1 + len(up) :], dtype=torch.float32)
        return lambda seen: torch.tanh((seen - target) @ matrix + offset)

    def judge(controller: Controller, seed: int) -> list[float]:
        rest = fly(env, controller, seed)
        error = np.where(rest.failed, LOST, np.minimum(rest.error, LOST)).mean()
        return [float(error), split_reward(env, rest)["all"] if not rest.failed.all() else 1.0]

    simplex = np.ones((len(start) + 1, len(start)))
    simplex[1:] += np.diag(STEP)
    options = {"maxfev": evaluations, "initial_simplex": simplex, "adaptive": True}
    found = minimize(
        lambda shares: judge(linear(start * shares), seed)[0], simplex[0], method="Nelder-Mead", options=options
    )
    return {"policy": judge(policy, seed + 1), "linear": judge(linear(start * found.x), seed + 1)}


def report(options: argparse.Namespace) -> dict:
    """Fly and take apart; plain data."""
    if options.tracks < 1:
        raise InputError(f"tracks={options.tracks}", "at least 1", "ask for more, e.g. --tracks 1000")
    policy, trained = build_policy(read_checkpoint(options.checkpoint), options.checkpoint)
    if trained.observation.names != OBSERVATION or trained.task.target.dwell is None:
        raise InputError(f"{options.checkpoint} is no flip policy of setup=All", "one", "train it with task=flip")
    config = configure_flights(trained, Conditions(tracks=options.tracks, seed=options.seed))
    env = make_env(config)
    rest = fly(env, policy, options.seed)
    values = np.column_stack([env.twin.parameter(*key) for key in env._priors.keys])
    kept, bands = ~rest.failed, []
    for axis, rail in enumerate(("rail_x", "rail_z")):
        force = env.twin.parameter(f"{rail}.coulomb", "force")
        offset = np.abs(rest.delta[..., axis].mean(axis=0))
        for low, high in pairwise(BANDS):
            within = kept & (force >= low) & (force < high)
            bands.append((rail, low, high, int(within.sum()), float(offset[within].mean())))
    result = {
        "error_m": float(rest.error[kept].mean()), "fail_rate": float(rest.failed.mean()), "bands": bands,
        "missing_reward": split_reward(env, rest), "rate_rms": float(rest.velocity[:, kept, 2].std()),
        "causes": list_causes(env, rest, env._priors.standardize(values)),
    }  # fmt: skip
    if options.linear:
        task = config.task
        calm = replace(task.start, x=(-0.3, 0.3), z=(1.1, 1.4), theta=(-0.2, 0.2), rate=(-0.2, 0.2))
        calm = replace(calm, velocity_x=(-0.1, 0.1), velocity_z=(-0.1, 0.1))
        target = replace(task.target, x=(-0.1, 0.1), z=(1.2, 1.3), angles=[0.0], dwell=None, turns=0.0)
        hover = replace(config, num_envs=256, task=replace(task, start=calm, target=target, episode=3.0))
        result["linear"] = tune_linear(make_env(hover), policy, options.linear, options.seed)
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Print the report; 2 for bad input."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", help="file, folder of a run, or name of a shipped policy")
    parser.add_argument("--tracks", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--linear", type=int, default=0, metavar="N", help="tune a linear controller, N evaluations")
    parser.add_argument("--json", type=Path, help="write the results here")
    options = parser.parse_args(argv)
    try:
        if options.json:
            check_target(options.json, json=True)
        result = report(options)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    if options.json:
        write_whole(options.json, json.dumps(result) + "\n")
    print(f"mean error {1e3 * result['error_m']:.1f} mm, {result['fail_rate']:.1%} failed")
    print("\nreward that rest lacks, in 1/1000 of the best, and what perfection would gain:")
    print(", ".join(f"{name} {1e3 * share:.1f}" for name, share in result["missing_reward"].items()))
    print(f"rate {result['rate_rms']:.2f} rad/s rms")
    print("\nmean distance along a rail by its dry friction:")
    for rail, low, high, count, offset in result["bands"]:
        print(f"  {rail} {low:4.2f} to {high:4.2f} N: {1e3 * offset:5.1f} mm ({count} flights)")
    print("\noffset upright per standard deviation of a parameter, x and z:")
    for name, x, z in result["causes"][:8]:
        print(f"  {name:30s} {1e3 * x:5.1f} {1e3 * z:5.1f} mm")
    for name, (error, missing) in result.get("linear", {}).items():
        print(f"hovering, {name}: {1e3 * error:.1f} mm, reward lacks {1e3 * missing:.1f}/1000")
    return 0


if __name__ == "__main__":
    sys.exit(main())
