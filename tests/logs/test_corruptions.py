"""Logs as spoilt as real ones: they give the same measurements, or say in one line what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proving.drone.recording import Recording, write_mcap
from tests.logs import corrupt
from tests.logs.corrupt import COMMAND, IMU, POLICY, POSE, STATE, copy_column, hold, scale, set_clock
from vpptwin.diagnosis.evidence.flights import list_starts
from vpptwin.diagnosis.judgement.material import open_held_out
from vpptwin.estimation.gaps import usable_starts
from vpptwin.estimation.measurements import Measurements, read_measurements
from vpptwin.logs import read_flight
from vpptwin.system.errors import InputError
from vpptwin.twin import load_twin

SPEC = load_twin()
Spoil = Callable[[Recording, np.random.Generator], Recording]


@pytest.fixture(scope="module")
def measure(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Recording], tuple[Measurements, list[str]]]:
    """A function that writes a recording, reads it back, and gives measurements and all warnings."""

    def run(recording: Recording) -> tuple[Measurements, list[str]]:
        path: Path = write_mcap(recording, tmp_path_factory.mktemp("spoilt") / "flight.mcap")
        flight = read_flight(path)
        measurements = read_measurements(SPEC, flight)
        return measurements, [*flight.warnings, *measurements.warnings]

    return run


@pytest.fixture(scope="module")
def clean(recording: Recording, measure: Callable[[Recording], tuple[Measurements, list[str]]]) -> Measurements:
    """The flight as it was recorded."""
    measurements, warnings = measure(recording)
    assert all("gap" in warning for warning in warnings)  # of the tracker, as long as the simulation makes them
    return measurements


def differ(clean: Measurements, spoilt: Measurements) -> dict[str, float]:
    """Greatest distance of the spoilt tracks from the clean ones, in standard deviations of a sample."""
    pairs = [(clean.positions[i], spoilt.positions[i]) for i in range(3)]
    pairs += [(clean.velocities[2], spoilt.velocities[2])] if 2 in spoilt.velocities else []
    result = {}
    for before, after in pairs:
        inside = (before.time >= after.time[0]) & (before.time <= after.time[-1])
        nearest = np.clip(np.searchsorted(after.time, before.time[inside]), 1, len(after.time) - 1)
        close = np.diff(after.time)[nearest - 1] < 0.025  # a line through a longer gap proves nothing
        value = np.interp(before.time[inside], after.time, after.value)
        result[before.name] = float(np.abs(value - before.value[inside])[close].max() / before.std)
    return result


SPIKES = {
    POSE: {"x": 0.8, "z": 0.8, "qy": 0.0},
    IMU: {"wy": 12.0, "ax": 60.0, "az": 60.0},
    STATE: {"speed_1": 120.0, "speed_2": 120.0},
}


@pytest.mark.parametrize("topic", [POSE, IMU, STATE])
def test_outliers_are_left_out_and_counted(
    recording: Recording, clean: Measurements, measure: Callable, topic: str
) -> None:
    """Of 0.5 % wild samples nearly all go, no other does, and a warning says how many: flips at 12 rad/s stay."""
    columns = {name: size for name, size in SPIKES[topic].items() if size}
    spoilt, bad = corrupt.spike(recording, topic, columns, 0.005, np.random.default_rng(5))
    measured, warnings = measure(spoilt)
    (line,) = (text for text in warnings if "are outliers" in text)
    count = int(line.split(": ")[1].split()[0])
    assert line == f"{topic}: {count} of {len(bad)} samples are outliers, left out"
    assert 0.97 * bad.sum() <= count <= bad.sum()
    series = {POSE: measured.positions[0], IMU: measured.velocities[2], STATE: measured.rotor_speed}[topic]
    assert len(series.time) == len(bad) - count
    assert max(differ(clean, measured).values()) < 8.0


@pytest.mark.parametrize("angle", [0.0, 1.5, np.pi])
def test_frames_of_another_body_are_left_out(
    recording: Recording, clean: Measurements, measure: Callable, angle: float
) -> None:
    """A tracker that follows another body for a fifth of a second, in mid flip, turns nobody round for good."""
    spoilt = corrupt.swap(recording, 1.5, 1.7, 0.4, -0.3, angle)
    measured, warnings = measure(spoilt)
    assert any("samples are outliers" in text for text in warnings)
    time = measured.positions[2].time
    assert not ((time >= 1.5) & (time < 1.7)).any()
    assert max(differ(clean, measured).values()) < 8.0


def test_a_turn_during_a_gap_is_followed_by_the_gyro(recording: Recording, measure: Callable) -> None:
    """The angle after a gap in which the craft turned over is right to the turn."""
    measured, _ = measure(corrupt.cut(recording, POSE, 1.0, 2.6))
    angle = measured.positions[2]
    truth = np.interp(angle.time, recording.truth["time"], recording.truth["position"][:, 2])
    np.testing.assert_allclose(angle.value - truth, 0.0, atol=0.1)


def test_a_frozen_tracker_is_noticed(recording: Recording, clean: Measurements, measure: Callable) -> None:
    """Repeats of one pose count as missing when the craft moved on."""
    measured, warnings = measure(corrupt.freeze(recording, 1.4, 1.8))
    assert any("repeat a frozen pose, left out" in text for text in warnings)
    time = measured.positions[0].time
    assert np.count_nonzero((time >= 1.4) & (time < 1.8)) <= 1
    assert max(differ(clean, measured).values()) < 8.0
    assert not usable_starts(measured, np.array([1.75]), 0.3).any()


BLEMISHES: dict[str, tuple[Spoil, str, float]] = {
    "dropouts": (lambda r, g: corrupt.drop(r, POSE, 0.2, g), "", 8.0),
    "imu dropouts": (lambda r, g: corrupt.drop(r, IMU, 0.05, g), "", 8.0),
    "jitter": (lambda r, g: corrupt.jitter(r, POSE, 0.0005, g), "", 12.0),  # 12 rad/s in 3 sigma: 6 noises
    "imu jitter": (lambda r, g: corrupt.jitter(r, IMU, 0.0003, g), "out of order", 25.0),
    "late records": (lambda r, g: corrupt.shuffle(r, POSE, 0.2, g), "out of order", 1e-9),
    "late imu": (lambda r, g: corrupt.shuffle(r, IMU, 0.05, g), "out of order", 1e-9),
    "doubled": (lambda r, g: corrupt.repeat(r, POSE, 0.1, g), "repeat a stamp, dropped", 1e-9),
    "late start": (lambda r, g: corrupt.cut(r, IMU, -1.0, 1.5), "/imu/data starts 1.5 s late", 1e-9),
    "early end": (lambda r, g: corrupt.cut(r, STATE, 5.0, 9.0), "/rotor/state ends 3.0 s early", 1e-9),
    "no telemetry": (lambda r, g: corrupt.remove(r, STATE), "no /rotor/state: rotors are taken to turn at", 1e-9),
    "no imu": (lambda r, g: corrupt.remove(r, IMU), "no /imu/data: rates and forces come from /mocap/pose", 1e-9),
    "no accelerometer": (lambda r, g: scale(r, IMU, 0.0, "ax", "az"), "no accelerometer on /imu/data", 1e-9),
    "wild quaternions": (  # the tracker loses its body once and sends zeros, far away
        lambda r, g: corrupt.put(r, POSE, 200, qy=0.0, qw=0.0, x=1e4),
        "1 of 799 messages on /mocap/pose hold impossible values, left out, first at 2.", 8.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BLEMISHES)
def test_blemishes_change_little(recording: Recording, clean: Measurements, measure: Callable, name: str) -> None:
    """What a log lacks or shows twice moves the tracks by no more than noise, and warnings tell of it."""
    spoil, warning, bound = BLEMISHES[name]
    measured, warnings = measure(spoil(recording, np.random.default_rng(1)))
    assert any(warning in text for text in warnings) or not warning
    assert not any("\n" in text for text in warnings)
    assert max(differ(clean, measured).values()) <= bound


@pytest.mark.parametrize(
    ("topic", "lost"), [(COMMAND, (3.0, 3.7)), (POSE, (3.2, 4.0)), (IMU, (2.9, 4.0)), (STATE, (2.8, 3.9))]
)
def test_windows_in_gaps_are_left_out(
    recording: Recording, clean: Measurements, measure: Callable, topic: str, lost: tuple[float, float]
) -> None:
    """Of a gap from 3 to 3.9 s the windows around it are left out, the others stay, and the share is told."""
    measured, warnings = measure(corrupt.cut(recording, topic, 3.0, 3.9))
    starts = np.arange(0.2, 7.5, 0.1)
    before, after = usable_starts(clean, starts, 0.3), usable_starts(measured, starts, 0.3)
    assert before.all()
    assert not after[(starts > lost[0]) & (starts < lost[1])].any()
    assert after[(starts < 2.6) | (starts > 4.3)].all()
    assert any("leave out" in text and "of the flight" in text for text in warnings)


def test_policy_commands_replace_rotor_commands(recording: Recording, clean: Measurements, measure: Callable) -> None:
    """Without rotor telemetry blade pitch comes from policy and gyro, to the firmware's rounding, and it is told."""
    measured, warnings = measure(corrupt.remove(recording, COMMAND, STATE))
    settled = slice(20, None)
    np.testing.assert_array_equal(measured.command.time, clean.command.time)
    difference = (measured.command.value - clean.command.value)[settled]
    assert np.abs(difference).max() < 0.51 * 2.0**-14  # rad, half a step of the servo command
    assert measured.rotor_speed is None
    assert any(
        "no /rotor/command" in text and "rotor.drag and battery.sag cannot be identified" in text for text in warnings
    )
    assert any("no /rotor/state" in text for text in warnings)


