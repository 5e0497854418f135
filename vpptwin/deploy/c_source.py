"""The controller as C99: one header and one source file."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import jinja2

from vpptwin.actuators import adaptive
from vpptwin.actuators.controller import drive_rotor, run_cascade
from vpptwin.deploy.content import VECTORS, Content
from vpptwin.engine.trace.c99 import CWriter, as_float, make_array
from vpptwin.engine.trace.terms import WHOLE, Cells, Record, Term
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.files import write_files
from vpptwin.train.env.observe import INTEGRAL_DECAY

PREFIX = "vpptwin"
FILES = (f"{PREFIX}.h", f"{PREFIX}.c")
INPUTS = {
    "delta_x": "dx", "delta_z": "dz", "velocity_x": "velocity[0]", "velocity_z": "velocity[1]", "rate": "velocity[2]",
    "integral_x": "integral[0]", "integral_z": "integral[1]", "delta_theta": "wrap(angle)",
    "target_theta": "wrap(target[2])",
}  # fmt: skip
LEARNED = ("SPEED", "TRIM", "HALF_GAP", "DRAG", "COVARIANCE", "HORN", "BLADE", "SIDE", "LEAD", "TARGET",
           "LAST_CURRENT", "LAST_THROTTLE", "HELD", "FAULT", "COMMAND", "KEPT")  # fmt: skip
"""Names in `vpptwin.actuators.adaptive` of places in what a rotor's controller has learned, in their order."""
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
    rotor, cascade = trace_cascade(vehicle)
    names = content.trained.observation.names
    return {
        "prefix": PREFIX, "header": FILES[0], "names": names, "inputs": INPUTS, "vectors": VECTORS,
        "trigonometric": any(name.startswith("sin") for name in names), "decay": INTEGRAL_DECAY,
        "layers": [
            {"rows": weight.shape[0], "columns": weight.shape[1], "weight": weight.tolist(), "bias": bias.tolist()}
            for weight, bias in policy.layers()
        ],
        **{name: policy.weights[f"body.0.{name}"].tolist() for name in ("scale", "fine", "share")},
        "rotor": rotor, "cascade": cascade, "v": vehicle,
        "places": {name: getattr(adaptive, name) for name in LEARNED}, "faults": adaptive.FAULTS,
        "learned": adaptive.SIZE, "start": adaptive.start_memory(vehicle.rotor.speed).tolist(),
        "vector_in": content.inputs.tolist(), "vector_out": content.outputs.tolist(),
        "metadata": quote(json.dumps(metadata, separators=(",", ":"))),
        "policy_ms": f"{1e3 / vehicle.control.policy_rate:g}", "inner_ms": f"{1e3 / vehicle.control.inner_rate:g}",
        "about": {
            "summary": f"task {content.trained.task.name}, setup {content.trained.setup}, {metadata['steps']} steps",
            "commit": metadata["trained_at"], "twin": metadata["twin"], "twin_sha256": metadata["twin_sha256"],
        },
    }  # fmt: skip


def name_place(k: int) -> str:
    """What C calls a place in what is learned: a name, or so many places after one."""
    name, first = max(((n, getattr(adaptive, n)) for n in LEARNED), key=lambda pair: (pair[1] <= k, pair[1]))
    return name if k == first else f"{name} + {k - first}"


class Learned(Cells):
    """What the controller of one rotor has learned; whether it adapts, its state says when the C runs."""

    @property
    def shape(self) -> tuple[Any, ...]:
        """Rows, and numbers in each, of which no more is asked than whether there are any."""
        return 1, Term("(state.adaptive != 0)", WHOLE)


def trace_cascade(vehicle: Vehicle) -> tuple[str, str]:
    """The bodies of `drive_rotor` and of the cascade around it, of `vpptwin.actuators.controller`, for one vehicle."""
    dt = 1.0 / vehicle.control.inner_rate
    learned = make_array([f"learned[{name_place(k)}]" for k in range(adaptive.SIZE)])
    memory = Record(
        governor=make_array(["state.governor[i]"]), throttle=make_array(["state.throttle[i]"]),
        adaptive=Learned(learned.store, learned.index[None]),
    )  # fmt: skip
    rotor = CWriter()
    command = rotor.call(drive_rotor, [vehicle, memory, 0, Term("thrust"), Term("speed"), Term("current"), dt])
    rotor.lines.append(f"return {rotor.write_out(command)}")

    def call_rotor(*given: Any) -> str:  # noqa: ANN401
        _, _, i, thrust, speed, current, _ = given
        return f"drive_rotor(state, {i}, {thrust.text}, {speed.text}, {current.text})"

    whole = CWriter({drive_rotor: call_rotor})
    speed, current = ((Term(f"{name}[0]"), Term(f"{name}[1]")) for name in ("speed", "current"))
    given = [Term("thrust"), Term("rate"), Term("gyro"), speed, current, dt]
    pitches = whole.call(run_cascade, [vehicle, Record(gyro=make_array("state.gyro")), *given])
    whole.lines += [f"blade_pitch[{i}] = {pitch.text}" for i, pitch in enumerate(pitches)]
    return rotor.finish(), whole.finish()


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
