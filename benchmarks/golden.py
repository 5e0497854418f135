"""Whether a change of the code changes anything that comes out of it: outputs recorded once, compared to the last bit.

    python benchmarks/golden.py record ../golden --json benchmarks/results/golden.json
    python benchmarks/golden.py compare ../golden --jobs 2
    python benchmarks/golden.py compare benchmarks/results/golden.json --quick
    python benchmarks/golden.py compare ../golden --only 'kernel/*' example/antx_rail

Verdicts, reports, twins and predictions of sessions of all proving grounds and of measured logs, the texts of compiled
kernels, steps of the environments, exported controllers, what `inspect` says. Every item is a process of its own in a
folder of its own. `record` writes inputs and outputs below a folder, and their digests; `compare` runs everything again
on the stored inputs and says where outputs differ first. With digests alone inputs are made again.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from itertools import zip_longest
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
PLACES = {
    "crafts": "tests.crafts", "draw_session": "tests.mechanisms:draw_session", "draw_wind": "tests.reality:draw_wind",
    "fly_many": "tests.reality:fly_many", "leg": "tests.leg", "quadrotor": "tests.quadrotor",
    "servo": "tests.servo_arm", "write_mcap": "tests.reality:write_mcap",
    "pads": "examples.crazypad.by_hand:compare",
    "describe_machine": "benchmarks.same_rig.report:describe_machine",
    "collect_content": "vpptwin.deploy.content:collect_content",
    "Given": "vpptwin.twin.warp_replay:Given", "WarpReplay": "vpptwin.twin.warp_replay:WarpReplay",
    "WarpStep": "vpptwin.twin.warp_step:WarpStep", "api": "vpptwin",
}  # fmt: skip
"""Where things are that are no command of `vpptwin`: all that has to follow when modules move."""
ALONE = {
    "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "COLUMNS": "120", "TERM": "dumb", "NO_COLOR": "1",
    **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
}  # fmt: skip
VARIES = (
    (r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d)?(\.\d+)?(\+00:00|Z| UTC)?", "DATE"),  # when it was made
    (r"Done in \d+ s", "Done in TIME s"),  # how long it took
    (r"\b[0-9a-f]{40}\b(\+changes)?", "COMMIT"),  # of the checkout, or a shipped policy's, which stays
    (r"(?m)^( *(?:vpptwin|python|mujoco|numpy)): \S+$", r"\1: VERSION"),  # provenance in a twin
    (r"\b(vpptwin|Python|MuJoCo|mujoco|NumPy|numpy) \d+\.\d+[\w.]*", r"\1 VERSION"),  # likewise in a report
    (r"\bvpptwin(?:\.\w+)*\.(\w+)", r"\1"),  # modules move
)
"""What may differ though nothing has changed, and what stands for it; paths of work and checkout are the others."""
LOCK = Lock()
LONG = 2_000_000
"""Characters of a text of which no more is kept than a digest: pages with a whole viewer in them."""
Outputs = dict[str, str]
"""File → text."""


def take(name: str) -> Any:  # noqa: ANN401
    """A thing of `PLACES`, imported when it is needed."""
    module, _, inside = PLACES[name].partition(":")
    found = importlib.import_module(module)
    return getattr(found, inside) if inside else found


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


# What is run: each of these is told nothing but its inputs, in the folder `in` beside which it stands.


def call(*words: object) -> Outputs:
    """What a command prints; of what goes to stderr, where progress is told, its own lines."""
    done = subprocess.run([sys.executable, "-m", "vpptwin", *map(str, words)], capture_output=True, text=True)
    said = [line for line in re.split(r"[\r\n]", done.stderr) if line.startswith("vpptwin:")]
    return {"printed.txt": "\n".join([done.stdout, *said, f"code {done.returncode}"])}


def collect(printed: Outputs, out: Path = Path("out")) -> Outputs:
    """The same with the files of a folder of results."""
    found = dict(printed)
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


def diagnose(twin: str = "", logs: str = "in/*.mcap", *options: str) -> Outputs:
    """All that a diagnosis writes and prints."""
    given = [str(log) for log in sorted(Path().glob(logs))] if "@" not in logs else [logs]
    return collect(call("diagnose", *given, *(["--twin", twin] if twin else []), "--out", "out", *options))


def write_kernels(twin: str = "") -> Outputs:
    """The texts that numba compiles of a rig, and Warp where it steps it."""
    api = take("api")
    spec = api.load_twin(twin) if twin else api.load_twin()
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
    env = take("api").make_env(task, num_envs=count, seed=3, randomize=everything, device="cpu", engine=engine)
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


# What is put in: each writes into a folder. Only these use the proving grounds.


def fly_drone(effects: Mapping[str, Mapping[str, float]], seed: int, duration: float, *manoeuvres: str) -> Prepare:
    """Flights of the drone's independent simulation, all realism on."""

    def prepare(folder: Path) -> None:
        wind = take("draw_wind")(np.random.default_rng(seed), most=1.5)
        plan = {"effects": effects, "duration": duration, "session": seed, "wind": wind, "distractors": True}
        flights = [plan | {"manoeuvre": name, "seed": seed + 1 + i} for i, name in enumerate(manoeuvres)]
        for flight in take("fly_many")(flights):
            take("write_mcap")(flight, folder / f"{flight.manoeuvre}.mcap")

    return prepare


