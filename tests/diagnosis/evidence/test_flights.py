"""Which stretches of which flights are fitted and which judge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.builders import load_rig
from tests.diagnosis.carts import load_cart
from vpptwin.diagnosis.evidence.flights import SETTLE, choose_window, list_starts, long_starts, thin_out
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import load_twin


def fly(duration: float, rate: float = 100.0) -> Measurements:
    """A flight of some length with one joint."""
    time = np.arange(0.0, duration + 1e-9, 1.0 / rate)
    position = Series("slide", "m", time, np.sin(time), 1e-3)
    command = Series("control", "", time, np.zeros((len(time), 1)), 0.0)
    return Measurements("made by hand", {0: position}, {}, None, command, None, (), 0.0, duration)


def test_windows_lie_side_by_side_inside_the_flight() -> None:
    """In 6 s there is room for 19 windows of 0.3 s from 0.2 s on: the last ends at 5.9 s."""
    (starts,) = list_starts([fly(6.0)], 0.3)
    np.testing.assert_allclose(starts, SETTLE + 0.3 * np.arange(19))


def test_too_many_windows_are_thinned_out_evenly() -> None:
    """Of 700 + 380 windows of the drone at most 240 stay: every fifth; of those that judge 120: every ninth."""
    starts = [np.arange(700.0), np.arange(380.0)]
    for judging, every in ((False, 5), (True, 9)):
        for all_of_them, kept in zip(starts, thin_out(load_twin(), starts, judging)):
            np.testing.assert_array_equal(kept, all_of_them[::every])
    # Nothing is left out below the limit.
    starts = [np.arange(150.0), np.arange(90.0)]
    assert thin_out(load_twin(), starts) is starts
    # Windows of 1 s start every 0.6 s where short ones last 0.3 s: the first multiple of 0.3 s from half a second.
    (starts,) = long_starts([SETTLE + 0.3 * np.arange(20)], 0.3)
    np.testing.assert_allclose(np.diff(starts), 0.6)


@pytest.mark.parametrize(("joints", "every"), [(1, 2), (2, 3), (3, 4), (6, 9)])
def test_of_somebody_elses_rig_fewer_windows_are_looked_at(joints: int, every: int) -> None:
    """Of 180 windows at most 90 for one joint; for two 90/(2/1.5) = 68, for three 45, for six 22: every ninth."""
    body = '<body pos="0.1 0 0"><joint name="j{}" axis="0 1 0"/><geom size="0.05" mass="1"/>'
    chain = "".join(body.format(i) for i in range(joints)) + "</body>" * joints
    (kept,) = thin_out(load_rig(f"<mujoco><worldbody>{chain}</worldbody></mujoco>"), [np.arange(180.0)])
    np.testing.assert_array_equal(kept, np.arange(0.0, 180.0, every))


def test_sparse_flights_are_refused() -> None:
    """Under 20 poses a second there is nothing to diagnose."""
    with pytest.raises(InputError, match="measured 15 times a second"):
        list_starts([fly(8.0), fly(8.0, rate=15.0)], 0.3)


@pytest.mark.parametrize(("duration", "window", "judges"), [(4.0, 0.4, 3), (6.0, 0.6, 3), (9.0, 0.9, 3), (9.5, 1.0, 3)])
def test_windows_are_as_short_as_a_lone_log_asks_for(
    tmp_path: Path, duration: float, window: float, judges: int
) -> None:
    """Nine windows fit into (duration - 0.2 s) / 9, in steps of 0.1 s; a third may be a fold, and the log warns."""
    spec, (flight,) = choose_window(load_cart(tmp_path), [fly(duration)])
    assert spec.robot.window == window
    assert spec.robot.is_short == (window < 1.0) == bool(flight.warnings)
    assert len(list_starts([flight], window)[0]) // 3 == judges
    if window < 1.0:
        assert f"windows have {window:g} s" in flight.warnings[0]


def test_several_logs_of_some_seconds_keep_the_usual_window(tmp_path: Path) -> None:
    """Where whole logs judge, three windows each are enough: 4.5 s hold four of 1 s."""
    spec, flights = choose_window(load_cart(tmp_path), [fly(4.5), fly(4.5)])
    assert (spec.robot.window, [f.warnings for f in flights]) == (1.0, [(), ()])


@pytest.mark.parametrize(("length", "window"), [(0.1, 0.2), (0.4, 0.5), (5.0, 1.0)])
def test_windows_end_before_errors_outgrow_linear_thought(length: float, window: float) -> None:
    """A point mass upside down on a rod: errors grow at √(g/l), in a window by a factor of exp(2.5) at most."""
    pole = load_rig(
        "<mujoco><worldbody><body><joint name='slide' axis='0 1 0'/>"
        f"<geom type='sphere' size='0.001' mass='1' pos='0 0 {length}'/></body></worldbody></mujoco>"
    )
    still = fly(30.0)
    standing = replace(still, positions={0: replace(still.positions[0], value=0.0 * still.positions[0].value)})
    spec, (flight,) = choose_window(pole, [standing])
    assert (spec.robot.window, spec.robot.is_short, flight.warnings) == (window, False, ())


def test_too_short_logs_are_refused_and_the_drone_keeps_its_windows(tmp_path: Path) -> None:
    """Below 4 s, of the drone below 5 s; its windows are 0.3 s whatever the log."""
    for spec, duration, least in ((load_cart(tmp_path), 3.9, "4 s"), (load_twin(), 4.9, "5 s")):
        with pytest.raises(InputError, match=f"{duration} s in which all .* at least {least}"):
            choose_window(spec, [fly(8.0), fly(duration)])
    assert choose_window(load_twin(), [fly(5.0)])[0].robot.window == 0.3
