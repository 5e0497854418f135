"""What tables are called: never as what is ours, and a twin reads the only table of a log whatever that is called."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy.io import savemat

from benchmarks.guesses import write_model
from tests.logs.bags import EPOCH, JOINTS, Bag, refuse, stamp_header
from tests.logs.test_foreign import write_dataflash
from vpptwin.cli.main import main
from vpptwin.logs import Flight, read_flight
from vpptwin.logs.channels import CHANNELS, JOINT_TOPICS
from vpptwin.logs.spelling import list_flights
from vpptwin.logs.transcribe import transcribe
from vpptwin.mapping.inspect import inspect_logs
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError
from vpptwin.twin import load_twin

TIME = np.arange(0.0, 8.0, 0.01)
SWING, RATE = 0.8 * np.sin(2.0 * TIME), 1.6 * np.cos(2.0 * TIME)
COLUMNS = {"time": TIME, "arm_pos": SWING, "arm_vel": RATE, "arm_torque_cmd": np.sign(RATE)}


def write_table(path: Path) -> Path:
    """A run of an arm with a motor, by the ending of the file."""
    if path.suffix == ".csv":
        np.savetxt(path, np.column_stack(list(COLUMNS.values())), delimiter=",", header=",".join(COLUMNS), comments="")
    elif path.suffix == ".parquet":
        parquet.write_table(pa.table(COLUMNS), path)
    elif path.suffix == ".mat":
        savemat(path, COLUMNS)
    else:
        np.savez(path, **COLUMNS)
    return path


def inspect_arm(log: Path) -> Path:
    """The twin that `inspect` writes of the arm's run."""
    twin = log.parent / "arm_twin.yaml"
    inspect_logs([log], str(write_model(log.parent / "arm.xml", {"arm": None}, "motor")), twin)
    return twin


def read_arm(log: Path | str, twin: Path) -> Flight:
    """A log as the twin reads it."""
    return read_flight(log, None, load_twin(twin).robot.signals.entries)


@pytest.mark.parametrize(("name", "kind"), [
    ("run_1", "csv"), ("joint_states", "csv"), ("actuator_command", "csv"), ("battery", "csv"),
    ("run_1", "npz"), ("joint_states", "parquet"), ("joint_states", "mat"),
])  # fmt: skip
def test_one_twin_reads_every_form_of_a_run(tmp_path: Path, name: str, kind: str) -> None:
    """The file, a second one, what is converted of it or of a stretch of it, whatever each of them is called."""
    log = write_table(tmp_path / f"{name}.{kind}")
    twin = inspect_arm(log)
    other = write_table(tmp_path / f"joint_states_of_today.{kind}")
    forms = {"the same": log, "another": other}
    for title, source in (("converted", str(log)), ("cut", f"{other}@2-6"), ("ours", str(write_table(
            tmp_path / f"{'battery' if name == 'joint_states' else 'joint_states'}.{kind}")))):  # fmt: skip
        forms[title] = tmp_path / f"{title}.mcap"
        transcribe(source, forms[title])
    for title, form in forms.items():
        flight = read_arm(form, twin)
        stream, drive = flight.joints["/joint_states"]["arm"], flight.joints["/actuator_command"]["arm"]
        rows = slice(200, 600) if title == "cut" else slice(None)
        np.testing.assert_allclose(stream["position"], SWING[rows], atol=1e-9, err_msg=title)
        np.testing.assert_allclose(drive["effort"], np.sign(RATE[rows]), err_msg=title)
        assert not flight.streams


def test_a_twin_of_what_was_converted_reads_the_rest(tmp_path: Path) -> None:
    """`inspect` of a cut in MCAP, then the file that it was cut out of, and another cut."""
    log = write_table(tmp_path / "joint_states.csv")
    for title, stretch in (("a", "@0-3"), ("b", "@3-6")):
        transcribe(f"{log}{stretch}", tmp_path / f"{title}.mcap")
    twin = inspect_arm(tmp_path / "a.mcap")
    (tmp_path / "runs").mkdir()
    transcribe(write_table(tmp_path / "monday.npz"), tmp_path / "runs/c.mcap")
    counts = [len(read_arm(each, twin).joints["/joint_states"]["arm"]) for each in
              (log, tmp_path / "b.mcap", tmp_path / "runs", f"{tmp_path}/b.mcap@1-2")]  # fmt: skip
    assert counts == [800, 300, 800, 100]