def move_rig(number: int, duration: float = 0.0) -> Prepare:
    """A session of another rig; with a duration [s] its first log only, so long."""

    def prepare(folder: Path) -> None:
        session = take("draw_session")(94065, number)
        motions = tuple(replace(m, duration=duration) for m in session.motions[:1]) if duration else session.motions
        replace(session, motions=motions).record(folder)

    return prepare


def move_craft(name: str, effects: Mapping[str, Mapping[str, float]], duration: float) -> Prepare:
    """A log of the quadrotor, the arm with servos or the leg."""

    def prepare(folder: Path) -> None:
        ground = take(name)
        ground.write_twin(folder)
        move = ground.fly if name == "quadrotor" else ground.move
        take("crafts").write_log(move(effects, duration, 5), folder / "log.mcap")

    return prepare


def copy_example(rig: str, *logs: str, converted: Sequence[str] = ()) -> Prepare:
    """Models, twins and effects of an example, and measured logs; `converted` is what its convert.py is told."""

    def prepare(folder: Path) -> None:
        for file in sorted(ROOT.glob(f"examples/{rig}/*")):
            if file.suffix in (".xml", ".yaml", ".mcap") or file.name == "cogging.py":
                shutil.copy(file, folder)
        for log in logs:
            copy_log(DATA / rig / log, folder)
        if converted:
            source, *options = converted
            command = [sys.executable, "-m", f"examples.{rig}.convert", DATA / rig / source, folder / "log.mcap"]
            subprocess.run([*command, *options], check=True, cwd=ROOT)

    return prepare


def copy_log(source: Path, folder: Path) -> None:
    """A measured log, a folder as one."""
    if source.is_dir():
        shutil.copytree(source, folder / source.name)
    else:
        shutil.copyfile(source, folder / source.name)


Prepare = Callable[[Path], None]


@dataclass(frozen=True)
class Item:
    """What gives outputs: inputs are prepared in a folder once, then it is run beside them."""

    run: Callable[[], Outputs]
    prepare: Prepare = lambda folder: None
    quick: bool = False


RIGS = {0: 6.0, 1: 12.0, 2: 0.0, 3: 0.0, 4: 6.0, 5: 0.0, 7: 0.0, 9: 6.0, 10: 0.0, 11: 0.0}
"""Numbers of sessions of all six families, hiding something known, unknown or nothing; 0 is as long as it was drawn."""
MANOEUVRES = ("creep", "aggressive", "mixed")
CRAFTS: dict[str, tuple[dict[str, dict[str, float]], float]] = {
    "quadrotor": ({"m1.gain": {"gain": 0.9}}, 6.0), "servo": ({"elbow.coulomb": {"torque": 0.15}}, 8.0),
    "leg": ({"knee.viscous": {"damping": 0.3}}, 8.0),
}  # fmt: skip
INSPECTED = {
    "antx": "antx/pitch_free_decay.mcap", "crazypad": "crazypad/normal_flight/E9_log00", "cube": "cube/toss_000.csv",
    "double_pendulum": "double_pendulum/design_A_00.csv", "f1tenth": "f1tenth/DS1/imuData.csv",
    "go2_leg": "go2_leg/FL.csv", "nanobench": "nanobench/B2_circle_fast_rep1.csv.gz",
    "rosbag2": "rosbag2/service_events.mcap", "rotor": "rotor/2blade.csv",
    "simple_pendulum": "simple_pendulum/ilqr.csv", "so101": "so101/pick_place/control.csv",
}  # fmt: skip


def inspect(name: str, model: str = "") -> Item:
    """What `inspect` says of a measured log, and the twin that it writes."""
    log = DATA / INSPECTED[name]
    options = ("--model", f"in/{model}", "--out", "out/twin.yaml") if model else ()

    def prepare(folder: Path) -> None:
        copy_log(log, folder)
        if model:
            shutil.copy(ROOT / "examples" / name / model, folder)

    return Item(lambda: collect(call("inspect", f"in/{log.name}", *options)), prepare)


