"""The tutorial from a CSV and a menagerie's name to a verdict, as it stands in the docs."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import mujoco
import mujoco_menagerie
import numpy as np
import pytest
from numba import njit

from vpptwin.cli.main import main

PAGE = Path(__file__).resolve().parents[1] / "docs/five_minutes.md"
LENGTH, MIDDLE = 0.18, (0.13, 0.17)  # m: joint to joint, joint to the links' centres of mass
MASS, INERTIA = (0.29, 1.1), (0.0008, 0.0025)  # kg, kg m²
ARMATURE, FRICTION, HIDDEN = 0.005, 0.1, 0.6  # kg m², N m, N m more on R1
KP, KV, GRAVITY = 50.0, 5.0, 9.81
SLOW = 0.005  # rad/s, at which the arm's friction turns
STEP, EVERY, DURATION = 1e-4, 50, 10.0
COUNTS = 4096 / 360.0  # a degree
MJCF = f"""<mujoco model="dynamixel_2r"><compiler angle="radian" autolimits="true"/><option timestep="0.001"/>
<default><joint axis="0 1 0" frictionloss="{FRICTION}" armature="{ARMATURE}"/><position kp="{KP}" kv="{KV}"/></default>
<worldbody><body name="first_segment"><joint name="R1" range="-1.92 1.92"/>
<inertial pos="0 0 -{MIDDLE[0]}" mass="{MASS[0]}" diaginertia="{INERTIA[0]} {INERTIA[0]} {INERTIA[0]}"/>
<body name="second_segment" pos="0 0 -{LENGTH}"><joint name="R2" range="-2.618 2.618"/>
<inertial pos="0 0 -{MIDDLE[1]}" mass="{MASS[1]}" diaginertia="{INERTIA[1]} {INERTIA[1]} {INERTIA[1]}"/>
</body></body></worldbody>
<actuator><position name="R2" joint="R2" ctrlrange="-2.618 2.618"/>
<position name="R1" joint="R1" ctrlrange="-1.92 1.92"/></actuator></mujoco>"""


@njit
def accelerate(q, v, target, hidden):  # noqa: ANN001, ANN201
    """Lagrange's equations of two links that hang, angles from straight down, the second relative to the first."""
    (m1, m2), (a, b), (i1, i2) = MASS, MIDDLE, INERTIA
    c, s = np.cos(q[1]), np.sin(q[1])
    m22 = i2 + m2 * b * b
    m12 = m22 + m2 * LENGTH * b * c
    m11 = i1 + m1 * a * a + m2 * LENGTH * LENGTH + 2.0 * m12 - m22 + ARMATURE
    g2 = m2 * GRAVITY * b * np.sin(q[0] + q[1])
    g1 = (m1 * a + m2 * LENGTH) * GRAVITY * np.sin(q[0]) + g2
    h = m2 * LENGTH * b * s
    rub = np.tanh(v / SLOW)
    f1 = KP * (target[0] - q[0]) - KV * v[0] - (FRICTION + hidden) * rub[0] - g1 + h * (2.0 * v[0] + v[1]) * v[1]
    f2 = KP * (target[1] - q[1]) - KV * v[1] - FRICTION * rub[1] - g2 - h * v[0] * v[0]
    d = m11 * (m22 + ARMATURE) - m12 * m12
    return np.array([((m22 + ARMATURE) * f1 - m12 * f2) / d, (m11 * f2 - m12 * f1) / d])


@njit
def fly(targets, hidden):  # noqa: ANN001, ANN201
    """Angles and rates (n, 4) at every sample, by the classical method of Runge and Kutta."""
    way, q, v, dt = np.zeros((len(targets), 4)), np.zeros(2), np.zeros(2), STEP
    for i in range(len(targets)):
        way[i, :2], way[i, 2:] = q, v
        for _ in range(EVERY):
            k1 = accelerate(q, v, targets[i], hidden)
            v2 = v + 0.5 * dt * k1
            k2 = accelerate(q + 0.5 * dt * v, v2, targets[i], hidden)
            v3 = v + 0.5 * dt * k2
            k3 = accelerate(q + 0.5 * dt * v2, v3, targets[i], hidden)
            v4 = v + dt * k3
            k4 = accelerate(q + dt * v3, v4, targets[i], hidden)
            q = q + dt / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v = v + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return way