def test_policy_commands_need_no_fast_gyro(recording: Recording, clean: Measurements, measure: Callable) -> None:
    """With the gyro at 200 Hz blade pitch is off by 4e-4 rad rms, all of it the gyro's noise that nobody logged."""
    imu = recording.topics[IMU]
    slow = corrupt.change(recording, IMU, corrupt.take(imu, np.arange(0, len(imu.time), 5)))
    command = measure(corrupt.remove(slow, COMMAND))[0].command
    np.testing.assert_allclose(command.time, clean.command.time[: len(command.time)], atol=1e-9)
    error = (command.value - clean.command.value[: len(command.time)])[20:]
    assert np.sqrt(np.mean(error**2)) < 5e-4


def test_policy_commands_survive_a_worse_log(recording: Recording, clean: Measurements, measure: Callable) -> None:
    """With gyro spikes, and policy and gyro interrupted in turn, blade pitch stays right where it is given at all."""
    spoilt, _ = corrupt.spike(corrupt.remove(recording, COMMAND), IMU, {"wy": 12.0}, 0.005, np.random.default_rng(2))
    spoilt = corrupt.cut(corrupt.cut(spoilt, POLICY, 2.0, 2.5), IMU, 5.0, 5.5)
    measured, _ = measure(spoilt)
    time, pitch = measured.command.time, measured.command.value
    assert not (((time > 2.05) & (time < 2.5)) | ((time > 5.0) & (time < 5.499))).any()
    logged = np.stack([np.interp(time, clean.command.time, clean.command.value[:, i]) for i in range(2)], axis=1)
    settled = (time > 0.02) & (np.abs(time - 2.0) > 0.1) & (np.abs(time - 5.5) > 0.02)
    assert np.sqrt(np.mean((pitch - logged)[settled] ** 2)) < 2e-4  # rad; hover noise is 1.5e-3
    assert not usable_starts(measured, np.array([1.9, 2.3, 4.9, 5.3]), 0.3).any()


