"""What twins predict, as MCAP beside the log: decoded by mcap_ros2, it lies on the log and adds up to it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from tests.builders import load_rig
from tests.diagnosis.rigs import CARTS, record
from tests.estimation.synthetic import draw_commands, fly_own
from vpptwin.logs import Stream, read_flight, write_flight
from vpptwin.logs.flight import Flight
from vpptwin.report.export import name_files, write_prediction
from vpptwin.report.prediction import FlightPrediction, PredictedSeries, predict_flight
from vpptwin.report.rerun import write_rrd
from vpptwin.system.files import is_own
from vpptwin.twin.spec import TwinSpec, load_twin

FLIP = Path(__file__).resolve().parents[3] / "demo/flights/flip.mcap"
FRICTION = {"rail_x.coulomb": {"force": 0.3}}


def decode(path: Path, topics: list[str] | None = None) -> dict[str, dict[int, object]]:
    """Topic → stamp [ns] → message, by the reference reader; all topics, or some."""
    found: dict[str, dict[int, object]] = defaultdict(dict)
    with path.open("rb") as file:
        for entry in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics):
            stamp = entry.decoded_message.header.stamp
            found[entry.channel.topic][stamp.sec * 10**9 + stamp.nanosec] = entry.decoded_message
    return found


@pytest.fixture(scope="module")
def log() -> dict[str, dict[int, object]]:
    """The demo flight itself, decoded."""
    return decode(FLIP, ["/mocap/pose", "/imu/data"])


@pytest.fixture(scope="module")
def flip(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[int, object]]:
    """Nominal twin and one with friction beside a demo flight, decoded."""
    path = tmp_path_factory.mktemp("export") / "prediction.mcap"
    twins = [load_twin(), load_twin().with_effects(FRICTION)]
    write_prediction(path, twins[0], predict_flight(twins, read_flight(FLIP)))
    return decode(path)


def test_every_topic_of_the_log_has_its_shadow(flip: Mapping) -> None:
    """Pose and gyro in the log's own form, as measured and of both twins, and a residual of each quantity."""
    own = ("mocap/pose", "imu/data", "residual/x", "residual/z", "residual/theta", "residual/theta_rate")
    shadows = {f"/twin/{twin}/{name}" for twin in ("before", "after") for name in own}
    assert set(flip) == {"/measured/mocap/pose", "/measured/imu/data", *shadows}


@pytest.mark.parametrize("twin", ["before", "after"])
def test_prediction_and_residual_add_up_to_the_log(flip: Mapping, log: Mapping, twin: str) -> None:
    """At the log's very stamps, to rounding; at most the first 0.2 s and the last restart are missing."""
    poses, imu = flip[f"/twin/{twin}/mocap/pose"], flip[f"/twin/{twin}/imu/data"]
    assert set(poses) <= set(log["/mocap/pose"])
    assert set(imu) <= set(log["/imu/data"])
    assert len(poses) > len(log["/mocap/pose"]) - 80
    for axis in ("x", "z"):
        for stamp, residual in flip[f"/twin/{twin}/residual/{axis}"].items():
            total = getattr(poses[stamp].pose.position, axis) + residual.position[0]
            assert residual.name == [axis]
            assert total == pytest.approx(getattr(log["/mocap/pose"][stamp].pose.position, axis), abs=1e-12)
    for stamp, residual in flip[f"/twin/{twin}/residual/theta_rate"].items():
        # Imu turns about +y, θ about -y.
        total = imu[stamp].angular_velocity.y - residual.velocity[0]
        assert total == pytest.approx(log["/imu/data"][stamp].angular_velocity.y, abs=1e-12)
    for stamp, residual in flip[f"/twin/{twin}/residual/theta"].items():
        turns = [
            2.0 * np.arctan2(-q.y, q.w)
            for q in (poses[stamp].pose.orientation, log["/mocap/pose"][stamp].pose.orientation)
        ]
        assert np.sin(0.5 * (turns[0] + residual.position[0] - turns[1])) == pytest.approx(0.0, abs=1e-12)


def test_the_right_friction_leaves_less(flip: Mapping) -> None:
    """The demo's rig hides 0.30 N: with it the residual along x is less than two thirds."""
    rms = [
        np.sqrt(np.mean([m.position[0] ** 2 for m in flip[f"/twin/{t}/residual/x"].values()]))
        for t in ("before", "after")
    ]
    assert rms[1] < 0.67 * rms[0]


SPEC = load_twin()
COMMANDS = draw_commands(1750, seed=2, quiet=200)
BOUNDS = {"m": 4.1e-4, "rad": 1e-3, "rad/s": 2.5e-3}  # of tests/estimation/test_replay.py, which says where from


@pytest.mark.parametrize("effects", [{}, FRICTION])
def test_its_own_flight_leaves_no_residual(effects: dict) -> None:
    """A twin that is right predicts its own noise-free log within what its estimated starting states leave."""
    spec = SPEC.with_effects(effects)
    prediction = predict_flight([spec], fly_own(spec, COMMANDS).flight)
    for track in prediction.tracks:
        known = np.isfinite(track.predicted[0])
        assert known.mean() > 0.8
        # Rates at a restart are less exact where friction makes the motion kink.
        assert np.abs(track.residual[0][known]).max() < (10.0 if effects else 1.0) * BOUNDS[track.unit]


