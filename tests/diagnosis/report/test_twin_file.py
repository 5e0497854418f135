"""The extended twin on disk: any command takes it, from wherever, and it keeps what the diagnosed twin had."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.builders import CAUSE, VERDICT
from tests.diagnosis.rigs import CARTS, Case, write_rig
from vpptwin.cli.main import main
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.report.provenance import trace_origin
from vpptwin.report.twin_file import compose_twin, extend_effects
from vpptwin.twin.spec import TwinSpec, load_twin

FLIGHTS = Path(__file__).resolve().parents[3] / "demo/flights"


def save(spec: TwinSpec, values: dict[Key, float], folder: Path) -> dict:
    """Write the twin that a diagnosis with these values would, and read its YAML."""
    folder.mkdir(parents=True)
    log = folder.parent / "log.mcap"
    log.write_bytes(b"abc")
    effects = extend_effects(spec, values)
    origin = trace_origin(["diagnose", str(log)], spec.name, [log])
    (folder / "twin.yaml").write_text(compose_twin(spec, effects, VERDICT, origin, folder))
    return yaml.safe_load((folder / "twin.yaml").read_text())


def test_our_drone_comes_back(tmp_path: Path) -> None:
    """Model and vehicle by name, the diagnosed twin's effects kept, the new one added with six digits."""
    spec = load_twin().with_effects({"servo.lag": {"time_constant": 0.028}})
    content = save(spec, {("rail_x.coulomb", "force"): 0.30812345678}, tmp_path / "out")
    assert (content["model"], content["vehicle"]) == ("rail_rig.xml", "vehicle.yaml")
    again = load_twin(tmp_path / "out/twin.yaml")
    assert again.effects == {"servo.lag": {"time_constant": 0.028}, "rail_x.coulomb": {"force": 0.308123}}
    assert again.vehicle == spec.vehicle
    np.testing.assert_array_equal(again.model.body_mass, spec.model.body_mass)
    # The twin had 0.2 N, the flights say 0.3 N: it is not 0.5 N.
    spec = load_twin().with_effects({"rail_x.coulomb": {"force": 0.2}})
    save(spec, {("rail_x.coulomb", "force"): 0.3}, tmp_path / "anew")
    assert load_twin(tmp_path / "anew/twin.yaml").effects == {"rail_x.coulomb": {"force": 0.3}}


@pytest.mark.parametrize("relative", [False, True])
def test_other_rigs_come_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, relative: bool) -> None:
    """Signals kept, the model named by a path relative to the file, wherever --out and the caller are."""
    monkeypatch.chdir(tmp_path)
    spec = load_twin(write_rig(CARTS, tmp_path))
    out = Path("a/b") if relative else tmp_path / "a/b"
    content = save(spec, {("slide.viscous", "damping"): 1.5, ("motor.delay", "delay"): 0.004}, out)
    assert content["model"] == "../../rig.xml"
    monkeypatch.chdir("/")
    again = load_twin(tmp_path / "a/b/twin.yaml")
    assert again.effects == {"slide.viscous": {"damping": 1.5}, "motor.delay": {"delay": 0.004}}
    assert again.robot.signals == spec.robot.signals
    assert again.model_file.resolve() == (tmp_path / "rig.xml").resolve()


@pytest.mark.parametrize("mass", ["1.2345678", "0.77777777", "3.3333333"])
def test_a_value_at_its_bound_is_still_a_twin(tmp_path: Path, mass: str) -> None:
    """Rounding may not carry a value over the bound that the next command checks."""
    case = Case(CARTS.model.replace('mass="2"', f'mass="{mass}"'), "slide", CARTS.move, CARTS.noise)
    spec = load_twin(write_rig(case, tmp_path))
    values = {(e.id, p.name): bound for e in spec.catalogue for p in e.parameters for bound in (p.low, p.high)}
    save(spec, values, tmp_path / "out")
    again = load_twin(tmp_path / "out/twin.yaml")
    for (effect, parameter), value in values.items():
        assert again.effects[effect][parameter] == pytest.approx(value, rel=1e-5)


def test_the_file_says_where_it_comes_from(tmp_path: Path) -> None:
    """Logs with their SHA-256 (that of "abc" is in every textbook), and 90 % intervals: 1.645 standard deviations."""
    provenance = save(load_twin(), {("rail_x.coulomb", "force"): 0.3081}, tmp_path / "out")["provenance"]
    assert set(provenance["versions"]) == {"vpptwin", "python", "mujoco", "numpy"}
    assert provenance["command"] == f"vpptwin diagnose {tmp_path / 'log.mcap'}"
    assert datetime.fromisoformat(provenance["date"]).tzinfo is not None
    assert provenance["diagnosed_twin"] == "nominal"
    (checksum,) = provenance["logs"].values()
    assert checksum == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    force = CAUSE.parameters["force"]
    low, high = provenance["intervals_90_percent"]["rail_x.coulomb.force"]
    assert (high + low) / 2 == pytest.approx(force.value, abs=1e-6)
    assert (high - low) / 2 == pytest.approx(1.645 * force.std, rel=1e-4)


@pytest.mark.slow
def test_a_twin_with_the_right_friction_lacks_nothing_on_the_demo_flights(tmp_path: Path) -> None:
    """Given what the demo's rig hides, nothing more is named: about 20 s of a core."""
    twin = tmp_path / "twin.yaml"
    twin.write_text("model: rail_rig.xml\nvehicle: vehicle.yaml\neffects: {rail_x.coulomb: {force: 0.3}}\n")
    logs = [str(FLIGHTS / f"{name}.mcap") for name in ("steps", "aggressive", "mixed")]
    assert main(["diagnose", *logs, "--twin", str(twin), "--out", str(tmp_path / "out")]) == 0
    verdict = json.loads((tmp_path / "out/verdict.json").read_text())
    assert verdict["causes"] == []
    assert not verdict["gap"]
    assert verdict["before"] == verdict["after"]
    assert load_twin(tmp_path / "out/twin.yaml").effects == {"rail_x.coulomb": {"force": 0.3}}
