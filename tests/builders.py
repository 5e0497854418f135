"""Small real objects that many tests share: a rig of a few lines of MJCF, windows of it on a bench, fits, a verdict."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement.holdout import Score
from vpptwin.diagnosis.judgement.selection import Explanation
from vpptwin.diagnosis.judgement.verdict import Cause, Estimate, Rival, Unexplained, Verdict
from vpptwin.estimation.windows import Windows
from vpptwin.twin.robot.robot import Disturbance, Robot
from vpptwin.twin.spec import TwinSpec, load_twin

SLIDERS = """<mujoco><option timestep="0.001"/><worldbody>
  <body><joint name="a" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
  <body><joint name="b" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
</worldbody><actuator><motor name="first" joint="a"/><motor name="second" joint="b"/></actuator></mujoco>"""
"""Two carts side by side, each with a motor."""
CART = """<mujoco><worldbody>
  <body><joint name="a" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
</worldbody><actuator><motor name="motor" joint="a"/></actuator></mujoco>"""
FOLDER = TemporaryDirectory(prefix="vpptwin-rigs-")


@cache
def load_rig(mjcf: str = CART, signals: str = "") -> TwinSpec:
    """The twin of a rig, read from its files; with no signals all of its joints and actuators are logged."""
    folder = Path(FOLDER.name) / str(len(list(Path(FOLDER.name).iterdir())))
    folder.mkdir()
    (folder / "rig.xml").write_text(mjcf)
    if not signals:
        model = mujoco.MjModel.from_xml_string(mjcf)
        joints = ", ".join(f"{model.joint(i).name}: /joint_states" for i in range(model.njnt))
        actuators = ", ".join(f"{model.actuator(i).name}: /actuator_command" for i in range(model.nu))
        signals = f"{{joints: {{{joints}}}, actuators: {{{actuators}}}}}"
    (folder / "rig.yaml").write_text(f"model: rig.xml\nsignals: {signals}\n")
    return load_twin(folder / "rig.yaml")


@dataclass(frozen=True)
class Disturbed(Robot):
    """A rig of which somebody says what disturbs it."""

    disturbance: Disturbance = field(default_factory=lambda: Disturbance(np.ones(1)))


def disturb(spec: TwinSpec, disturbance: Disturbance) -> TwinSpec:
    """The same twin, disturbed so."""
    known = {f.name: getattr(spec.robot, f.name) for f in fields(Robot)}
    return TwinSpec(spec.name, spec.model_file, Disturbed(**known, disturbance=disturbance), spec.catalogue, {})


@cache
def load_known(mjcf: str = CART) -> TwinSpec:
    """A rig of which, as of the drone, it is known how logs without any effect look."""
    spec = load_rig(mjcf)
    return disturb(spec, Disturbance(np.ones(spec.model.nv), known=True))


def lay_windows(
    spec: TwinSpec, start: np.ndarray | list[float], flight: np.ndarray | list[int] | None = None,
    command: np.ndarray | None = None, steps: int = 1,
) -> Windows:  # fmt: skip
    """Windows of a rig at rest, of which times and commands, (K, steps, nu), count."""
    start, model = np.array(start, dtype=float), spec.model
    count = len(start)
    flights = np.zeros(count, dtype=int) if flight is None else np.array(flight)
    command = np.zeros((count, steps, model.nu)) if command is None else command
    pose = np.tile(spec.robot.start_pose, (count, 1))
    return Windows(
        flights, start, command.shape[1], float(model.opt.timestep), np.zeros((1, 1, model.nu)),
        np.zeros(count, dtype=int), command, None, pose, np.zeros((count, model.nv)),
    )  # fmt: skip


def lay_bench(
    start: np.ndarray | list[float], flight: np.ndarray | list[int] | None = None, spec: TwinSpec | None = None,
    command: np.ndarray | None = None, steps: int = 1, segments: int = 1,
) -> Bench:  # fmt: skip
    """The same on a bench, with nothing measured in them."""
    spec = load_rig() if spec is None else spec
    return Bench(spec, lay_windows(spec, start, flight, command, steps), [], segments)


def guess(values: dict[Key, float], gust: float = 1.0) -> Explanation:
    """An explanation of which values count, under gusts as the robot states or so many times as strong."""
    off, freed = dict.fromkeys(values, 0.0), frozenset(effect for effect, _ in values)
    return Explanation(freed, values, off, {}, np.array([gust]), CRITERIA)


FORCE = Estimate(0.3081, "N", 0.0123, 0.0)
CAUSE = Cause(
    "rail_x.coulomb", 0.9, {"force": FORCE}, 0.62, [Rival("rail_x.viscous", 0.06), Rival("air.drag", 0.04)],
    "dry friction on the horizontal rail",
)  # fmt: skip
BEFORE = Score([0.001, 0.002, 0.005, 0.01, 0.02], [0.01, 0.02, 0.03, 0.04, 0.05], {"θ rate": [1, 2, 3, 4, 5.0]}, 9.0)
AFTER = Score([0.001, 0.001, 0.002, 0.004, 0.0049], [0.01, 0.01, 0.01, 0.02, 0.02], {"θ rate": [1, 1, 1, 1, 2.0]}, 1.1)
VERDICT = Verdict(
    ["a.mcap", "b.mcap"], "nominal", 80, 40, BEFORE, AFTER, True, [CAUSE], Unexplained(False, 0.01, None, []),
    warnings=["late"],
)  # fmt: skip
"""Two flights that lack dry friction on the rail."""
