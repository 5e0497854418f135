"""A whole flight replayed: in its own twin it is followed, in a wrong one the error is what is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.estimation.synthetic import OwnFlight, draw_commands, fly_own
from vpptwin.estimation.replay import replay
from vpptwin.logs.flight import Flight
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin, load_twin

SPEC = load_twin()
COMMANDS = draw_commands(1750, seed=2, quiet=200)
MASS_X = 0.58  # kg


@pytest.fixture(scope="module")
def own() -> OwnFlight:
    """1.75 s of the twin's own flight."""
    return fly_own(SPEC, COMMANDS)


def trim(flight: Flight, seconds: float) -> Flight:
    """The first seconds of a flight."""
    streams = {}
    for topic, stream in flight.streams.items():
        kept = stream.time <= seconds
        streams[topic] = replace(stream, time=stream.time[kept], values={k: v[kept] for k, v in stream.values.items()})
    return replace(flight, streams=streams)


def test_own_flight_is_followed(own: OwnFlight) -> None:
    """Half a second after each restart the twin is within a millimetre of its own noise-free flight."""
    prediction = replay(SPEC, own.flight, restart=0.5)
    pose, velocity = own.state_at(prediction.time)
    # A rate wrong by 0.002 rad/s at a restart (test_windows tells why) tilts by 1 mrad in 0.5 s: g 0.002 T³/6 in x.
    np.testing.assert_allclose(prediction.qpos[:, :2], pose[:, :2], rtol=0, atol=4.1e-4)
    np.testing.assert_allclose(prediction.qpos[:, 2], pose[:, 2], rtol=0, atol=1e-3)
    np.testing.assert_allclose(prediction.qvel, velocity, rtol=0, atol=0.0025)


def test_prediction_is_on_a_regular_clock(own: OwnFlight) -> None:
    """Predictions come at 100 Hz from 0.2 s on, with what drove the twin, restarted every 0.5 s while data lasts."""
    prediction = replay(SPEC, own.flight, restart=0.5)
    begin = 0.2 + own.flight.streams["/imu/data"].time[0]
    np.testing.assert_allclose(prediction.restarts, begin + 0.5 * np.arange(3), rtol=0, atol=1e-9)
    np.testing.assert_allclose(prediction.time, begin + 0.01 * np.arange(150), rtol=0, atol=1e-9)
    assert prediction.qpos.shape == prediction.qvel.shape == (150, 3)
    assert prediction.blade_pitch.shape == prediction.rotor_speed.shape == (150, 2)
    halves = 0.5 * (COMMANDS[200:1700:10] + COMMANDS[201:1701:10])  # steps lie half a millisecond off the stamps
    np.testing.assert_allclose(prediction.blade_pitch, halves, rtol=0, atol=1e-9)


def test_free_run_is_one_window(own: OwnFlight) -> None:
    """Without restarts one window reaches from the start to the end of what was measured."""
    prediction = replay(SPEC, own.flight, restart=None)
    assert len(prediction.restarts) == 1
    assert prediction.time[-1] > 1.72
    error = np.abs(prediction.qpos - own.state_at(prediction.time)[0])
    assert error[:, :2].max() < 9.81 * 0.002 * 1.55**3 / 6


@pytest.mark.parametrize("force", [0.5, -0.3])
def test_error_of_a_wrong_twin_is_what_it_lacks(force: float) -> None:
    """A pull on the rail that the twin lacks leaves F t²/(2 m) after each restart."""
    pulled = SPEC.with_effects({"rail_x.bias": {"force": force}})
    flight = fly_own(pulled, COMMANDS)
    wrong, right = (replay(spec, flight.flight, restart=0.5) for spec in (SPEC, pulled))
    lacking = flight.state_at(wrong.time)[0][:, 0] - wrong.qpos[:, 0]
    elapsed = np.mod(wrong.time - wrong.restarts[0] + 1e-9, 0.5)
    np.testing.assert_allclose(lacking, 0.5 * force / MASS_X * elapsed**2, rtol=0, atol=4.1e-4)
    assert np.abs(lacking).max() > 0.05
    assert np.abs(flight.state_at(right.time)[0][:, 0] - right.qpos[:, 0]).max() < 4.1e-4


def test_flight_without_imu(own: OwnFlight) -> None:
    """Motion capture and commands are enough; starts are less sharp, so errors grow faster, to centimetres."""
    flight = fly_own(SPEC, COMMANDS, imu=False).flight
    prediction = replay(SPEC, flight, restart=0.25)
    error = np.abs(prediction.qpos - own.state_at(prediction.time)[0])
    assert error[:, :2].max() < 0.03
    assert np.isfinite(prediction.qvel).all()


def test_flight_without_rotor_speeds(own: OwnFlight) -> None:
    """Where rotor speed was not measured the governed speed is assumed, which here is the true one."""
    flight = fly_own(SPEC, COMMANDS, rotors=False).flight
    with_speed, without = replay(SPEC, own.flight), replay(SPEC, flight)
    np.testing.assert_array_equal(without.rotor_speed, 471.239)
    np.testing.assert_allclose(without.qpos, with_speed.qpos, rtol=0, atol=1e-9)


@pytest.mark.parametrize("restart", [0.5, None])
def test_too_short_a_flight_is_refused(own: OwnFlight, restart: float | None) -> None:
    """A flight shorter than the first restart is refused in one line that says how much is needed."""
    with pytest.raises(InputError, match=r"own\.mcap: 0\.2\d s of usable log; expected at least 0\.\d+ s"):
        replay(SPEC, trim(own.flight, 0.25), restart)


@pytest.mark.parametrize("topic", ["/mocap/pose", "/rotor/command"])
def test_missing_topic_is_refused(own: OwnFlight, topic: str) -> None:
    """Without poses or commands there is nothing to replay, and the message names the topic."""
    streams = {name: stream for name, stream in own.flight.streams.items() if name != topic}
    with pytest.raises(InputError, match=topic):
        replay(SPEC, replace(own.flight, streams=streams))


def test_a_mode_rings_on_over_restarts(monkeypatch: pytest.MonkeyPatch) -> None:
    """What rang before a restart goes on: begun at rest the twin would miss its own flight five times as far."""
    elastic = SPEC.with_effects({"rail_x.elastic": {"share": 0.3, "frequency": 5.0, "zeta": 0.02}})
    own = fly_own(elastic, COMMANDS)
    missed = []
    for remembers in (True, False):
        monkeypatch.setattr(Twin, "remembers", remembers)
        prediction = replay(elastic, own.flight, restart=0.5)
        missed.append(np.abs(prediction.qpos[:, 0] - own.state_at(prediction.time)[0][:, 0])[50:].max())
    assert missed[0] < 0.2 * missed[1], missed