ERRORS = {"gyro.bias": {"bias": 0.1}, "mocap.misalignment": {"angle": 0.05}, "mocap.scale": {"scale": 1.02}}


@pytest.mark.parametrize("effect", ERRORS)
def test_a_sensor_with_an_error_is_read_with_it(effect: str) -> None:
    """A log seen through a sensor that errs leaves no residual in a twin whose sensor errs as much."""
    flight = fly_own(SPEC, COMMANDS).flight
    pose, imu = (flight.streams[topic] for topic in ("/mocap/pose", "/imu/data"))
    shown = {
        "gyro.bias": Stream(imu.time, {**imu.values, "rate": imu["rate"] + 0.1}),
        "mocap.misalignment": Stream(pose.time, {**pose.values, "theta": pose["theta"] + 0.05}),
        "mocap.scale": Stream(pose.time, {**pose.values, "x": 1.02 * pose["x"], "z": 1.02 * pose["z"]}),
    }[effect]
    streams = {**flight.streams, "/imu/data" if effect == "gyro.bias" else "/mocap/pose": shown}
    spec = SPEC.with_effects({effect: ERRORS[effect]})
    for track in predict_flight([spec], Flight(flight.path, flight.start_ns, streams, {})).tracks:
        assert np.nanmax(np.abs(track.residual[0])) < BOUNDS[track.unit]


def record_cart(folder: Path) -> tuple[Flight, TwinSpec]:
    """A cart that is not ours: its log and its twin."""
    log, twin = record(CARTS, 1.1, folder, seed=3)
    return read_flight(log), load_twin(twin)


def test_other_rigs_have_joint_states(tmp_path: Path) -> None:
    """Position and velocity of the joint under the twin's namespace; one twin alone is `before`."""
    flight, spec = record_cart(tmp_path)
    write_prediction(tmp_path / "p.mcap", spec, predict_flight([spec], flight), {"twin": spec.name})
    found, log = decode(tmp_path / "p.mcap"), decode(flight.path)["/joint_states"]
    assert set(found) == {
        "/measured/joint_states",
        "/twin/before/joint_states",
        "/twin/before/residual/slide",
        "/twin/before/residual/slide_rate",
    }
    for stamp, message in found["/twin/before/joint_states"].items():
        assert message.name == ["slide"]
        residual = found["/twin/before/residual/slide"][stamp]
        assert message.position[0] + residual.position[0] == pytest.approx(log[stamp].position[0], abs=1e-12)


def spoil(stream: Stream, how: str) -> Stream:
    """A cart's log with spikes in its velocity, a velocity that runs behind, or rows lost."""
    time, position, velocity = stream.time, stream["position"].copy(), stream["velocity"].copy()
    if how == "spikes":
        velocity[[300, 701, 1500]] += 3.0
    elif how == "late":
        velocity = np.interp(time - 0.06, time, velocity)
    else:
        kept = np.random.default_rng(0).random(len(time)) > 0.05
        time, position, velocity = time[kept], position[kept], velocity[kept]
    return Stream(time, {"position": position, "velocity": velocity})


@pytest.mark.parametrize("how", ["spikes", "late", "lost"])
def test_what_a_message_lacks_is_not_in_its_shadow(tmp_path: Path, how: str) -> None:
    """Position and velocity of one joint, of different length or moved in time: at the log's stamps, as predicted."""
    flight, spec = record_cart(tmp_path)
    stream = spoil(flight.joints["/joint_states"]["slide"], how)
    flight = replace(flight, joints={**flight.joints, "/joint_states": {"slide": stream}})
    prediction = predict_flight([spec], flight)
    write_prediction(tmp_path / "p.mcap", spec, prediction)
    messages = decode(tmp_path / "p.mcap")["/twin/before/joint_states"]
    stamps = {stamp - flight.start_ns for stamp in messages}
    assert stamps <= {round(time * 1e9) for time in stream.time}
    assert sum(len(m.position) == len(m.velocity) == 1 for m in messages.values()) > 0.97 * len(messages)
    for track in prediction.tracks:
        told = {s - flight.start_ns: getattr(m, track.kind) for s, m in messages.items() if getattr(m, track.kind)}
        row = np.searchsorted(track.stamp, sorted(told))
        assert len(told) > 0.9 * 100.0 * (stream.time[-1] - stream.time[0])
        np.testing.assert_array_equal(np.concatenate([told[s] for s in sorted(told)]), track.predicted[0, row])


TWO = """<mujoco><worldbody><body><joint name="a"/><geom size="0.1"/></body>
<body pos="1 0 0"><joint name="b"/><geom size="0.1"/></body></worldbody></mujoco>"""
"""Two hinges, of one topic or of two."""