def spoil_all(recording: Recording) -> Recording:
    """Outliers, dropouts, jitter, a gap in poses and one in the IMU, no rotor telemetry."""
    rng = np.random.default_rng(4)
    for topic in (POSE, IMU):
        sizes = {name: size for name, size in SPIKES[topic].items() if size}
        recording, _ = corrupt.spike(recording, topic, sizes, 0.005, rng)
    recording = corrupt.jitter(corrupt.drop(recording, POSE, 0.1, rng), POSE, 0.0003, rng)
    recording = corrupt.cut(corrupt.cut(recording, POSE, 2.0, 2.8), IMU, 5.0, 5.8)
    return corrupt.remove(recording, COMMAND, STATE)


def test_a_twin_scores_alike_on_a_spoilt_log(recording: Recording, clean: Measurements, measure: Callable) -> None:
    """All of it at once changes the twin's chi² by no more than the quarter of the windows that it costs."""
    spoilt, _ = measure(spoil_all(recording))
    scores = []
    for flight in (clean, spoilt):
        starts = list_starts([flight], SPEC.robot.window)
        scores.append(open_held_out(SPEC, [flight], starts, lambda steps: None).score({}).chi2)
    assert scores[1] == pytest.approx(scores[0], rel=0.25)


NO_FORCE = "no accelerometer on /imu/data"
FORCE, ROTORS = ("specific_force",), ("rotor_speed", "current")
UNSOUND: dict[str, tuple[Spoil, tuple[str, ...], tuple[str, ...]]] = {
    "dead IMU": (lambda r, g: hold(r, IMU, "wy", "ax", "az"), ("throughout while the craft turns", "no /imu/data"),
                 ("velocities", *FORCE)),
    "dead gyro": (lambda r, g: hold(r, IMU, "wy"), ("the IMU is left out",), ("velocities", *FORCE)),
    "dead accelerometer": (lambda r, g: hold(r, IMU, "ax", "az"), ("accel_x and accel_z never changes", NO_FORCE),
                           FORCE),
    "one dead axis": (lambda r, g: hold(r, IMU, "az"), ("accel_z never changes", NO_FORCE), FORCE),
    "doubled axis": (lambda r, g: copy_column(r, IMU, "ax", "az"), ("are one and the same", NO_FORCE), FORCE),
    "upside down": (lambda r, g: scale(r, IMU, -1.0, "az"), ("shows -0.99 times gravity upwards", NO_FORCE), FORCE),
    "half of the force": (lambda r, g: scale(r, IMU, 0.5, "ax", "az"), ("shows 0.5 times gravity", NO_FORCE), FORCE),
    "no rotor state": (lambda r, g: scale(r, STATE, 0.0, "speed_1", "speed_2"),
                       ("a rotor speed is 0 times the governed 471", "rotors are taken to turn at"), ROTORS),
    "half of the speed": (lambda r, g: scale(r, STATE, 0.5, "speed_1", "speed_2"), ("0.5 times the governed 471",),
                          ROTORS),
    "turns per second": (lambda r, g: scale(r, STATE, 1 / 6.283, "speed_1"), ("0.16 times the governed",), ROTORS),
    "doubled speed": (lambda r, g: copy_column(r, STATE, "speed_1", "speed_2"),
                      ("both rotor speeds are one and the same",), ROTORS),
    "no currents": (lambda r, g: scale(r, STATE, 0.0, "current_1", "current_2"), ("a motor current never changes",),
                    ("current",)),
    "no throttle": (lambda r, g: scale(r, COMMAND, 0.0, "throttle_1", "throttle_2"), (), ("throttle",)),
    "dead commands": (lambda r, g: hold(r, COMMAND, "blade_pitch_1", "blade_pitch_2"),
                      ("blade pitch never changes", "is reconstructed from"), ("throttle",)),
}  # fmt: skip
"""Channels that cannot be believed, what warnings say, and what of the measurements is left out for it."""


