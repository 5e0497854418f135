"""The items by name, and which are quick."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from golden_set.inputs import DATA, ROOT, Effects, Prepare, copy_example, copy_files, fly_drone, move_craft, move_rig
from golden_set.outputs import (
    Run,
    call,
    diagnose,
    export_c,
    export_onnx,
    fly_env,
    run_command,
    weigh_hovers,
    write_kernels,
)

MANOEUVRES = ("creep", "aggressive", "mixed")
FRICTION: Effects = {"rail_x.coulomb": {"force": 0.3}}
TWO: Effects = {"rotor.thrust_gain": {"gain": 0.9}, "servo.lag": {"time_constant": 0.04}}
RIGS = {0: 6.0, 1: 12.0, 2: 0.0, 3: 0.0, 4: 6.0, 5: 0.0, 7: 0.0, 9: 6.0, 10: 0.0, 11: 0.0}
"""Sessions of all six families, hiding something known, unknown or nothing: as `move_rig` takes them."""
CRAFTS: dict[str, tuple[Effects, float]] = {
    "quadrotor": ({"m1.gain": {"gain": 0.9}}, 6.0), "servo": ({"elbow.coulomb": {"torque": 0.15}}, 8.0),
    "leg": ({"knee.viscous": {"damping": 0.3}}, 8.0),
}  # fmt: skip
"""What is hidden, and for how long it is moved [s]."""
INSPECTED = (
    "antx/pitch_free_decay.mcap", "crazypad/normal_flight/E9_log00", "cube/toss_000.csv",
    "double_pendulum/design_A_00.csv", "f1tenth/DS1/imuData.csv", "go2_leg/FL.csv",
    "nanobench/B2_circle_fast_rep1.csv.gz", "rosbag2/service_events.mcap", "rotor/2blade.csv",
    "simple_pendulum/ilqr.csv", "so101/pick_place/control.csv",
)  # fmt: skip
MODELS = {"antx": "antx.xml", "nanobench": "crazyflie.xml"}
"""Examples whose model `inspect` is told, to write a twin."""
TRAINED = (
    "num_envs=16", "rollout=8", "minibatch=64", "checkpoint_every=512", "loggers=csv", "progress=false",
    "sim_threads=1", "total_steps=1024", "randomize=all", "exam_every=256", "exam_from=0", "exam_tracks=8",
    "task.episode=0.5", "task.success.window=0.2", "out=out",
)  # fmt: skip
"""A run of a second or two; what it logs tells of every update."""
NOTHING: Prepare = copy_files()


@dataclass(frozen=True)
class Item:
    """What gives outputs: inputs are prepared in a folder once, and it runs beside them."""

    run: Run
    prepare: Prepare = NOTHING
    quick: bool = False


def list_items() -> dict[str, Item]:
    """Every item by name."""
    return {**list_sessions(), **list_examples(), **list_commands(), **list_texts(), **list_looks()}


def list_sessions() -> dict[str, Item]:
    """Diagnoses on the proving grounds."""
    items = {
        "drone/short": Item(diagnose, fly_drone(FRICTION, 50, 7.0, "aggressive"), True),
        "drone/none": Item(diagnose, fly_drone({}, 60, 8.0, *MANOEUVRES)),
        "drone/friction": Item(diagnose, fly_drone(FRICTION, 70, 8.0, *MANOEUVRES)),
        "drone/two": Item(diagnose, fly_drone(TWO, 80, 8.0, *MANOEUVRES)),
    }
    for number, duration in RIGS.items():
        items[f"rig/{number}"] = Item(partial(diagnose, "rig.yaml"), move_rig(number, duration), number in (7, 10))
    for name, hidden in CRAFTS.items():
        items[f"craft/{name}"] = Item(partial(diagnose, "twin.yaml"), move_craft(name, *hidden))
    return items


def list_examples() -> dict[str, Item]:
    """Diagnoses of measured logs, long ones cut, and of the logs that ship."""
    pendulum = copy_example("simple_pendulum", converted=["energy_shaping.csv"])
    double = copy_example("double_pendulum", converted=["design_A_00.csv"])
    arm = copy_example("so101", converted=["prbs_excitation", "--last", "24"])
    circle, rail, pitch = "B2_circle_fast_rep1.csv.gz", "rail_velocity_doublets_1.mcap", "pitch_free_decay.mcap"
    return {
        "example/simple_pendulum": Item(partial(diagnose, "pendulum.yaml"), pendulum),
        "example/simple_pendulum_short": Item(partial(diagnose, "pendulum.yaml", "log.mcap@0-5"), pendulum, True),
        "example/simple_pendulum_warp": Item(
            partial(diagnose, "pendulum.yaml", "log.mcap@0-5", "--device", "cpu"), pendulum
        ),
        "example/double_pendulum": Item(partial(diagnose, "both.yaml", "log.mcap@0-5"), double),
        "example/so101": Item(partial(diagnose, "rotation.yaml"), arm),
        "example/nanobench": Item(
            partial(diagnose, "crazyflie.yaml", f"{circle}@5-12"), copy_example("nanobench", circle)
        ),
        "example/antx_rail": Item(partial(diagnose, "rail.yaml", rail), copy_example("antx", rail)),
        "example/antx_pitch": Item(partial(diagnose, "pitch.yaml", pitch), copy_example("antx", pitch)),
        "example/crazypad": Item(weigh_hovers),
        "example/own_effects": Item(
            partial(diagnose, "", "*.mcap", "--effects", "in/cogging.py"), copy_example("own_effects")
        ),
        "compare": Item(
            partial(run_command, "compare", f"in/{rail}", "--twin", "in/rail.yaml", "--json", "out/errors.json"),
            copy_example("antx", rail),
        ),
        "demo": Item(partial(run_command, "demo", "--out", "out")),
    }


def list_commands() -> dict[str, Item]:
    """Flights, policies and environments."""
    fly = ("fly", "--manoeuvre", "aggressive_x", "--gusts", "--out", "out/log.mcap")
    return {
        "fly": Item(partial(run_command, *fly)),
        "evaluate": Item(partial(run_command, "evaluate", "flip", "--tracks", "50", "--json", "out/result.json")),
        "train": Item(partial(run_command, "train", *TRAINED)),
        "env/hover": Item(partial(fly_env, "hover", 1000), quick=True),
        "env/flip": Item(partial(fly_env, "flip", 300), quick=True),
        "env/wall-backtrack": Item(partial(fly_env, "wall-backtrack", 300)),
        "env/warp": Item(partial(fly_env, "flip", 200, "warp")),
        "export/c": Item(export_c, quick=True),
        "export/onnx": Item(export_onnx),
    }


def list_texts() -> dict[str, Item]:
    """Kernels before they are compiled, and catalogues."""
    arm = move_rig(4, 6.0)
    items = {
        "kernel/drone": Item(write_kernels, quick=True),
        "kernel/rig": Item(partial(write_kernels, "rig.yaml"), arm, True),
        "effects/drone": Item(partial(call, "effects"), quick=True),
        "effects/rig": Item(partial(call, "effects", "--twin", "in/rig.yaml"), arm),
    }
    for name in CRAFTS:
        items[f"kernel/{name}"] = Item(partial(write_kernels, "twin.yaml"), move_craft(name, {}, 1.0), True)
    return items


def list_looks() -> dict[str, Item]:
    """What `inspect` says of measured logs of all kinds, and the twins that it writes."""
    items = {}
    for path in INSPECTED:
        log, rig = DATA / path, path.split("/")[0]
        items[f"inspect/{rig}"] = Item(partial(call, "inspect", f"in/{log.name}"), copy_files(log))
        if rig in MODELS:
            model = ROOT / "examples" / rig / MODELS[rig]
            words = ("inspect", f"in/{log.name}", "--model", f"in/{model.name}", "--out", "out/twin.yaml")
            items[f"inspect/{rig}_model"] = Item(partial(run_command, *words), copy_files(log, model))
    return items