@pytest.mark.parametrize("topics", [("/states", "/states"), ("/left", "/right")])
def test_joints_that_are_not_in_every_message_lie_beside_those_that_are(
    tmp_path: Path, topics: tuple[str, str]
) -> None:
    """Joint b is in every second message, its velocity never; a NaN and other rates part nothing else."""
    spec, time = load_rig(TWO, f"{{joints: {{a: {topics[0]}, b: {topics[1]}}}}}"), 0.02 * np.arange(50)
    given = (("a", "position", 0, time), ("a rate", "velocity", 0, time), ("b", "position", 1, time[::2]))
    tracks = [PredictedSeries(n, "rad", kind, dof, t, t, 1e-3, np.array([dof + t])) for n, kind, dof, t in given]
    tracks[1].predicted[0, 7] = np.nan
    flight = Flight(tmp_path / "none.mcap", 0, {}, {})
    write_prediction(tmp_path / "p.mcap", spec, FlightPrediction(flight, tracks, np.zeros(1)))
    held: dict[tuple[str, str], set[int]] = defaultdict(set)
    with (tmp_path / "p.mcap").open("rb") as file:
        for entry in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            if entry.channel.topic.startswith("/twin/before/") and "residual" not in entry.channel.topic:
                message, stamp = entry.decoded_message, entry.message.publish_time
                for index, name in enumerate(message.name):
                    assert message.position == [] or message.position[index] == pytest.approx(
                        (name == "b") + stamp / 1e9
                    )
                    held[name, entry.channel.topic] |= {round(stamp / 2e7)}
                    held[f"{name} rate", entry.channel.topic] |= {round(stamp / 2e7)} if message.velocity else set()
    left, right = (f"/twin/before{topic}" for topic in topics)
    assert held["a", left] == set(range(50))
    assert held["a rate", left] == set(range(50)) - {7}
    assert held["b", right] == set(range(0, 50, 2))


def test_a_log_recorded_on_another_clock_is_met_there(tmp_path: Path) -> None:
    """Stamps of simulated time, recorded an hour later by the wall: predictions carry both times of the log."""
    flight = read_flight(FLIP)
    write_flight(tmp_path / "log.mcap", {t: flight.streams[t] for t in ("/mocap/pose", "/rotor/command")}, start_ns=0)
    shifted = tmp_path / "shifted.mcap"
    shift_log_times(tmp_path / "log.mcap", shifted, 3600 * 10**9)
    write_prediction(tmp_path / "p.mcap", SPEC, predict_flight([SPEC], read_flight(shifted)))
    with (tmp_path / "p.mcap").open("rb") as file:
        for _, _, message in make_reader(file).iter_messages():
            assert message.log_time - message.publish_time == pytest.approx(3600 * 10**9, abs=10)


def shift_log_times(source: Path, target: Path, by: int) -> None:
    """Copy a log with all recording times later [ns]."""
    from mcap.writer import Writer

    with source.open("rb") as file, target.open("wb") as into:
        writer = Writer(into)
        writer.start(profile="ros2")
        ids: dict[int, int] = {}
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.id not in ids:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(ids[channel.id], message.log_time + by, message.data, message.publish_time)
        writer.finish()


def test_files_are_named_after_logs() -> None:
    """One log needs no name; several have theirs, and logs of one name in two folders stay apart."""
    assert name_files([Path("a/steps.mcap")]) == ["prediction.mcap"]
    names = name_files([Path("a/steps.mcap"), Path("b/steps.mcap"), Path("mixed.mcap")])
    assert names == ["prediction_steps.mcap", "prediction_steps_2.mcap", "prediction_mixed.mcap"]


def test_rerun_shows_both_twins_over_the_untouched_recording(tmp_path: Path) -> None:
    """Bit by bit what was recorded, what MCAP has of the twins, on the log's clock."""
    chunks = pytest.importorskip("rerun.chunk")
    flight, twins = read_flight(FLIP), [load_twin(), load_twin().with_effects(FRICTION)]
    prediction = predict_flight(twins, flight)
    write_rrd(tmp_path / "prediction.rrd", prediction)
    assert is_own(tmp_path / "prediction.rrd")
    held: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for chunk in chunks.RrdReader(tmp_path / "prediction.rrd").stream().to_chunks():
        batch = chunk.to_record_batch()
        scalars = next((name for name in batch.schema.names if name.endswith("Scalars:scalars")), None)
        if scalars is not None:
            stamps = batch.column("stamp").to_numpy(zero_copy_only=False).astype(np.int64)
            held[chunk.entity_path] = stamps, batch.column(scalars).flatten().to_numpy()
    pose = flight.streams["/mocap/pose"]
    stamps, values = held["/recording/mocap/pose/x"]
    np.testing.assert_array_equal(values, pose["x"])
    np.testing.assert_array_equal(stamps, flight.start_ns + np.rint(pose.time * 1e9).astype(np.int64))
    track = prediction.tracks[0]
    for twin, predicted in zip(("before", "after"), track.predicted):
        np.testing.assert_array_equal(held[f"/x/{twin}"][1], predicted[np.isfinite(predicted)])
    assert np.abs(held["/x/residual/after"][1]).mean() > 0.0
