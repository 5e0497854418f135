"""Sessions of SimGap: drawn from a seed, sealed, without the truth in what entrants get."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from proving import servo_leg
from proving.simgap.results import score_answer
from proving.simgap.scores import NOTHING, UNKNOWN
from proving.simgap.session import HORIZONS, MOTION
from proving.simgap.sets import check_set, commit_seed, draw_set, hash_set, list_sessions, publish_seed, read_manifest
from proving.simgap.storage import read_session, read_truth
from proving.simgap.worlds import WORLDS, draw_session
from tests.simgap.builders import draw_small_set

SLOW = ("arms", "drones", "legs")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pendula and a watched rig."""
    return draw_small_set(tmp_path_factory.mktemp("set"))


def test_same_seed_same_set(drawn: Path, tmp_path: Path) -> None:
    """A seed gives the same hashes; another seed gives others."""
    again = read_manifest(draw_small_set(tmp_path / "again"))
    assert hash_set(again) == hash_set(read_manifest(drawn))
    other = read_manifest(draw_small_set(tmp_path / "other", 8))
    names = list(other["sessions"])
    assert all(other["sessions"][n] != again["sessions"][n] for n in names)


def test_twelve_sessions_have_the_deck(tmp_path: Path) -> None:
    """Eight of twelve have a cause, two none, two something that is not listed; causes take turns."""
    truths = [draw_session("carts", 3, number)[2] for number in range(12)]
    count = Counter(truth.answer if truth.answer in (NOTHING, UNKNOWN) else "cause" for truth in truths)
    assert count == {"cause": 8, NOTHING: 2, UNKNOWN: 2}
    kinds = [truth.answer.split(".")[1] for truth in truths if truth.answer not in (NOTHING, UNKNOWN)]
    assert len(set(kinds)) == 8


def test_forecast_is_not_shown(drawn: Path) -> None:
    """A window has motion up to its start, commands to its end; the truth is what was measured after it."""
    for home in list_sessions(drawn):
        session, truth = read_session(home), read_truth(drawn, home)
        assert ("predict" in session.tracks) == bool(session.windows)
        for window, measured in zip(session.windows, truth.forecasts):
            after = window.run.time > window.start + 1e-9
            for name, values in window.run.columns.items():
                moving = session.columns[name].role in MOTION
                assert np.isnan(values[after]).all() if moving else np.isfinite(values).all()
                assert np.isfinite(values[~after]).any()
            assert np.shape(measured) == (len(HORIZONS), len(session.predicted))
            assert window.run.time[-1] >= window.start + HORIZONS[-1] - 0.02


def test_session_does_not_tell(drawn: Path) -> None:
    """session.json has causes in the order of the rig, all alike, and of the truth its hash alone."""
    for home in list_sessions(drawn):
        content = json.loads((home / "session.json").read_text())
        truth = json.loads((drawn / "truth" / f"{home.name}.json").read_text())
        assert not {"answer", "sizes", "salt", "onset", "seed"} & set(content)
        assert truth["salt"] not in home.joinpath("session.json").read_text()


def test_changed_truth_or_session_is_found(tmp_path: Path) -> None:
    """What differs from the published hashes is named."""
    folder = draw_small_set(tmp_path, pendula=[0])
    assert check_set(folder) == 1
    (home,) = list_sessions(folder)
    path = folder / "truth" / f"{home.name}.json"
    before = path.read_text()
    path.write_text(before.replace('"onset":null', '"onset":1.0'))
    with pytest.raises(ValueError, match="truth of pendula-0000 is not the one that was sealed"):
        check_set(folder)
    path.write_text(before)
    run = home / "run_1.csv"
    run.write_text(run.read_text().replace("0.0", "0.1", 1))
    with pytest.raises(ValueError, match="is not the session that was published"):
        check_set(folder)


def test_secret_seed_is_not_written(tmp_path: Path) -> None:
    """The manifest of a secret set has the seed's hash alone, and another seed may not join."""
    draw_set(tmp_path, 12345, {"pendula": [0]}, public=False)
    manifest = read_manifest(tmp_path)
    assert manifest["seed"] is None
    assert manifest["seed_sha256"] == commit_seed(12345)
    assert not any("12345" in path.read_text() for path in tmp_path.rglob("*.json"))
    with pytest.raises(ValueError, match="12346 is not the seed"):
        publish_seed(tmp_path, 12346)
    with pytest.raises(ValueError, match="another seed"):
        draw_set(tmp_path, 12346, {"pendula": [1]}, public=False)
    publish_seed(tmp_path, 12345)
    assert read_manifest(tmp_path)["seed"] == 12345


@pytest.mark.parametrize("world", [w for w in WORLDS if w not in (*SLOW, "pendula", "watched")])
def test_worlds_draw(world: str) -> None:
    """Every world has a truth among its causes, finite runs, and scales of what is forecast."""
    session, logs, truth = draw_session(world, 5, 0)
    assert truth.answer in {*session.causes, NOTHING, UNKNOWN}
    assert len(logs) == len(session.runs)
    assert all(scale > 0.0 for scale in session.scales.values())
    assert all(np.isfinite(run.columns[c]).any() for run in session.runs for c in session.columns)
    assert all(cause.scale > 0.0 for cause in session.causes.values())


