"""`vpptwin inspect` on what turns: order and sense of quaternions, frames of rates, what holds a body, degrees."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from proving.quadrotor import MJCF, fly
from vpptwin.estimation.checks.orientation import QUATERNIONS, Convention
from vpptwin.estimation.measurements import read_measurements
from vpptwin.estimation.series import interpolate
from vpptwin.logs.read import read_flight
from vpptwin.mapping.guess import Guess
from vpptwin.mapping.inspect import inspect_logs
from vpptwin.system.errors import InputError
from vpptwin.twin import load_twin
from vpptwin.twin.robot.manifold import turn_to_world

FLOWN = fly({}, 10.0, 3)
POSE, IMU = FLOWN.spatial["/pose"], FLOWN.spatial["/imu"]
RATE = interpolate(POSE.time, IMU.time, IMU["rate"])
MOTORS = {name: stream["effort"][::5] for name, stream in FLOWN.joints["/motors"].items()}


def look(
    folder: Path,
    turned: Mapping[str, np.ndarray],
    rates: Mapping[str, np.ndarray],
    site: bool = True,
    motors: bool = True,
) -> dict[str, Guess]:
    """What inspect makes of a table, by the name of the target; its twin lies beside."""
    columns = {"time": POSE.time, **dict(zip(("quad_x", "quad_y", "quad_z"), POSE["position"].T)), **turned, **rates}
    columns |= MOTORS if motors else {}
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / "log.csv", table, delimiter=",", header=",".join(columns), comments="")
    (folder / "quad.xml").write_text(MJCF if site else MJCF.replace('<site name="imu"/>', ""))
    (folder / "twin.yaml").unlink(missing_ok=True)
    guesses = inspect_logs([folder / "log.csv"], str(folder / "quad.xml"), folder / "twin.yaml")
    return {guess.target: guess for guess in guesses}


def check_twin(folder: Path) -> None:
    """The twin that was written reads attitudes and rates as they were."""
    spec = load_twin(folder / "twin.yaml")
    read = read_measurements(spec, read_flight(folder / "log.csv", signals=spec.robot.signals.entries))
    assert np.abs((read.attitudes[3].value * POSE["attitude"]).sum(axis=1)).min() > 1.0 - 1e-9
    for dof in (3, 4, 5):
        assert np.sqrt(np.mean((read.velocities[dof].value - RATE[:, dof - 3]) ** 2)) < 0.03


def name_numbers(values: np.ndarray, *names: str) -> dict[str, np.ndarray]:
    """Columns."""
    return dict(zip(names, values.T, strict=True))


@pytest.mark.parametrize("reading", [QUATERNIONS[i] for i in (0, 2, 3)], ids=["last", "back", "first"])
def test_names_that_contradict_the_gyro_are_asked_about(tmp_path: Path, reading: Convention) -> None:
    """The twin has the order and sense in which it turns as the gyro, and says so in a doubt."""
    logged = np.empty_like(POSE["attitude"])
    logged[:, reading.order] = POSE["attitude"] * reading.signs
    gyro = name_numbers(RATE, "gyro_x", "gyro_y", "gyro_z")
    found = look(tmp_path, name_numbers(logged, "quad_qw", "quad_qx", "quad_qy", "quad_qz"), gyro)
    assert not found["quad"].sure
    assert any("as its rates turn (100% of the turning" in doubt for doubt in found["quad"].doubts)
    check_twin(tmp_path)


@pytest.mark.parametrize("site", [True, False])
@pytest.mark.parametrize("names", [("wx_vicon", "wy_vicon", "wz_vicon"), ("gyro_x", "gyro_y", "gyro_z")])
def test_rates_about_the_worlds_axes_are_mapped(tmp_path: Path, site: bool, names: tuple[str, ...]) -> None:
    """Of an IMU, or of the body where the model has none."""
    rates = name_numbers(turn_to_world(POSE["attitude"], RATE), *names)
    found = look(tmp_path, name_numbers(POSE["attitude"], "quad_qw", "quad_qx", "quad_qy", "quad_qz"), rates, site)
    told = found["imu" if site else "quad"]
    assert told.sure
    assert told.more["rate"] == {"frame": "world"}
    assert any("about the world's axes" in reason for reason in told.reasons)
    check_twin(tmp_path)


def test_right_logs_are_not_asked_about(tmp_path: Path) -> None:
    """Attitude and rates as they should be, whichever way the gyro is mounted."""
    turned = RATE @ np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    for rate in (RATE, turned):
        gyro = name_numbers(rate, "gyro_x", "gyro_y", "gyro_z")
        found = look(tmp_path, name_numbers(POSE["attitude"], "quad_qw", "quad_qx", "quad_qy", "quad_qz"), gyro)
        assert found["quad"].sure, found["quad"].doubts
        assert not found["quad"].more
        assert not found["imu"].more


def test_what_holds_it_is_told(tmp_path: Path) -> None:
    """Without a column of a motor: that its commands are not there, beside what its signals are."""
    turned = name_numbers(POSE["attitude"], "quad_qw", "quad_qx", "quad_qy", "quad_qz")
    gyro = name_numbers(RATE, "gyro_x", "gyro_y", "gyro_z")
    (line,) = [text for text in look(tmp_path, turned, gyro, motors=False)["quad"].reasons if "does not fall" in text]
    assert "no commands of what drives it are mapped" in line
    assert not [text for text in look(tmp_path, turned, gyro)["quad"].reasons if "does not fall" in text]


def test_latitude_is_no_metre(tmp_path: Path) -> None:
    """Inspect says that it is degrees, and a twin that takes it for a position is refused."""
    turned = name_numbers(POSE["attitude"], "qw", "qx", "qy", "qz")
    place = {"Lat": 47.4 + 1e-5 * POSE["position"][:, 0], "Lng": 8.5 + 1e-5 * POSE["position"][:, 1]}
    columns = {"time": POSE.time, **turned, **place, "Alt": 400.0 + POSE["position"][:, 2]}
    np.savetxt(tmp_path / "log.csv", np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns),
               comments="")  # fmt: skip
    (tmp_path / "quad.xml").write_text(MJCF)
    (quad,) = [g for g in inspect_logs([tmp_path / "log.csv"], str(tmp_path / "quad.xml"), tmp_path / "t.yaml")
               if g.target == "quad"]  # fmt: skip
    assert any("Lat and Lng are degrees on the globe" in doubt for doubt in quad.doubts)
    entry = "{topic: log, position: %s, attitude: [qw, qx, qy, qz]}"
    for position, refused in (("[Lat, Lng, Alt]", True), ("{path: [Lng, Lat, Alt], scale: [75000, 111000, 1]}", False)):
        text = f"model: quad.xml\nsignals: {{bodies: {{quad: {entry % position}}}}}\n"
        (tmp_path / "t.yaml").write_text(text)
        spec = load_twin(tmp_path / "t.yaml")
        if refused:
            with pytest.raises(InputError, match="degrees on the globe; expected x, y, z in metres"):
                read_flight(tmp_path / "log.csv", signals=spec.robot.signals.entries)
        else:
            assert read_flight(tmp_path / "log.csv", signals=spec.robot.signals.entries).spatial
