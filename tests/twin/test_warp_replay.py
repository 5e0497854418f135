"""Replays on Warp's processor device are numba's to the last bit; on a card, where there is one, to rounding."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.effects.rigs import Rig
from tests.twin.hover import share_kernel
from tests.twin.test_warp_step import list_devices, own_effect, wait
from vpptwin.cli.main import main
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.flights import build_bench
from vpptwin.diagnosis.evidence.runs import Variation
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.read import read_flight
from vpptwin.report.result import diagnose
from vpptwin.system.errors import InputError
from vpptwin.system.resources import flights_dir
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.state import Driven, Trajectory
from vpptwin.twin.warp.device import find_device
from vpptwin.twin.warp.replay import PROCESSOR, Given, WarpReplay, WarpTwins, choose_maker

ROWS, STEPS = 16, 200
ROUNDING = 1e-11
"""Share of the largest value by which a card's sines may make others, as `tests/twin/test_fused.py` says."""
SOME = ("rail_x.coulomb", "rail_x.stiction", "servo.backlash", "command.delay", "airframe.com", "air.ground_effect")
LOG = flights_dir() / "steps.mcap"


@pytest.fixture(scope="module", params=list_devices())
def makers(request: pytest.FixtureRequest) -> list[type[Twin] | WarpTwins]:
    """What makes numba's twins, and those of a device."""
    pytest.importorskip("warp")
    return [Twin, WarpTwins(request.param)]


def draw_pair(makers: list[type[Twin] | WarpTwins], rig: Rig, active: tuple[str, ...]) -> list[Twin]:
    """Two twins with effects at values drawn from the priors, half of them at off."""
    pair, rng = [make(rig.spec, ROWS, active) for make in makers], np.random.default_rng(2)
    for effect in pair[0].effects.values():
        for p in effect.parameters:
            values = np.where(rng.random(ROWS) < 0.5, p.off, p.draw(rng, ROWS))
            for twin in pair:
                twin.set_parameter(effect.id, p.name, values)
    return pair


def check_same(found: Trajectory, expected: Trajectory, maker: type[Twin] | WarpTwins) -> None:
    """To the last bit on the processor."""
    pairs = {name: (found.state.arrays()[name], values) for name, values in expected.state.arrays().items()}
    pairs |= {"way": (found.qpos, expected.qpos), "speeds": (found.qvel, expected.qvel)}
    if expected.rotor_speed is not None and found.rotor_speed is not None:
        pairs["rotors"] = found.rotor_speed, expected.rotor_speed
    for name, (ours, numba) in pairs.items():
        if getattr(maker, "device", "") == "cpu":
            np.testing.assert_array_equal(ours, numba, err_msg=name)
        else:
            scale = float(np.abs(numba).max(initial=1e-3))
            np.testing.assert_allclose(ours, numba, rtol=0, atol=ROUNDING * scale, err_msg=name)