def list_items() -> dict[str, Item]:
    """Every item by name."""
    hidden = {"rail_x.coulomb": {"force": 0.3}}
    two = {"rotor.thrust_gain": {"gain": 0.9}, "servo.lag": {"time_constant": 0.04}}
    items = {
        "drone/short": Item(diagnose, fly_drone(hidden, 50, 7.0, "aggressive"), quick=True),
        "drone/none": Item(diagnose, fly_drone({}, 60, 8.0, *MANOEUVRES)),
        "drone/friction": Item(diagnose, fly_drone(hidden, 70, 8.0, *MANOEUVRES)),
        "drone/two": Item(diagnose, fly_drone(two, 80, 8.0, *MANOEUVRES)),
    }
    for number, duration in RIGS.items():
        quick = number in (7, 10)
        items[f"rig/{number}"] = Item(lambda: diagnose("in/rig.yaml"), move_rig(number, duration), quick)
    for name, (effects, duration) in CRAFTS.items():
        items[f"craft/{name}"] = Item(lambda: diagnose("in/twin.yaml"), move_craft(name, effects, duration))
        items[f"kernel/{name}"] = Item(lambda: write_kernels("in/twin.yaml"), move_craft(name, effects, 1.0), True)
    pendulum = copy_example("simple_pendulum", converted=["energy_shaping.csv"])
    antx = [f"in/{name}.mcap" for name in ("rail_velocity_doublets_1", "pitch_free_decay")]
    circle = "B2_circle_fast_rep1.csv.gz"
    items |= {
        "example/simple_pendulum": Item(lambda: diagnose("in/pendulum.yaml"), pendulum),
        "example/simple_pendulum_short": Item(lambda: diagnose("in/pendulum.yaml", "in/log.mcap@0-5"), pendulum, True),
        "example/double_pendulum": Item(
            lambda: diagnose("in/both.yaml", "in/log.mcap@0-8"),
            copy_example("double_pendulum", converted=["design_A_00.csv"]),
        ),
        "example/so101": Item(
            lambda: diagnose("in/rotation.yaml"),
            copy_example("so101", converted=["prbs_excitation", "--last", "24"]),
        ),
        "example/nanobench": Item(
            lambda: diagnose("in/crazyflie.yaml", f"in/{circle}@5-12"), copy_example("nanobench", circle)
        ),
        "example/antx_rail": Item(
            lambda: diagnose("in/rail.yaml", antx[0]), copy_example("antx", "rail_velocity_doublets_1.mcap")
        ),
        "example/antx_pitch": Item(
            lambda: diagnose("in/pitch.yaml", antx[1]), copy_example("antx", "pitch_free_decay.mcap")
        ),
        "example/crazypad": Item(lambda: {"shares.json": to_text(take("pads")(DATA / "crazypad"))}),
        "example/own_effects": Item(
            lambda: diagnose("", "in/*.mcap", "--effects", "in/cogging.py"), copy_example("own_effects")
        ),
        "device/simple_pendulum": Item(
            lambda: diagnose("in/pendulum.yaml", "in/log.mcap@0-5", "--device", "cpu"), pendulum
        ),
        "effects/drone": Item(lambda: call("effects"), quick=True),
        "effects/rig": Item(lambda: call("effects", "--twin", "in/rig.yaml"), move_rig(4, 6.0)),
        "compare/antx": Item(
            lambda: collect(call("compare", antx[0], "--twin", "in/rail.yaml", "--json", "out/errors.json")),
            copy_example("antx", "rail_velocity_doublets_1.mcap"),
        ),
        "demo": Item(lambda: collect(call("demo", "--out", "out"))),
        "fly": Item(lambda: collect(call("fly", "--manoeuvre", "aggressive_x", "--gusts", "--out", "out/log.mcap"))),
        "evaluate": Item(lambda: collect(call("evaluate", "flip", "--tracks", 50, "--json", "out/result.json"))),
        "train": Item(lambda: collect(call("train", *TRAINED))),
        "kernel/drone": Item(write_kernels, quick=True),
        "kernel/rig": Item(lambda: write_kernels("in/rig.yaml"), move_rig(4, 6.0), True),
        "env/hover": Item(lambda: fly_env("hover", 1000), quick=True),
        "env/flip": Item(lambda: fly_env("flip", 300), quick=True),
        "env/wall-backtrack": Item(lambda: fly_env("wall-backtrack", 300)),
        "env/warp": Item(lambda: fly_env("flip", 200, "warp")),
        "export/c": Item(export_c, quick=True),
        "export/onnx": Item(export_onnx),
        **{f"inspect/{name}": inspect(name) for name in INSPECTED},
        "inspect/antx_model": inspect("antx", "antx.xml"),
        "inspect/nanobench_model": inspect("nanobench", "crazyflie.xml"),
    }
    return items


