"""Which way weight pulls: MJCFs without gravity or upside down are refused, and whatever holds a rig up is not."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from proving.kinds import write_kind
from tests.estimation.test_gate import find_case, vet
from vpptwin.logs.flight import Flight
from vpptwin.logs.read import read_flight
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import TwinSpec, load_twin

MASS, GRAVITY, DRAG, STEP, EVERY = 3.0, 9.81, 4.0, 5e-4, 10  # kg, m/s², N s/m, s, steps of a sample
LIFT = """<mujoco><option timestep="0.001" gravity="{gravity}"/><worldbody><body name="cabin">
<joint name="lift" type="slide" axis="{axis}"/><geom type="box" size=".1 .1 .1" mass="3.0"/>
</body></worldbody><actuator><motor name="winch" joint="lift"/></actuator></mujoco>"""


def load(folder: Path, log: Path, topic: str) -> tuple[TwinSpec, Flight]:
    """The twin of a folder and its log."""
    spec = load_twin(folder / topic)
    return spec, read_flight(log, signals=spec.robot.signals.entries)


def write_lift(folder: Path, axis: str = "0 0 1", gravity: str = "0 0 -9.81", held: float = 0.0) -> Path:
    """A lift under a winch that goes to heights, integrated by hand; `held` [N] bears it all along."""
    rng, z, v, rows = np.random.default_rng(3), 0.0, 0.0, []
    for k in range(3000):
        goal = 0.4 * np.sin(1.3 * k * STEP * EVERY) + 0.2 * np.sign(np.sin(0.7 * k * STEP * EVERY))
        force = 300.0 * (goal - z) - 40.0 * v + MASS * GRAVITY - held
        rows.append((k * STEP * EVERY, z + 2e-5 * rng.standard_normal(), force))
        for _ in range(EVERY):
            v += STEP * (force + held - MASS * GRAVITY - DRAG * v) / MASS
            z += STEP * v
    np.savetxt(folder / "up.csv", rows, delimiter=",", header="t,lift,winch", comments="", fmt="%.7g")
    (folder / "rig.xml").write_text(LIFT.format(axis=axis, gravity=gravity))
    lines = ["joints: {lift: {topic: up, position: lift}}", "actuators: {winch: {topic: up, effort: winch}}"]
    (folder / "lift.yaml").write_text("model: rig.xml\nsignals:\n  " + "\n  ".join(lines) + "\n")
    return folder / "up.csv"


@pytest.mark.parametrize("held", [0.0, 5.0, MASS * GRAVITY])
def test_a_lift_with_or_without_a_counterweight_passes(tmp_path: Path, held: float) -> None:
    """What bears it is for the diagnosis."""
    vet(*load(tmp_path, write_lift(tmp_path, held=held), "lift.yaml"))


@pytest.mark.parametrize(
    ("axis", "gravity", "told"),
    [
        ("0 0 -1", "0 0 -9.81", r'gravity="0 0 9.81"|axis="0 0 1" for lift'),
        ("0 0 1", "0 0 0", r'the MJCF has no gravity.*gravity="0 0 -9.81"'),
        ("0 0 1", "0 0 9.81", r'gravity="0 0 -9.81"'),
    ],
)
def test_a_lift_whose_weight_pulls_up_or_not_at_all_is_refused(
    tmp_path: Path, axis: str, gravity: str, told: str
) -> None:
    """Although a constant force would explain it."""
    log = write_lift(tmp_path, axis, gravity)
    with pytest.raises(InputError, match=told):
        vet(*load(tmp_path, log, "lift.yaml"))


@pytest.mark.parametrize("rig", ["decay_1", "quiet_2", "leg", "quad", "simple", "double"])
def test_rigs_in_a_model_without_gravity_are_refused(tmp_path: Path, rig: str) -> None:
    """Of kinds, worlds and measured logs."""
    twin, (log, *_) = find_case(rig)
    for path in (twin, twin.parent / re.search(r"^model: (\S+)", twin.read_text(), re.MULTILINE)[1]):
        (tmp_path / path.name).write_text(path.read_text())
    path = tmp_path / path.name
    text = re.sub(r' gravity="[^"]*"', "", path.read_text())
    path.write_text(text.replace("<worldbody>", '<option gravity="0 0 0"/><worldbody>', 1))
    with pytest.raises(InputError, match="the MJCF has no gravity"):
        vet(*load(tmp_path, log, twin.name))


def test_a_cart_has_no_weight_to_miss(tmp_path: Path) -> None:
    """Without gravity a level rail says nothing."""
    case = write_kind("sweep", 1, tmp_path)
    model = tmp_path / "rig.xml"
    model.write_text(model.read_text().replace("<option ", '<option gravity="0 0 0" ', 1))
    vet(*load(tmp_path, case.logs[0], "twin.yaml"))