def write_log(path: Path, seed: int) -> None:
    """A run to random targets, with an encoder's counts and noise of the rate, as the page shows it."""
    rng, dt = np.random.default_rng(seed), STEP * EVERY
    count = round(DURATION / dt)
    holds = np.cumsum(rng.integers(80, 240, count // 80))
    targets = rng.uniform(-0.8, 0.8, (len(holds) + 1, 2))[np.searchsorted(holds, np.arange(count), side="right")]
    targets = np.round(targets, 3)
    way = np.degrees(fly(targets, HIDDEN))
    places = np.round(way[:, :2] * COUNTS) / COUNTS
    rates = way[:, 2:] + rng.normal(0.0, 1.0, (count, 2))
    head = re.search(r"^ {4}(time .*)$", PAGE.read_text(), flags=re.MULTILINE)
    assert head is not None
    lines = [
        ";".join([str(round(1e3 * dt * i)), *(f"{p:.3f}" for p in place), *(f"{r:.1f}" for r in rate),
                  *(f"{t:.3f}" for t in target)])
        for i, (place, rate, target) in enumerate(zip(places, rates, targets))
    ]  # fmt: skip
    path.write_text("\n".join([head.group(1), *lines]) + "\n")


def test_the_integrator_is_the_stand_in_without_friction() -> None:
    """Its accelerations are MuJoCo's, which knows the same arm by its bodies."""
    model = mujoco.MjModel.from_xml_string(MJCF)
    model.dof_frictionloss[:] = 0.0
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(20):
        data.qpos[:], data.qvel[:], target = rng.uniform(-1.5, 1.5, (3, 2))
        data.ctrl[:] = target[::-1]
        mujoco.mj_forward(model, data)
        rub = FRICTION * np.tanh(data.qvel / SLOW)
        expected = data.qacc - np.linalg.solve(full_inertia(model, data), rub)
        np.testing.assert_allclose(accelerate(data.qpos, data.qvel, target, 0.0), expected, rtol=1e-9, atol=1e-9)


def full_inertia(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Joint-space inertia, (2, 2) kg m²."""
    inertia = np.zeros((2, 2))
    mujoco.mj_fullM(model, data, inertia)
    return inertia


@pytest.mark.slow
def test_the_page_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every command works, the friction is named with its size, and the twin predicts better for it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "menagerie").mkdir()
    stand_in = tmp_path / "menagerie" / "dynamixel_2r.xml"
    stand_in.write_text(MJCF)
    monkeypatch.setattr(mujoco_menagerie.Robot, "xml", lambda self, entry=None: stand_in)
    for seed in (1, 2):
        write_log(Path(f"arm_{seed}.csv"), seed)
    commands = re.findall(r"^ {4}vpptwin (.*)$", PAGE.read_text(), flags=re.MULTILINE)
    assert len(commands) == 7
    for command in commands:
        assert main(shlex.split(command)) == 0, command
    assert "R1 position is in deg" in " ".join(capsys.readouterr().out.split())
    verdict = json.loads(Path("arm/verdict.json").read_text())
    first = verdict["causes"][0]
    assert first["effect"] == "R1.coulomb"
    assert first["parameters"]["torque"]["value"] == pytest.approx(HIDDEN, rel=0.1)
    errors = [sum(verdict[when]["angle_rmse_rad"]) for when in ("before", "after")]
    assert errors[1] < 0.6 * errors[0]
    assert '<joint name="R1"' in Path("dynamixel_2r_mine.xml").read_text()
    assert "R1_joint_friction" in Path("dynamixel_2r_events.py").read_text()
