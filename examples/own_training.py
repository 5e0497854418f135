"""The environment in a TorchRL script of one's own: PPO without a hook of ours. `python examples/own_training.py`."""

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from vpptwin.train.config import TrainConfig
from vpptwin.train.env.vpp_env import make_env

DRONES, STEPS = 64, 32  # side by side, and 0.01 s each between two updates
env = make_env(TrainConfig(num_envs=DRONES, twin="typical"))  # hovers; any option of `vpptwin train --help`
inputs = env.observation_spec["observation"].shape[-1]
layers = nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 4), NormalParamExtractor())
module = TensorDictModule(layers, in_keys=["observation"], out_keys=["loc", "scale"])
actor = ProbabilisticActor(
    module, in_keys=["loc", "scale"], distribution_class=TanhNormal, out_keys=["action"], return_log_prob=True
)
critic = ValueOperator(nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 1)), in_keys=["observation"])
advantage, loss = GAE(gamma=0.98, lmbda=0.95, value_network=critic), ClipPPOLoss(actor, critic)
optimizer = torch.optim.Adam(loss.parameters(), lr=1e-3)
batch_size, plain = DRONES * STEPS, {"auto_register_policy_transforms": False}
collector = Collector(env, actor, frames_per_batch=batch_size, total_frames=10 * batch_size, **plain)
for batch in collector:  # (64, 32)
    for _ in range(5):
        losses = loss(advantage(batch))
        optimizer.zero_grad()
        sum(losses[key] for key in ("loss_objective", "loss_critic", "loss_entropy")).backward()
        optimizer.step()
    print(f"reward {batch['next', 'reward'].mean():.3f}, value loss {losses['loss_critic'].item():.1f}")
collector.shutdown()
