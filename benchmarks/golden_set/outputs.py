"""What comes out of items: commands run beside the folder `in` of their inputs, kernels, environments, exports."""

from __future__ import annotations

import ctypes
import hashlib
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from golden_set.inputs import DATA, ROOT, take

VARIES = (
    (r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d)?(\.\d+)?(\+00:00|Z| UTC)?", "DATE"),  # when it was made
    (r"Done in \d+ s", "Done in TIME s"),  # how long it took
    (r"\b[0-9a-f]{40}\b(\+changes)?", "COMMIT"),  # of the checkout, or a shipped policy's, which stays
    (r"(?m)^( *(?:vpptwin|python|mujoco|numpy)): \S+$", r"\1: VERSION"),  # provenance in a twin
    (r"\b(vpptwin|Python|MuJoCo|mujoco|NumPy|numpy) \d+\.\d+[\w.]*", r"\1 VERSION"),  # likewise in a report
    (r"\bvpptwin(?:\.\w+)*\.(\w+)", r"\1"),  # modules move
)
"""What may differ though nothing has changed, and what stands for it; paths of work and checkout are the others."""
LONG = 2_000_000
"""Characters of a text of which no more is kept than a digest: pages with a whole viewer in them."""
SLOW = " so far; to make it shorter "
"""In a line that a command says where it takes long."""
Outputs = dict[str, str]
"""File → text."""
Run = Callable[[], Outputs]


def drop_varying(text: str, work: Path) -> str:
    """A text without what legitimately varies."""
    for path, name in ((work, "WORK"), (DATA.parent, "SHARED"), (ROOT, "ROOT")):
        text = text.replace(str(path.resolve()), name)
    for pattern, stand_in in VARIES:
        text = re.sub(pattern, stand_in, text)
    return text


def to_text(content: object) -> str:
    """JSON whose floats are exact, NumPy's included."""
    return json.dumps(content, indent=1, default=lambda value: value.tolist()) + "\n"


def digest(*parts: bytes | str) -> str:
    """Sixteen digits of a hash."""
    return hashlib.sha256(b"\0".join(p.encode() if isinstance(p, str) else p for p in parts)).hexdigest()[:16]


def call(*words: object) -> Outputs:
    """What a command prints; of what goes to stderr, where progress is told, its own lines."""
    done = subprocess.run([sys.executable, "-m", "vpptwin", *map(str, words)], capture_output=True, text=True)
    said = [line for line in re.split(r"[\r\n]", done.stderr) if line.startswith("vpptwin:") and SLOW not in line]
    return {"printed.txt": "\n".join([done.stdout, *said, f"code {done.returncode}"])}


def run_command(*words: str) -> Outputs:
    """What a command prints, and the files that it writes into the folder `out`."""
    found, out = call(*words), Path("out")
    for file in sorted(f for f in out.glob("**/*") if f.is_file()):
        name = str(file.relative_to(out))
        if file.suffix == ".mcap":
            found[f"{name}.json"] = to_text(digest_messages(file))
        elif file.suffix in (".json", ".yaml", ".csv", ".html"):
            text = file.read_text()
            found[name] = text if len(text) < LONG else digest(drop_varying(text, Path.cwd())) + "\n"
    return found


def digest_messages(file: Path) -> dict[str, Any]:
    """Number and digest of the messages of every topic of an MCAP."""
    from mcap.reader import make_reader

    topics: dict[str, list[bytes]] = {}
    with file.open("rb") as content:
        for _, channel, message in make_reader(content).iter_messages():
            topics.setdefault(channel.topic, []).append(b"%d " % message.log_time + message.data)
    return {topic: [len(messages), digest(*messages)] for topic, messages in sorted(topics.items())}


def diagnose(twin: str = "", logs: str = "*.mcap", *options: str) -> Outputs:
    """All that a diagnosis of logs in `in` writes and prints."""
    given = [f"in/{logs}"] if "@" in logs else [str(log) for log in sorted(Path("in").glob(logs))]
    nominal = ["--twin", f"in/{twin}"] if twin else []
    return run_command("diagnose", *given, *nominal, "--out", "out", *options)


def weigh_hovers() -> Outputs:
    """What examples/crazypad finds by hand: its logs are not diagnosed."""
    return {"shares.json": to_text(take("weigh_hovers")(DATA / "crazypad"))}


def write_kernels(twin: str = "") -> Outputs:
    """The texts that numba compiles of a rig, and Warp where it steps it."""
    api = take("vpptwin")
    spec = api.load_twin(f"in/{twin}" if twin else "nominal")
    made = api.Twin(spec, 1, active=[effect.id for effect in spec.catalogue])
    kernel = made._kernel
    pipeline = kernel.pipeline
    told = {
        "columns": {" ".join(key): column for key, column in pipeline.columns.items()}, "places": pipeline.places,
        "starts": pipeline.starts, "functions": {name: f.__qualname__ for name, f in pipeline.functions.items()},
        "layer": str(kernel.layer), "constants": str(kernel.constants),
    }  # fmt: skip
    found = {"pipeline.py": pipeline.source, "entry.py": kernel.entry, "tables.json": to_text(told)}
    if kernel.fused is None:
        return found
    given = take("Given")(frozenset({"command", "push", "qpos", "qvel"}), 2)
    found |= {"fused.py": kernel.fused, "warp_replay.py": take("WarpReplay")(spec, given).source}
    return found if twin else found | {"warp_step.py": take("WarpStep")(made, single=True).source}


