"""A log is cut to where a body that its model lets fall does not stand."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from vpptwin.estimation.checks.support import CLEARANCE, find_flown
from vpptwin.estimation.series import Series

FREE = '<body><freejoint/><geom size="0.1"{}/></body>'
SLIDE = '<body><joint type="slide" axis="0 0 1"{}/><geom size="0.1" contype="0" conaffinity="0"/></body>'
BARE = ' contype="0" conaffinity="0"'
TIME = np.linspace(0.0, 10.0, 1001)
CLIMB = np.interp(TIME, [0.0, 3.0, 5.0, 7.0, 8.0], [0.05, 0.05, 1.05, 1.05, 0.05])
"""Stands for 3 s, climbs by 0.5 m/s, sinks by 1 m/s, stands for 2 s."""


def find(body: str, height: np.ndarray) -> tuple[float, float, list[str]]:
    """The span of such a log."""
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    noise = 1e-4 * np.random.default_rng(1).standard_normal((3, len(TIME)))
    values = noise + [[0.0], [0.0], [1.0]] * height
    series = [Series(axis, "m", TIME, value, 1e-4) for axis, value in zip("xyz", values)]
    return find_flown(model, dict(enumerate(series if model.nv == 6 else series[2:])), 0.0, 10.0)


@pytest.mark.parametrize("body", [FREE.format(BARE), SLIDE.format("")], ids=["free", "slide"])
def test_standing_is_left_out(body: str) -> None:
    """From when it is `CLEARANCE` above where it stood to when it is that near again, and a line says so."""
    start, end, told = find(body, CLIMB)
    assert start == pytest.approx(3.0 + CLEARANCE / 0.5, abs=0.02)
    assert end == pytest.approx(8.0 - CLEARANCE / 1.0, abs=0.02)
    span = f"the first {start:.1f} s and the last {10.0 - end:.1f} s"
    assert told == [f"{span} are left out: it is still there, and the MJCF has nothing to stand on"]


@pytest.mark.parametrize(
    ("body", "height"),
    [
        (FREE.format(""), CLIMB),
        (SLIDE.format(' frictionloss="1"'), CLIMB),
        (SLIDE.format("").replace("0 0 1", "1 0 0"), CLIMB),
        (FREE.format(BARE), 1.0 + 0.2 * np.sin(TIME)),
        (FREE.format(BARE), np.full(len(TIME), 0.05)),
    ],
    ids=["it may touch something", "friction holds it", "it does not fall", "it starts in flight", "it never flies"],
)
def test_all_else_is_left_alone(body: str, height: np.ndarray) -> None:
    """Whatever may stand by its model's own means, or never stands, keeps its log."""
    assert find(body, height) == (0.0, 10.0, [])


def test_who_comes_by_where_it_started_flies_on() -> None:
    """Still for a second in a hover, then up and down by it for the rest: no more than the first climb is left out."""
    swing = 1.0 + np.where(TIME > 1.0, 0.3 * np.sin(1.5 * (TIME - 1.0)), 0.0)
    start, end, _ = find(FREE.format(BARE), swing)
    assert start == pytest.approx(1.0 + np.arcsin(CLEARANCE / 0.3) / 1.5, abs=0.03)
    assert end == 10.0


def test_a_hop_is_no_flight() -> None:
    """0.2 s in the air a second before it climbs, and bouncing once as it lands."""
    hops = [CLIMB + 0.1 * (np.abs(TIME - middle) < 0.1) for middle in (2.0, 9.0)]
    assert find(FREE.format(BARE), hops[0])[0] == find(FREE.format(BARE), CLIMB)[0]
    assert find(FREE.format(BARE), hops[1])[1] == find(FREE.format(BARE), CLIMB)[1]