@pytest.mark.slow
@pytest.mark.parametrize("world", SLOW)
def test_slow_worlds_draw(world: str) -> None:
    """Likewise."""
    test_worlds_draw(world)


def test_two_causes_are_drawn(tmp_path: Path) -> None:
    """They are two, at their sizes, and how many there may be is told to entrants, and only there."""
    numbers = [n for n in range(4) if draw_session("pairs", 5, n)[2].answer not in (NOTHING, UNKNOWN)][:1]
    draw_set(tmp_path, 5, {"pairs": numbers, "pendula": [0]}, public=True)
    pair, single = list_sessions(tmp_path)
    session, truth = read_session(pair), read_truth(tmp_path, pair)
    assert session.many == 2
    assert len(set(truth.present) & set(session.causes)) == 2
    scores = score_answer({"probabilities": dict.fromkeys(truth.present, 0.5)}, session, truth)
    assert scores["log"] < 0.02
    assert scores["first"] == 1.0
    assert "many" not in json.loads((single / "session.json").read_text())


def test_leg_moves_as_mujoco_has_it() -> None:
    """With nothing hidden, the nominal MJCF predicts 3 s of the leg within the bend of MuJoCo's friction."""
    mujoco = pytest.importorskip("mujoco")
    log = servo_leg.move({}, 3.0, 1)
    model = mujoco.MjModel.from_xml_string(servo_leg.MJCF)
    model.opt.timestep, data = servo_leg.STEP, mujoco.MjData(model)
    targets = np.stack([log.joints["/targets"][f"{name}_servo"]["effort"] for name in servo_leg.JOINTS], axis=1)
    data.qpos[:], moved = targets[0], []
    for target in np.repeat(targets, 2, axis=0):
        moved.append(data.qpos.copy())
        data.ctrl[:] = target
        mujoco.mj_step(model, data, round(servo_leg.PERIOD / servo_leg.STEP))
    seen = np.stack([log.joints["/joint_states"][name]["position"] for name in servo_leg.JOINTS], axis=1)
    np.testing.assert_allclose(moved, seen, atol=0.005)


def test_runs_as_lerobot(tmp_path: Path) -> None:
    """An episode for each run, read back by name; what has several clocks is left out."""
    pytest.importorskip("pyarrow")
    from proving.simgap.lerobot import write_lerobot
    from vpptwin.logs.read import read_flight
    from vpptwin.system.fields import SignalEntry

    session, _, _ = draw_session("carts", 5, 0)
    folder = write_lerobot(session, tmp_path / "set")
    name = next(iter(session.find("position").values()))
    entry = SignalEntry.model_validate({"topic": "episode", "position": f"observation.state.{name}"})
    for k, run in enumerate(session.runs):
        stream = read_flight(f"{folder}#{k}", None, {"/joint_states": {"j": entry}}).joints["/joint_states"]["j"]
        np.testing.assert_allclose(stream["position"], run.columns[name], rtol=1e-6)
    assert write_lerobot(draw_session("quadrotors", 5, 0)[0], tmp_path / "other") is None


DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


@pytest.mark.skipif(not (DATA / "simple_pendulum").is_dir(), reason="needs measured data in ../shared/data")
def test_measured_sessions_are_written(tmp_path: Path) -> None:
    """Files are found by their hash, cut as the manifest says, and the fit by hand lowers the error of simulations."""
    mujoco = pytest.importorskip("mujoco")
    from proving.simgap.entrants.corrections import Correction
    from proving.simgap.entrants.lab import Lab
    from proving.simgap.measured import write_measured

    assert mujoco
    assert len(write_measured(tmp_path, DATA)) == check_set(tmp_path)
    for home in list_sessions(tmp_path):
        lab, truth = Lab(read_session(home)), read_truth(tmp_path, home)
        fitted = [Correction(truth.answer, truth.sizes[truth.answer])]
        before, after = (float(np.sqrt(np.nanmean(lab.miss(c)[:, 4] ** 2))) for c in ((), fitted))
        assert after < 0.9 * before, (home.name, before, after)


def test_measured_data_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing can be fetched, one line says what to download; another file is refused by its hash."""
    import io

    from proving.simgap import measured

    def fail(*_: object, **__: object) -> None:
        raise OSError("no network")

    monkeypatch.setattr(measured, "urlopen", fail)
    with pytest.raises(ValueError, match=r"data_measured\.csv can't be fetched \(no network\): download it"):
        measured.write_measured(tmp_path, None)
    monkeypatch.setattr(measured, "urlopen", lambda *_, **__: io.BytesIO(b"time\n0.0\n"))
    with pytest.raises(ValueError, match="it is not the file that was described"):
        measured.write_measured(tmp_path, tmp_path)
