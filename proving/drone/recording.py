"""What a flight leaves: the topics of docs/logs.md as arrays, the truth beside them, and the MCAP file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from proving.logs import Channel, write_channels
from proving.messages import encode

from .manoeuvres import PERIOD
from .rotor import STEP
from .sensors import MOCAP_PERIOD

if TYPE_CHECKING:
    from .flight import Batch

EPOCH_NS = 1_760_000_000_000_000_000  # first stamp of the flight with seed 0; a later seed flew later


@dataclass(frozen=True)
class Topic:
    """Messages of one topic."""

    kind: str  # Message type
    frame: str  # frame_id
    time: np.ndarray  # header.stamp, s since the start of the log. (n,)
    latency: np.ndarray  # From stamp to record, s. (n,)
    columns: dict[str, np.ndarray]  # Varying fields as the message has them, SI. (n,) each


@dataclass
class Recording:
    """One flight.

    Attributes:
        effects: Hidden effects.
        manoeuvre: Name.
        seed: Of everything random.
        session: Of the rig's tolerances; None for a rig without.
        start_ns: Time 0 of the log, ns since 1970.
        topics: What goes into the log.
        truth: Never in the log, at 1 kHz: time s; position (n, 3) x, z, theta; velocity; acceleration;
            blade_pitch rad, rotor_speed rad/s, thrust N (n, 2); gust N, N, N m (n, 3).
        imu_std: Noise of gyro rad/s and accelerometer m/s^2.
    """

    effects: dict[str, dict[str, float]]
    manoeuvre: str
    seed: int
    session: int | None
    start_ns: int
    topics: dict[str, Topic]
    truth: dict[str, np.ndarray]
    imu_std: tuple[float, float] = field(default=(0.0, 0.0))

    @classmethod
    def from_batch(cls, batch: Batch, row: int) -> Recording:
        """Cut one flight out of a batch that has flown."""
        flight, lead = batch.flights[row], batch.lead
        imu = batch.rig.nominal["sensors"]["imu"]
        session = flight["seed"] if flight["session"] is None else flight["session"]
        count = batch.steps + 1 - lead
        truth = {
            "position": batch.position,
            "velocity": batch.velocity,
            "acceleration": batch.accel,
            "blade_pitch": batch.blade,
            "rotor_speed": batch.speed,
            "thrust": batch.thrust,
            "gust": batch.chances.gust[: batch.steps + 1],
        }
        return cls(
            effects={effect: dict(values) for effect, values in flight["effects"].items()},
            manoeuvre=flight["manoeuvre"],
            seed=flight["seed"],
            session=session if flight["jitter"] else None,
            start_ns=EPOCH_NS + flight["seed"] % 10**6 * 60 * 10**9,
            topics=_gather_topics(batch, row),
            truth={"time": np.arange(count) * STEP} | {k: v[lead:, :, row].copy() for k, v in truth.items()},
            imu_std=(imu["gyro_std"], imu["accel_std"]),
        )


def _gather_topics(batch: Batch, row: int) -> dict[str, Topic]:
    """Sort what the sensors read and the loops commanded into topics."""
    lead, steps = batch.lead, batch.steps
    rng = np.random.default_rng([batch.flights[row]["seed"], 5])
    fast = np.arange(lead, steps + 1)
    ticks = np.arange(lead // MOCAP_PERIOD, steps // MOCAP_PERIOD + 1)

    def delay(base: float, count: int) -> np.ndarray:
        """Transport to the recorder: some, in steps of 0.1 ms."""
        return base + 1e-4 * rng.integers(0, 4, count)

    def pair(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
        return {f"{name}_{side + 1}": values[lead:, side, row] for side in range(2)}

    time, slow = (fast - lead) * STEP, (ticks * MOCAP_PERIOD - lead) * STEP
    specific = batch.specific[lead:, :, row]
    imu = {"wy": -batch.gyro[lead:, row], "ax": specific[:, 0], "az": specific[:, 1]}
    command = pair("blade_pitch", batch.pitch_command) | pair("throttle", batch.throttle)
    state = pair("speed", batch.speed_read) | pair("current", batch.read_currents()[:, :, :])
    policy = {"thrust": batch.policy[ticks, 0, row], "rate": batch.policy[ticks, 1, row]}

    frames = np.arange(len(batch.frames))
    stamps = frames * MOCAP_PERIOD + batch.chances.phase[row]
    kept = batch.chances.seen[frames, row] & (stamps >= lead) & (frames <= batch.newest[row])
    seen_at = (stamps[kept] - lead) * STEP + batch.chances.jitter[frames[kept], row]
    pose = batch.frames[frames[kept], :, row] + batch.chances.wild[frames[kept], :, row]
    late = np.maximum(0.008 + 4e-4 * np.round(rng.standard_normal(kept.sum()), 1), 0.006)
    late = late - batch.drift[row] * seen_at  # the stamp is the mocap clock's, the record the onboard clock's

    plan = batch.pilot.setpoint[: len(ticks), :, row]
    changed = np.append(True, (np.diff(plan, axis=0) != 0).any(1))
    second = np.arange(0, len(fast), 1000)
    supply = np.array([batch.motor.compute_supply(t)[row] for t in time[second]])
    fast_count, tick_count = len(fast), len(ticks)
    return {
        "/mocap/pose": Topic("geometry_msgs/msg/PoseStamped", "world", seen_at, late, _stamp_pose(pose)),
        "/imu/data": Topic("sensor_msgs/msg/Imu", "imu", time, delay(0.0012, fast_count), imu),
        "/cmd/rate_thrust": Topic("vpptwin_msgs/msg/RateThrust", "craft", slow, delay(0.0007, tick_count), policy),
        "/rotor/command": Topic("vpptwin_msgs/msg/RotorCommand", "craft", time, delay(0.0014, fast_count), command),
        "/rotor/state": Topic("vpptwin_msgs/msg/RotorState", "craft", time, delay(0.0014, fast_count), state),
        "/setpoint/pose": Topic(
            "geometry_msgs/msg/PoseStamped",
            "world",
            np.arange(len(ticks))[changed] * PERIOD,
            delay(0.0007, changed.sum()),
            _stamp_pose(plan[changed]),
        ),
        "/battery": Topic(
            "sensor_msgs/msg/BatteryState",
            "craft",
            time[second],
            delay(0.002, len(second)),
            {"voltage": np.round(supply, 2)},
        ),
    }


def _stamp_pose(pose: np.ndarray) -> dict[str, np.ndarray]:
    """Pose (n, 3) as position and the quaternion of a rotation by theta about -y."""
    half = 0.5 * pose[:, 2]
    return {"x": pose[:, 0], "z": pose[:, 1], "qy": -np.sin(half), "qw": np.cos(half)}


def write_mcap(recording: Recording, path: str | Path) -> Path:
    """Write a log: MCAP, `ros2` profile, zstd, definitions embedded, messages in the order they were recorded."""
    channels = []
    for name, topic in recording.topics.items():
        stamps = recording.start_ns + np.rint(topic.time * 1e9).astype(np.int64)
        logged = stamps + np.rint(topic.latency * 1e9).astype(np.int64)
        encoded = encode(topic.kind, topic.frame, stamps, topic.columns, recording.imu_std)
        channels.append(Channel(name, topic.kind, stamps, logged, encoded))
    return write_channels(Path(path), channels, "vpptwin proving.drone")
