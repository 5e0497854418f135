"""The controller's policy as ONNX: from pose, velocity, target and integral to the action, observation included."""

from __future__ import annotations

import io
import json
import logging
import warnings
from contextlib import redirect_stdout
from pathlib import Path

import onnx
import onnxscript  # noqa: F401  # torch's exporter needs it
import torch
from torch import nn

from vpptwin.deploy.content import STATES, Content
from vpptwin.system.files import write_whole
from vpptwin.train.env.observe import ObservationTerms, accumulate_error, observe
from vpptwin.train.learn.networks import Policy

OUTPUTS = ("action", "integral_next", "observation")


class WholePolicy(nn.Module):
    """Observation building and policy as one module, in SI units, float32.

    Args:
        policy: the network.
        observation: what it is shown.
    """

    def __init__(self, policy: Policy, observation: ObservationTerms) -> None:
        super().__init__()
        self.policy, self.observation = policy, observation

    def forward(
        self, pose: torch.Tensor, velocity: torch.Tensor, target: torch.Tensor, integral: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Action (N, 2), integral of the next step (N, 2) m and observation (N, inputs), from (N, 3), ... (N, 2)."""
        grown = accumulate_error(integral, (target - pose)[:, :2])
        observation = observe(pose, velocity, target, grown, self.observation)
        return self.policy(observation), grown, observation


def write_onnx(content: Content, path: Path) -> Path:
    """Write the model, with test vectors and metadata in its properties.

    Raises:
        InputError: if the file cannot be written.
    """
    policy = Policy(content.trained.observation, (content.trained.hidden[0], content.trained.hidden[1]))
    policy.load_state_dict({name: torch.from_numpy(values) for name, values in content.policy.weights.items()})
    module = WholePolicy(policy, content.trained.observation).eval()
    examples = (torch.zeros(2, 3), torch.zeros(2, 3), torch.zeros(2, 3), torch.zeros(2, 2))
    batch = torch.export.Dim("batch")
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            module, examples, dynamo=True, input_names=list(STATES), output_names=list(OUTPUTS),
            dynamic_shapes=tuple({0: batch} for _ in examples), verbose=False,
        )  # fmt: skip
    assert program is not None
    model = program.model_proto
    about = {
        "vpptwin": json.dumps(content.metadata, separators=(",", ":")),
        "test_inputs": json.dumps(content.inputs.tolist()), "test_outputs": json.dumps(content.outputs.tolist()),
    }  # fmt: skip
    onnx.helper.set_model_props(model, about)
    # Weights as tensors of the model itself, whatever their size.
    onnx.checker.check_model(model)
    return write_whole(path, model.SerializeToString())