@pytest.mark.parametrize("name", UNSOUND)
def test_channels_that_cannot_be_believed_are_left_out(
    recording: Recording, clean: Measurements, measure: Callable, name: str
) -> None:
    """Dead, doubled, upside down or in another unit: a warning says so, and everything else stays as it was."""
    spoil, said, gone = UNSOUND[name]
    measured, warnings = measure(spoil(recording, np.random.default_rng(1)))
    for part in said:
        assert any(part in line for line in warnings), warnings
    for field in ("velocities", "specific_force", "rotor_speed", "current", "throttle"):
        value = getattr(measured, field)
        assert (value is None or value == {}) == (field in gone)
    assert differ(clean, measured)["x"] < 1e-9


def test_samples_that_are_stuck_or_clipped_are_left_out(
    recording: Recording, clean: Measurements, measure: Callable
) -> None:
    """An IMU that repeats itself for a second, and one whose range a flip exceeds; the other samples stay."""
    measured, warnings = measure(hold(recording, IMU, "wy", "ax", "az", begin=2000, end=3000))
    assert any("1000 of 8001 samples repeat a value to the last digit, left out" in line for line in warnings)
    assert not ((measured.velocities[2].time > 2.0) & (measured.velocities[2].time < 2.999)).any()
    clipped = np.clip(recording.topics[IMU].columns["wy"], -6.0, 6.0)
    measured, warnings = measure(corrupt.edit(recording, IMU, wy=clipped))
    assert any("samples are clipped, left out" in line for line in warnings)
    assert np.abs(measured.velocities[2].value).max() < 6.0
    fast = np.abs(clean.velocities[2].value) > 6.1
    assert len(measured.velocities[2].time) == pytest.approx(len(fast) - fast.sum(), rel=0.01)


def test_clean_channels_stay(recording: Recording, clean: Measurements) -> None:
    """Nothing of a sound flight is left out, whatever it does."""
    assert len(clean.velocities[2].time) == len(recording.topics[IMU].time)
    held = (clean.specific_force, clean.rotor_speed, clean.current, clean.throttle)
    assert all(series is not None for series in held)


