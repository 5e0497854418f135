"""Per cents of a calibrated travel, as LeRobot logs them, are never taken for degrees or radians unasked."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from benchmarks.guesses import write_model
from tests.mapping.test_guess import write_log
from vpptwin.cli.main import main
from vpptwin.estimation.checks.units import LoggedPosition, find_ends, find_normalised
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs import read_flight
from vpptwin.logs.transcribe import transcribe
from vpptwin.mapping.guess import guess_signals
from vpptwin.mapping.survey import survey
from vpptwin.twin import load_twin

TIME = np.arange(0.0, 12.0, 0.02)
REACH = {"pan": (-1.92, 1.92), "elbow": (-1.6, 1.6)}
"""Limits of two hinges [rad]: 110 and 91.7 degrees."""


def drive(size: float, shift: float = 0.0, late: float = 0.0) -> np.ndarray:
    """A motion in per cent of the travel that would go farther than its ends, so that it is held there."""
    return np.clip(size * np.sin(1.1 * (TIME - late) + shift), -100.0, 100.0)


def write_lerobot(folder: Path, size: float) -> Path:
    """A data set of one episode: two joints, their targets, and a gripper from 0 to 100."""
    names = ["pan.pos", "elbow.pos", "gripper.pos"]
    moved = [drive(size, 0.0, 0.06), drive(size, 1.0, 0.06), 50.0 + 0.5 * drive(size, 2.0, 0.06)]
    asked = [drive(size), drive(size, 1.0), 50.0 + 0.5 * drive(size, 2.0)]
    about = {"names": names, "dtype": "float32", "shape": [3]}
    info = {"codebase_version": "v3.0", "fps": 50, "total_episodes": 1,
            "features": {"observation.state": about, "action": about}}  # fmt: skip
    for part in ("meta", "data/chunk-000"):
        (folder / part).mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps(info))
    lists = {name: pa.array(np.stack(rows, axis=1).tolist(), pa.list_(pa.float32(), 3))
             for name, rows in (("observation.state", moved), ("action", asked))}  # fmt: skip
    zeros = [0] * len(TIME)
    parquet.write_table(pa.table({**lists, "timestamp": TIME, "episode_index": zeros, "frame_index": range(len(TIME))}),
                        folder / "data/chunk-000/file-000.parquet")  # fmt: skip
    return folder


@pytest.mark.parametrize(("size", "held"), [(130.0, True), (1.2, False), (60.0, False)])
def test_positions_of_lerobot_are_asked_about(tmp_path: Path, size: float, held: bool) -> None:
    """Whether they end at 100, or would be radians or degrees by how far they go."""
    model = mujoco.MjModel.from_xml_path(str(write_model(tmp_path / "m.xml", dict(REACH), "position")))
    guesses = guess_signals(model, survey(f"{write_lerobot(tmp_path / 'set', size)}#0")[1])
    assert not any(guess.sure for guess in guesses)
    for guess in guesses:
        assert any("nobody says the unit" in doubt for doubt in guess.doubts), guess.target
        assert any("is held at exactly" in doubt and "100 of its travel" in doubt for doubt in guess.doubts) == held


def test_parquet_of_lerobot_without_its_folder_says_no_unit_either(tmp_path: Path) -> None:
    """Nor does what `convert` makes of it."""
    file = write_lerobot(tmp_path / "set", 1.2) / "data/chunk-000/file-000.parquet"
    transcribe(file, tmp_path / "c.mcap")
    for log in (file, tmp_path / "c.mcap"):
        units = {signal.label: signal.unit for signal in survey(log)[1]}
        assert units["action[0]"] == units["observation.state[1]"] == "unsaid"
        assert units["timestamp"] != "unsaid"


@pytest.mark.parametrize("kind", ["lerobot", "csv"])
@pytest.mark.parametrize(("unit", "limits", "code"), [
    ("unit: deg", REACH, 2), ("scale: 1", REACH, 2), ("unit: deg", {"pan": (-2.5, 2.5), "elbow": (-2.0, 2.0)}, 0),
    ("scale: 0.016", REACH, 0),
])  # fmt: skip
def test_a_mapping_as_degrees_is_not_taken_in_silence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, unit: str, limits: dict, code: int
) -> None:
    """Held beyond a limit it is refused, held within them all told; a scale that somebody gave is theirs."""
    write_model(tmp_path / "m.xml", dict(limits), "position")
    columns, signals = {"timestamp": TIME}, ""
    for group, what, column, late in (("joints", "observation.state", "position", 0.06),
                                      ("actuators", "action", "effort", 0.0)):  # fmt: skip
        columns |= {f"{what}.{name}.pos": drive(130.0, shift, late) for name, shift in (("pan", 0.0), ("elbow", 1.0))}
        entry = "{}: {{topic: episode, {}: {{path: {}.{}.pos, {}}}}}"
        signals += f"  {group}: {{{', '.join(entry.format(name, column, what, name, unit) for name in limits)}}}\n"
    log = str(write_log(tmp_path / "run.csv", columns))
    if kind == "lerobot":
        log = f"{write_lerobot(tmp_path / 'set', 130.0)}#0"
    (tmp_path / "t.yaml").write_text(f"model: m.xml\nsignals:\n{signals}")
    if code:
        assert main(["compare", log, "--twin", str(tmp_path / "t.yaml")]) == code
        shown = capsys.readouterr().err
        assert "is held at exactly" in shown
        assert "where the joint cannot be" in shown
        assert shown.count("\n") == 1
        return
    spec = load_twin(tmp_path / "t.yaml")
    warnings = read_measurements(spec, read_flight(log, None, spec.robot.signals.entries)).warnings
    assert any("is held at exactly" in line for line in warnings) == (unit != "scale: 0.016")


STEPS = np.repeat([0.0, 100.0, -100.0, 50.0], 100)
SWEEP = np.linspace(-90.0, 90.0, 400)


@pytest.mark.parametrize(
    ("values", "limits", "found"),
    [
        (drive(130.0), (-180.0, 180.0), True),
        (drive(130.0), (-95.0, 95.0), True),
        (50.0 + 0.5 * drive(130.0), (-np.inf, np.inf), True),
        (drive(130.0), (-100.0, 100.0), False),  # the joint's own limits, in degrees
        (drive(100.0), (-180.0, 180.0), False),  # a sine of 100 degrees, which is nowhere held
        (STEPS, (-180.0, 180.0), False),  # steps to 100 degrees
        (np.round(drive(130.0)), (-180.0, 180.0), False),  # whole degrees, or counts
        (drive(130.0) * 1.2, (-180.0, 180.0), False),  # held at 120
        (np.maximum(drive(60.0), 0.0), (-180.0, 180.0), False),
        (SWEEP, (-180.0, 180.0), False),
    ],
)
def test_only_what_is_held_at_its_ends_looks_like_it(
    values: np.ndarray, limits: tuple[float, float], found: bool
) -> None:
    """Nothing else that angles in degrees do."""
    assert bool(find_normalised([LoggedPosition("arm", values, limits)])) == found


def test_one_end_within_the_limits_is_not_enough() -> None:
    """A target that is held at 100 degrees may be one; two joints that are held there are not."""
    held = LoggedPosition(
        "arm", np.minimum(drive(130.0), 100.0) * np.where(drive(130.0) < 0.0, 0.5, 1.0), (-180.0, 180.0)
    )
    ends = find_ends(held)
    assert ends is not None
    assert ends.at == (100.0,)
    assert not find_normalised([held])
    assert len(find_normalised([held, held._replace(name="wrist")])) == 2