def fly_env(task: str, steps: int, engine: str = "numba", count: int = 16) -> Outputs:
    """Steps of an environment under random actions, every effect randomized: digests, first and last rows."""
    import torch

    everything = ("all",) if engine == "numba" else ("paper",)
    env = take("vpptwin").make_env(task, num_envs=count, seed=3, randomize=everything, device="cpu", engine=engine)
    generator, now = torch.Generator().manual_seed(5), env.reset()
    hashes: dict[str, Any] = {}
    told: dict[str, Any] = {"first": {k: v.tolist() for k, v in now.items() if k != "action"}, "digests": {}}
    for i in range(steps):
        action = torch.tensor([0.45, 0.0]) + torch.tensor([0.2, 0.3]) * torch.randn(count, 2, generator=generator)
        step, now = env.step_and_maybe_reset(now.set("action", action.clip(-1.0, 1.0)))
        for key, value in step["next"].items():
            hashes.setdefault(key, hashlib.sha256()).update(value.numpy().tobytes())
        if i % 50 == 49 or i in (0, steps - 1):
            told["digests"][i] = {key: value.hexdigest()[:16] for key, value in sorted(hashes.items())}
            told["last"] = {key: value.tolist() for key, value in sorted(step["next"].items())}
    return {"steps.json": to_text(told)}


def draw_states(count: int) -> list[np.ndarray]:
    """Poses, velocities, targets and integrals, float32."""
    rng = np.random.default_rng(8)
    scales = ([0.5, 0.5, 4.0], [1.0, 1.0, 5.0], [0.5, 0.5, 3.0], [1.0, 1.0])
    return [(rng.normal(size=(count, len(scale))) * scale).astype(np.float32) for scale in scales]


def export_c() -> Outputs:
    """The C source of the shipped policy, and what it computes, compiled by gcc, beside Python's network."""
    found = call("export", "flip", "--format", "c", "--out", "out")
    text = Path("out/vpptwin.c").read_text()
    found["vpptwin.c"] = re.sub(r"(?s)(_metadata\[\] =).*?;\n", r"\1 LEFT OUT;\n", text)  # commit, versions
    found["vpptwin.h"] = Path("out/vpptwin.h").read_text()
    subprocess.run(["gcc", "-std=c99", "-O2", "-shared", "-fPIC", "out/vpptwin.c", "-o", "c.so", "-lm"], check=True)
    library, state = ctypes.CDLL("./c.so"), ctypes.create_string_buffer(1 << 16)
    content = take("collect_content")("flip")

    def run(name: str, *given: np.ndarray | float | ctypes.Array) -> None:
        library[f"vpptwin_{name}"](*(
            v.ctypes.data_as(ctypes.c_void_p) if isinstance(v, np.ndarray)
            else ctypes.c_float(v) if isinstance(v, float) else v for v in given
        ))  # fmt: skip

    rows: dict[str, list[Any]] = {"act": [], "python": content.policy(content.inputs).tolist(), "observe": []}
    for seen in content.inputs:
        run("act", np.ascontiguousarray(seen), action := np.empty(2, np.float32))
        rows["act"].append(action.tolist())
    for given in zip(*draw_states(50)):
        seen, grown = np.empty(content.inputs.shape[1], np.float32), given[3].copy()
        run("observe", *given[:3], grown, seen)
        rows["observe"].append([*seen.tolist(), *grown.tolist()])
    for adaptive in (0, 1):
        library.vpptwin_start(state, adaptive)
        rng = np.random.default_rng(3)
        for _ in range(200):
            thrust, rate, gyro = rng.uniform([-8.0, -8.0, -5.0], [10.0, 8.0, 5.0])
            speed, current = rng.normal(470.0, 5.0, 2).astype(np.float32), rng.normal(5.0, 0.5, 2).astype(np.float32)
            pitch, throttle = np.empty(2, np.float32), np.empty(2, np.float32)
            run("cascade", state, float(thrust), float(rate), float(gyro), speed, current, pitch, throttle)
            rows.setdefault(f"cascade {adaptive}", []).append([*pitch.tolist(), *throttle.tolist()])
    return found | {"vectors.json": to_text(rows | {"inputs": content.inputs, "outputs": content.outputs})}


def export_onnx() -> Outputs:
    """What the shipped policy as ONNX computes of fixed states."""
    import onnxruntime

    found = call("export", "flip", "--format", "onnx", "--out", "flip.onnx")
    session = onnxruntime.InferenceSession("flip.onnx", providers=["CPUExecutionProvider"])
    names = [given.name for given in session.get_inputs()]
    results = session.run(None, dict(zip(names, draw_states(50))))
    about = session.get_modelmeta().custom_metadata_map
    vectors = {key: json.loads(about[key]) for key in ("test_inputs", "test_outputs")}
    made = {output.name: values for output, values in zip(session.get_outputs(), results)}
    return found | {"vectors.json": to_text(made | vectors | {"inputs": names})}