REFUSED: dict[str, tuple[Callable[[Recording], Recording], str]] = {
    "NaN": (lambda r: corrupt.put(r, POSE, 300, x=np.nan), "pose.position.x is NaN in 1 of 799 messages"),
    "millimetres": (lambda r: scale(r, POSE, 1e3, "x", "z"), "x reaches [0-9.]+ and looks like millimetres"),
    "g": (lambda r: scale(r, IMU, 1 / 9.81, "ax", "az"), "median is [01].* and looks like multiples of g"),
    "milli-g": (lambda r: scale(r, IMU, 1e3 / 9.81, "ax", "az"), "looks like milli-g"),
    "no gravity": (lambda r: scale(r, IMU, 0.03, "ax", "az"), "looks like acceleration without gravity"),
    "degrees per second": (lambda r: scale(r, IMU, 57.3, "wy"), "degrees per second"),
    "wrong sign": (lambda r: scale(r, IMU, -1.0, "wy"), "rate runs against the turning"),
    "blade pitch in degrees": (lambda r: scale(r, COMMAND, 57.3, "blade_pitch_1"), "looks like degrees"),
    "rpm": (lambda r: scale(r, STATE, 9.55, "speed_1", "speed_2"), "looks like rpm"),
    "another epoch": (lambda r: corrupt.offset(r, POSE, -2.0), "/mocap/pose is stamped 2.01 s earlier than"),
    "a shifted stamp": (lambda r: corrupt.change(r, POSE, replace(r.topics[POSE], time=r.topics[POSE].time + 0.8)),
                        "/mocap/pose shows every turn 0.80 s after /imu/data does"),
    "twice the rate": (lambda r: scale(r, IMU, 2.0, "wy"), r"rate is 2 times the turning .*`scale: 0.5`"),
    "half of the rate": (lambda r: scale(r, IMU, 0.5, "wy"), r"rate is 0.5 times the turning .*`scale: 2`"),
    "feet": (lambda r: scale(r, POSE, 3.2808, "x", "z"), r"3.28 times as far .* feet; .*`scale: 0.3048`"),
    "half metres": (lambda r: scale(r, POSE, 2.0, "x", "z"), r"2 times as far as the accelerometer shows; "),
    "inches": (lambda r: scale(r, POSE, 39.37, "x", "z"), "looks like millimetres, centimetres or inches"),
    "centimetres": (lambda r: scale(r, POSE, 100.0, "x", "z"), "millimetres, centimetres or inches"),
    "inches of little": (lambda r: scale(r, POSE, 20.0, "x", "z"), "times as far as the accelerometer shows"),
    "one axis twice": (lambda r: copy_column(r, POSE, "x", "z"), "x and z are one and the same"),
    "a dead axis": (lambda r: hold(r, POSE, "x"), "x never changes, while the accelerometer shows motion"),
    "a clock set ahead": (lambda r: set_clock(r, POSE, 3.0, 0.3),
                          r"clock of /mocap/pose steps by \+0.30 s .* about 3.0 s into the log"),
    "a clock set back": (lambda r: set_clock(r, POSE, 3.0, -0.3), r"clock of /mocap/pose steps by -0.30 s"),
    "the other clock": (lambda r: set_clock(r, IMU, 5.0, 0.1), r"clock of /imu/data steps by \+0.10 s"),
    "no poses": (lambda r: corrupt.remove(r, POSE), "no messages on /mocap/pose"),
    "no commands": (lambda r: corrupt.remove(r, COMMAND, POLICY), "no messages on /rotor/command"),
    "no gyro, no commands": (lambda r: corrupt.remove(r, COMMAND, IMU), "/imu/data to reconstruct it from"),
}  # fmt: skip
"""Logs from which nothing right could be read, and the line that says so."""


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_mended_is_refused(recording: Recording, measure: Callable, name: str) -> None:
    """Units, clocks and topics that are wrong throughout are named in one line, with what to do."""
    spoil, found = REFUSED[name]
    with pytest.raises(InputError, match=found) as caught:
        measure(spoil(recording))
    assert "\n" not in str(caught.value)
    assert caught.value.action


def test_a_drift_between_clocks_is_measured_not_corrected(recording: Recording, measure: Callable) -> None:
    """A tracker clock that gains 1 ms/s is a suspect of the diagnosis: it shows in lag and clocks alone."""
    measured, warnings = measure(corrupt.offset(recording, POSE, 0.0, drift=1e-3))
    assert not any("clock" in text for text in warnings)
    pose = recording.topics[POSE]
    np.testing.assert_allclose(measured.positions[0].time, pose.time * 1.001, atol=1e-8)
    clocks = measured.clocks
    assert clocks[POSE].drift - clocks[IMU].drift == pytest.approx(1e-3, abs=1e-4)  # transport jitters by 0.4 ms
    assert clocks[POSE].latency == pytest.approx(0.008 - 0.004, abs=5e-4)