TRAINED = (
    "num_envs=16", "rollout=8", "minibatch=64", "checkpoint_every=512", "loggers=csv", "progress=false",
    "sim_threads=1", "total_steps=1024", "randomize=all", "exam_every=256", "exam_from=0", "exam_tracks=8",
    "task.episode=0.5", "task.success.window=0.2", "out=out",
)  # fmt: skip
"""A run of a second or two; what it logs tells of every update."""


def start(stage: str, name: str, work: Path) -> float:
    """One stage of an item, `prepare` or `run`, in a process of its own; processor time [s], its children's included.

    Raises:
        RuntimeError: with the end of what it said, if it failed.
    """
    said = work / f"{stage}.log"
    with said.open("w") as log:
        command = [sys.executable, str(Path(__file__).resolve()), stage, name, "in" if stage == "prepare" else "got"]
        child = subprocess.Popen(command, cwd=work, env=os.environ | ALONE, stdout=log, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"{name}, {stage}: " + said.read_text()[-2000:])
    return usage.ru_utime + usage.ru_stime


def work_at(stage: str, name: str, folder: Path) -> None:
    """What the process of `start` does."""
    folder = folder.resolve()
    folder.mkdir()
    item = list_items()[name]
    if stage == "prepare":
        item.prepare(folder)
        return
    Path("out").mkdir()
    for file, text in item.run().items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(drop_varying(text, Path.cwd()))


def read_folder(folder: Path) -> dict[str, bytes]:
    """The files of a folder by their path in it."""
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


@dataclass(frozen=True)
class Done:
    """Outputs of an item, and what is kept of them: digests, the causes that are named, processor time [s]."""

    outputs: Outputs
    told: dict[str, Any]


def perform(name: str, inputs: Path) -> Done:
    """Prepare an item's inputs where they are not there, and run it."""
    with tempfile.TemporaryDirectory(prefix="golden_", dir="/tmp") as folder:  # a path as long as any other
        work = Path(folder)
        if (inputs / name).is_dir():
            shutil.copytree(inputs / name, work / "in")
        else:
            start("prepare", name, work)
            shutil.copytree(work / "in", inputs / name)
        seconds = start("run", name, work)
        given = read_folder(work / "in")
        outputs = {file: content.decode() for file, content in read_folder(work / "got").items()}
    told: dict[str, Any] = {"seconds": round(seconds, 1)}
    if "verdict.json" in outputs:
        told["causes"] = [[c["effect"], c["confidence"]] for c in json.loads(outputs["verdict.json"])["causes"]]
    told["inputs"] = digest(*(part for pair in given.items() for part in pair))
    told["files"] = {file: digest(text) for file, text in outputs.items()}
    return Done(outputs, told)