@pytest.mark.parametrize("topic", [*(t for t in CHANNELS if t.count("/") == 1), *JOINT_TOPICS])
def test_a_table_stands_beside_our_topics(tmp_path: Path, topic: str) -> None:
    """Joints of a CSV called as one of ours, the command of an MCAP that has that topic too."""
    log = write_table(tmp_path / f"{topic[1:]}.csv")
    messages = [{"header": stamp_header(EPOCH + int(1e9 * t)), "name": ["arm"], "position": [], "velocity": [],
                 "effort": [u]} for t, u in zip(TIME, RATE)]  # fmt: skip
    bag = Bag(tmp_path / "drive.mcap").add("/actuator_command", JOINTS, messages)
    bag.add("/joint_states", JOINTS, messages[:3]).write()
    twin = inspect_arm(log)
    lines = twin.read_text().splitlines()
    twin.write_text("\n".join(line if "effort" not in line else "    arm: /actuator_command" for line in lines))
    np.savetxt(log, np.column_stack([EPOCH / 1e9 + TIME, SWING]), delimiter=",", header="time,arm_pos", comments="")
    twin.write_text(twin.read_text().replace(", velocity: arm_vel", ""))
    joints = read_arm(f"{log}+{tmp_path}/drive.mcap", twin).joints
    np.testing.assert_allclose(joints["/joint_states"]["arm"]["position"], SWING, atol=1e-9)
    np.testing.assert_allclose(joints["/actuator_command"]["arm"]["effort"], RATE)


def test_names_of_files_may_be_in_capitals(tmp_path: Path) -> None:
    """As ArduPilot's `00000001.BIN` are: of every kind, in a folder, and of what is written."""
    write_table(tmp_path / "log.csv").rename(tmp_path / "LOG.CSV")
    for kind in ("npz", "parquet", "mat"):
        write_table(tmp_path / f"log.{kind}").rename(tmp_path / f"LOG.{kind.upper()}")
    write_dataflash(tmp_path / "LOG.BIN")
    transcribe(tmp_path / "LOG.CSV", tmp_path / "OUT.MCAP")
    logs = list_flights(tmp_path)
    assert {log.suffix for log in logs} == {".CSV", ".NPZ", ".PARQUET", ".MAT", ".BIN", ".MCAP"}
    assert all(survey(log)[1] for log in logs)


@pytest.mark.parametrize("every", [1, 3])
def test_of_two_publishers_the_first_of_one_stamp_is_believed(tmp_path: Path, every: int) -> None:
    """A second one that publishes zeros at stamps of the first changes nothing, and is counted."""

    def add(bag: Bag, moved: np.ndarray, step: int = 1) -> None:
        rows = [{"header": stamp_header(EPOCH + round(1e9 * t)), "name": ["arm"], "position": [q], "velocity": [],
                 "effort": []} for t, q in zip(TIME[::step], moved[::step])]  # fmt: skip
        bag.add("/joint_states", JOINTS, rows)

    bag = Bag(tmp_path / "log.mcap")
    add(bag, SWING)
    add(bag, 0.0 * SWING, every)
    bag.entries.sort(key=lambda entry: entry[3])
    flight = read_flight(bag.write())
    np.testing.assert_allclose(flight.joints["/joint_states"]["arm"]["position"], SWING)
    count = len(TIME[::every])
    assert flight.warnings == (f"{count} of {len(TIME) + count} messages on /joint_states arm repeat a stamp, dropped",)


def test_a_time_in_two_columns_is_told(tmp_path: Path) -> None:
    """Seconds and nanoseconds apart are no clock; the line says what to make of them."""
    np.savetxt(tmp_path / "log.csv", np.eye(3), delimiter=",", header="s,ns,V", comments="")
    with pytest.raises(InputError, match="write s \\+ 1e-9 ns as one column"):
        survey(tmp_path / "log.csv")


def test_a_table_in_place_of_messages_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A twin that names topics is given a CSV called as one of them: what would map its columns."""
    write_model(tmp_path / "arm.xml", {"arm": None}, "motor")
    (tmp_path / "t.yaml").write_text(
        "model: arm.xml\nsignals: {joints: {arm: /joint_states}, actuators: {arm: /actuator_command}}\n"
    )
    log = write_table(tmp_path / "joint_states.csv")
    assert main(["compare", str(log), "--twin", str(tmp_path / "t.yaml")]) == 2
    assert "vpptwin inspect" in capsys.readouterr().err
    refuse(log, "only /joint_states")
