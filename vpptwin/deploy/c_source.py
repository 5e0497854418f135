"""The controller as C99: one header and one source file."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import jinja2
import numpy as np

from vpptwin.actuators import adaptive, motor
from vpptwin.actuators.blade import NEWTON, is_straight, max_thrust
from vpptwin.deploy.content import VECTORS, Content
from vpptwin.system.files import write_files
from vpptwin.train.env.observe import INTEGRAL_DECAY

PREFIX = "vpptwin"
FILES = (f"{PREFIX}.h", f"{PREFIX}.c")
INPUTS = {
    "delta_x": "dx", "delta_z": "dz", "velocity_x": "velocity[0]", "velocity_z": "velocity[1]", "rate": "velocity[2]",
    "integral_x": "integral[0]", "integral_z": "integral[1]", "delta_theta": "wrap(angle)",
    "target_theta": "wrap(target[2])",
}  # fmt: skip
LINE = 96
"""Characters of metadata a line."""


def write_c(content: Content, folder: Path) -> list[Path]:
    """Write header and source into a folder, which is made if need be; returns their paths.

    Raises:
        InputError: if they cannot be written.
    """
    values = describe(content)
    texts = {name: TEMPLATES.get_template(f"controller{name[-2:]}.j2").render(values) for name in FILES}
    return write_files({folder / name: text for name, text in texts.items()})


def describe(content: Content) -> dict[str, object]:
    """What the templates fill in."""
    vehicle, policy, metadata = content.vehicle, content.policy, content.metadata
    dt = 1.0 / vehicle.control.inner_rate
    left = math.exp(-dt / max(vehicle.servo.time_constant, 1e-12))
    names = content.trained.sight.names
    return {
        "prefix": PREFIX, "header": FILES[0], "names": names, "inputs": INPUTS, "vectors": VECTORS,
        "trigonometric": any(name.startswith("sin") for name in names), "decay": INTEGRAL_DECAY,
        "layers": [
            {"rows": weight.shape[0], "columns": weight.shape[1], "weight": weight.tolist(), "bias": bias.tolist()}
            for weight, bias in policy.layers()
        ],
        **{name: policy.weights[f"body.0.{name}"].tolist() for name in ("scale", "fine", "share")},
        "v": vehicle, "a": adaptive, "dt": dt, "step": dt / vehicle.rotor.inertia, "newton": NEWTON,
        "thrust_limit": float(max_thrust(vehicle.rotor)), "straight": bool(is_straight(vehicle.rotor)),
        "lag_left": left, "lag_mean": vehicle.servo.time_constant / dt * (1.0 - left),
        "governor_kp": motor.GOVERNOR_KP, "governor_ki": motor.GOVERNOR_KI,
        "feed_forward": vehicle.rotor.speed / vehicle.motor.k_v
        + vehicle.motor.resistance * vehicle.motor.no_load_current,
        "learned": adaptive.SIZE, "start": adaptive.start_memory(vehicle.rotor.speed).tolist(),
        "vector_in": content.inputs.tolist(), "vector_out": content.outputs.tolist(),
        "metadata": quote(json.dumps(metadata, separators=(",", ":"))),
        "policy_ms": f"{1e3 / vehicle.control.policy_rate:g}", "inner_ms": f"{1e3 * dt:g}",
        "about": {
            "summary": f"task {content.trained.task.name}, setup {content.trained.setup}, {metadata['steps']} steps",
            "commit": metadata["trained_at"], "twin": metadata["twin"], "twin_sha256": metadata["twin_sha256"],
        },
    }  # fmt: skip


def as_float(value: float) -> str:
    """A number as a C float literal, exact."""
    text = np.format_float_scientific(np.float32(value), unique=True, trim="0")
    return f"{text}f"


def quote(text: str) -> list[str]:
    """Text as C string literals, one a line."""
    parts = [text[i : i + LINE] for i in range(0, len(text), LINE)]
    return ['"' + re.sub(r'(["?\\])', r"\\\1", part) + '"' for part in parts]  # of "?": no trigraphs


def as_comment(text: object) -> str:
    """Text of anyone's for inside of a C comment, which it cannot end."""
    return re.sub(r"[^\w .,:;()+-]", "_", str(text), flags=re.ASCII)


TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("vpptwin.deploy"), undefined=jinja2.StrictUndefined, keep_trailing_newline=True
)
TEMPLATES.filters |= {"c": as_float, "comment": as_comment}