def walk(old: Any, new: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:  # noqa: ANN401
    """Where two JSON contents differ: path and both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in {**old, **new}:
            yield from walk(old.get(key, "missing"), new.get(key, "missing"), f"{path}.{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, pair in enumerate(zip(old, new)):
            yield from walk(*pair, f"{path}[{i}]")
    elif repr(old) != repr(new):  # tells 1 from 1.0 and -0.0 from 0.0, and takes NaN for NaN
        yield path, old, new


def tell_difference(old: Outputs, new: Outputs) -> str:
    """Where outputs differ first, how far floats do, and whether the causes are the same; "" where nothing does."""
    different = [
        file
        for file in sorted({**old, **new}, key=lambda f: (f != "verdict.json", f))
        if old.get(file) != new.get(file)
    ]
    if not different:
        return ""
    file = different[0]
    told = f"{file} is missing" if file not in new else f"{file} is new" if file not in old else ""
    if not told and file.endswith(".json"):
        found = list(walk(json.loads(old[file]), json.loads(new[file])))
        place, before, after = found[0] if found else ("order or spelling", "", "")
        told = f"{file} at {place}: {str(before)[:60]} -> {str(after)[:60]}"
        pairs = [(a, b) for _, a, b in found if isinstance(a, float) and isinstance(b, float)]
        off = [abs(a - b) / max(abs(a), abs(b), 1e-300) for a, b in pairs]
        told += (
            f"; {len(found)} places, floats by at most {max(off):.2g} of their value"
            if off
            else f"; {len(found)} places"
        )
    elif not told:
        lines = zip_longest(old[file].split("\n"), new[file].split("\n"), fillvalue="nothing")
        told = next(f"{file}, line {i}: {a[:80]} -> {b[:80]}" for i, (a, b) in enumerate(lines, 1) if a != b)
    more = f"; also {', '.join(different[1:4])}" + (" ..." if len(different) > 4 else "") if different[1:] else ""
    return told + more


def tell_causes(old: dict[str, Any], new: dict[str, Any]) -> str:
    """Whether a verdict names the same causes in the same order."""
    if "causes" not in old or "causes" not in new:
        return ""
    before, after = ([effect for effect, _ in told["causes"]] for told in (old, new))
    named = ", ".join(before) or "nothing"
    return f"; same causes ({named})" if before == after else f"; CAUSES {named} -> {', '.join(after) or 'nothing'}"


def compare(name: str, done: Done, stored: dict[str, Any], folder: Path | None) -> str:
    """What differs from what is stored, "" for nothing: by the texts below a folder, or by digests alone."""
    if folder is not None:
        old = {file: content.decode() for file, content in read_folder(folder / name).items()}
        told = tell_difference(old, done.outputs)
    else:
        files = [
            f for f in {**stored["files"], **done.told["files"]} if stored["files"].get(f) != done.told["files"].get(f)
        ]
        told = ", ".join(sorted(files))
    if told and stored["inputs"] != done.told["inputs"]:
        told = f"INPUTS differ; {told}"
    return told and told + tell_causes(stored, done.told)


def write_summary(path: Path, items: Mapping[str, Any]) -> None:
    """Digests and causes with machine and commit; items that were not run stay."""
    old = json.loads(path.read_text())["items"] if path.is_file() else {}
    about = take("describe_machine")()
    rows = ",\n".join(f"  {json.dumps(name)}: {json.dumps(told)}" for name, told in sorted({**old, **items}.items()))
    head = ",\n".join(f" {json.dumps(key)}: {json.dumps(value)}" for key, value in about.items())
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'{{\n{head},\n "items": {{\n{rows}\n }}\n}}\n')


def main(argv: Sequence[str] | None = None) -> int:
    """Record or compare."""
    if sys.argv[1:2] in (["prepare"], ["run"]):  # by `start`
        work_at(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("record", "compare"))
    parser.add_argument("folder", type=Path, help="of inputs and outputs; to compare with, the JSON of digests will do")
    parser.add_argument("--only", nargs="+", default=["*"], metavar="PATTERN", help="items, such as 'drone/*'")
    parser.add_argument("--quick", action="store_true", help="a subset that takes three minutes")
    parser.add_argument("--jobs", type=int, default=1, help="items at once")
    parser.add_argument("--json", type=Path, help="of record: where digests go besides FOLDER/golden.json")
    options = parser.parse_args(argv)
    names = [
        name for name, item in list_items().items()
        if any(fnmatch(name, pattern) for pattern in options.only) and (item.quick or not options.quick)
    ]  # fmt: skip
    alone = options.folder.suffix == ".json"
    stored = {}
    if options.what == "compare":
        stored = json.loads((options.folder if alone else options.folder / "golden.json").read_text())["items"]
    worse: list[str] = []
    with tempfile.TemporaryDirectory() as spare, ThreadPoolExecutor(options.jobs) as pool:
        inputs = Path(spare) if alone else options.folder / "inputs"

        def handle(name: str) -> tuple[str, dict[str, Any]]:
            done = perform(name, inputs)
            if options.what == "compare":
                return compare(name, done, stored[name], None if alone else options.folder), done.told
            shutil.rmtree(options.folder / name, ignore_errors=True)
            for file, text in done.outputs.items():
                (options.folder / name / file).parent.mkdir(parents=True, exist_ok=True)
                (options.folder / name / file).write_text(text)
            write = [options.folder / "golden.json", *([options.json] if options.json else [])]
            with LOCK:
                for path in write:
                    write_summary(path, {name: done.told})
            return "", done.told

        for name, future in [(name, pool.submit(handle, name)) for name in names]:
            try:
                told, about = future.result()
            except (RuntimeError, KeyError) as error:
                told, about = f"FAILED {error}", {"seconds": 0.0}
            if told:
                worse.append(name)
            word = "DIFFERS" if told else "equal" if options.what == "compare" else "recorded"
            print(f"{word:8} {name:28} {about['seconds']:6.1f} s  {told}", flush=True)
    print(f"{len(names) - len(worse)} of {len(names)} fine" + f"; not {', '.join(worse)}" * bool(worse))
    return int(bool(worse))


if __name__ == "__main__":
    sys.exit(main())