@pytest.mark.parametrize("inputs", ["speed", "both", "pushed", "neither"])
@pytest.mark.parametrize("active", [(), SOME, None], ids=["none", "some", "all"])
def test_replay_equals_numba(
    makers: list[type[Twin] | WarpTwins], rigs: dict[str, Rig], active: tuple[str, ...] | None, inputs: str
) -> None:
    """Whatever a log holds, with any set of effects, after a warm-up; what touches is MuJoCo's with both."""
    rng, rig = np.random.default_rng(3), rigs["replayed"]
    pair = draw_pair(makers, rig, tuple(e.id for e in rig.spec.catalogue) if active is None else active)
    start = rig.start(pair[0], 3)
    start.qpos[0, 1], start.qvel[0, 1] = 0.3, -3.0  # to the floor
    start.qpos[1, 0], start.qvel[1, 0] = 1.45, 3.0  # to the end of the rail
    commands = np.repeat(rng.uniform(-0.05, 0.18, (ROWS, STEPS // 10, 2)), 10, axis=1)
    given = {
        "rotor_speed": rng.uniform(420, 520, (ROWS, STEPS, 2)), "throttle": rng.uniform(0.3, 0.7, (ROWS, STEPS, 2)),
        "disturbance": 0.3 * rng.normal(size=(ROWS, 3, 3)),
    }  # fmt: skip
    given = dict(list(given.items())[: ["neither", "speed", "both", "pushed"].index(inputs)])
    found = []
    for twin in pair:
        state = start.copy()
        state.actuators[:] = twin.warm_up(state.actuators, commands[:, :50])
        found.append(twin.replay_commands(state, commands, **given))
    check_same(found[1], found[0], makers[1])
    assert found[0].qpos[0, :, 1].min() < 0.22  # m, within reach of the floor
    assert found[0].qpos[1, :, 0].max() > 1.49  # and at the end stop
    assert np.ptp(found[0].qpos[2:], axis=1).min(axis=0).max() > 0.01


def test_other_rigs_and_driven_joints(makers: list[type[Twin] | WarpTwins], rigs: dict[str, Rig]) -> None:
    """A cart with every effect it has, and with its pole led along a track."""
    rig, rng = rigs["cart"], np.random.default_rng(4)
    commands = np.repeat(rng.uniform(-1, 1, (ROWS, STEPS // 10, 1)), 10, axis=1)
    push = 0.1 * rng.normal(size=(ROWS, 4, 2))
    with share_kernel():
        pair = draw_pair(makers, rig, tuple(effect.id for effect in rig.spec.catalogue))
        start = rig.start(pair[0], 3)
        numba, ours = (twin.replay_commands(start, commands, disturbance=push) for twin in pair)
    check_same(ours, numba, makers[1])
    path = rig.spec.model_file.with_name("led.yaml")
    path.write_text(
        f"model: {rig.spec.model_file.name}\n"
        "signals: {joints: {slide: /joint_states}, driven: {swing: /joint_states}, actuators: {motor: /commands}}\n"
    )
    spec, time = load_twin(path), np.arange(STEPS) * 1e-3
    led = np.zeros((2, ROWS, STEPS, 2))
    led[0, ..., 1], led[1, ..., 1] = 0.3 * np.sin(5.0 * time), 1.5 * np.cos(5.0 * time)
    found = []
    for make in makers:
        twin = make(spec, ROWS, ["slide.coulomb"])
        twin.set_parameter("slide.coulomb", "force", np.linspace(0.0, 0.3, ROWS))
        track = Driven(np.array([1]), led[0], led[1])
        found.append(twin.replay_commands(twin.initial_state(), commands, driven=track))
    check_same(found[1], found[0], makers[1])
    assert np.ptp(found[0].qpos[..., 0], axis=1).min() > 1e-4


def test_bench_equals_numba(makers: list[type[Twin] | WarpTwins]) -> None:
    """What a diagnosis asks of a twin on a flight that ships: effects, pasts, pulses, starts that are moved."""
    spec = load_twin()
    flight = read_measurements(spec, read_flight(LOG))
    starts = [flight.start + 0.5 + 0.3 * np.arange(10)]
    runs = [
        Variation(), Variation({("rail_x.coulomb", "force"): 0.3}, push=(1, 0, 0.2)),
        Variation({("rail_x.lugre", "force"): 0.4, ("command.delay", "delay"): 0.01}),
        Variation({("mocap.delay", "delay"): 0.005}, pose=np.full(3, 0.01), velocity=np.full(3, 0.1)),
    ]  # fmt: skip
    found: list[np.ndarray] = []
    for make in makers:
        bench: Bench = build_bench(spec, [flight], starts, spec.robot.window, False, make_twin=make)
        found.append(bench.predict(runs))
    if getattr(makers[1], "device", "") == "cpu":
        np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9 * np.abs(found[0]).max())
    assert np.isfinite(found[0]).all()


@pytest.mark.slow
def test_it_compiles_for_a_card(tmp_path: Path) -> None:
    """Without one: Warp's compiler makes code for an H100 of the kernel that a diagnosis of the drone runs."""
    wp = pytest.importorskip("warp")
    names = frozenset({"command", "speed", "throttle", "push", "qpos", "qvel", "rotor_speed"})
    kernel = WarpReplay(load_twin(), Given(names, 3)).kernel
    wp.compile_aot_module(kernel.module, arch=90, module_dir=tmp_path, use_ptx=True)
    (made,) = tmp_path.glob("*.ptx")
    assert "_kernel_forward" in made.read_text(errors="replace")


@pytest.mark.slow
@pytest.mark.parametrize("device", list_devices())
def test_a_verdict_is_the_same(device: str) -> None:
    """On a whole flight that ships: on the processor every digit, on a card the causes."""
    pytest.importorskip("warp")
    numba, ours = (diagnose(LOG, progress=False, device=where).verdict for where in (None, device))
    assert [c.effect for c in ours.causes] == [c.effect for c in numba.causes]
    assert numba.causes
    if device == "cpu":
        assert ours.as_dict() == numba.as_dict()


def test_an_effect_that_warp_cannot_compile_is_told() -> None:
    """Though it is off: a diagnosis would try it. The way out is a diagnosis's."""
    pytest.importorskip("warp")
    spec = own_effect(wait)[0].spec
    twin = WarpTwins("cpu")(spec, 2)
    with pytest.raises(InputError, match=r"rail_x\.own uses while.*leave out --device"):
        twin.replay_commands(twin.initial_state(), np.zeros((2, 10, 2)))


def test_a_rig_of_mujoco_alone_is_refused(tmp_path: Path) -> None:
    """A body that flies freely: in a line, before anything is simulated."""
    pytest.importorskip("warp")
    (tmp_path / "body.xml").write_text(
        '<mujoco><worldbody><body name="base"><freejoint/><geom size="0.1" mass="1"/></body></worldbody></mujoco>'
    )
    path = tmp_path / "twin.yaml"
    path.write_text("model: body.xml\nsignals: {bodies: {base: /pose}}\n")
    with pytest.raises(InputError, match=r"a rig that only MuJoCo steps; expected one of hinges.*leave out --device"):
        choose_maker(load_twin(path), "cpu")


def test_devices_that_are_not_there(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Each is told in a line, with the way out, before a log is read: none, an old driver, few cards, no Warp."""
    wp = pytest.importorskip("warp")

    def refuse(device: str) -> str:
        command = ["diagnose", str(LOG), "--out", str(tmp_path / "out"), "--device", device]
        assert main(command) == 2
        (line,) = capfd.readouterr().err.splitlines()
        assert not (tmp_path / "out").exists()
        return line

    assert "device tpu; expected cuda" in refuse("tpu")
    monkeypatch.setattr(wp, "is_cuda_available", lambda: False)
    monkeypatch.setattr(wp, "get_cuda_driver_version", lambda: None)
    assert "device cuda with no CUDA driver, and Warp" in refuse("cuda")
    monkeypatch.setattr(wp, "get_cuda_driver_version", lambda: (11, 2))
    assert f"driver for CUDA 11.2, and Warp {wp.__version__}" in refuse("cuda:1")
    monkeypatch.setattr(wp, "is_cuda_available", lambda: True)
    monkeypatch.setattr(wp, "get_cuda_device_count", lambda: 1)
    assert find_device("cuda", PROCESSOR) == "cuda:0"
    assert "device cuda:1, and Warp finds 1 CUDA devices" in refuse("cuda:1")
    monkeypatch.setitem(__import__("sys").modules, "warp", None)
    assert "pip install 'vpptwin[gpu]'" in refuse("cpu")
