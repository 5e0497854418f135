"""The step at start-up: what differs from what the compiled step counts on is named."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import mujoco
import pytest
from mujoco.introspect import ast_nodes
from mujoco.introspect import structs as declared

from vpptwin.engine import structs
from vpptwin.engine.check import SCALARS, check_step, compare_step
from vpptwin.engine.structs import RANGE, TESTED, check_layout, field_offset, mirror_struct
from vpptwin.engine.view import DATA_ARRAYS
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.stepping import kernel

ROOT = Path(__file__).resolve().parents[2]
CACHES = (mirror_struct, check_layout, check_step)


@pytest.fixture(autouse=True)
def fresh() -> Iterator[None]:
    """Nothing remembered of earlier checks, before and after."""
    for function in CACHES:
        function.cache_clear()
    yield
    for function in CACHES:
        function.cache_clear()


def test_the_step_is_worth_comparing() -> None:
    """The small model is in contact, its joint at the limit of what actuators exert, and no force is compared as 0."""
    found = compare_step()
    assert found["ncon"][1] > 0
    assert found["nefc"][1] > 0
    *_, joint = found["qfrc_actuator"][1]
    assert joint == 0.3
    assert all(abs(found[name][1]).min() > 0.0 for name in ("qfrc_passive", "qfrc_bias", "qacc_warmstart"))


@pytest.mark.parametrize("field", SCALARS)
def test_a_number_elsewhere_is_noticed(monkeypatch: pytest.MonkeyPatch, field: str) -> None:
    """A number within a struct that lies four or eight bytes on is not what MuJoCo shows."""
    shift = 4 if field in ("nefc", "ncon") else 8
    monkeypatch.setattr(structs, "field_offset", lambda s, path: field_offset(s, path) + shift * (path == field))
    with pytest.raises(ImportError, match=rf"mujoco .* steps otherwise .* {field} is .* expected .*pip install"):
        check_step()


@pytest.mark.parametrize(
    ("name", "other", "noticed"),
    [
        ("qfrc_passive", "qfrc_bias", "qfrc_passive"),
        ("qacc_warmstart", "qacc_smooth", "qacc_warmstart"),
        ("qfrc_constraint", "qfrc_smooth", "qfrc_constraint"),
        ("velocity", "actuator_length", "qfrc_actuator"),
        ("moment", "actuator_length", "index 4"),
        ("qfrc_gravcomp", "qfrc_spring", "qfrc_actuator"),
        ("inertia", "qLD", "momentum"),
    ],
)
def test_another_array_is_noticed(monkeypatch: pytest.MonkeyPatch, name: str, other: str, noticed: str) -> None:
    """An array that holds something else than it did is named, or else the force that comes out wrong."""
    monkeypatch.setitem(DATA_ARRAYS, name, (other, *DATA_ARRAYS[name][1:]))
    with pytest.raises(ImportError, match=f"steps otherwise .* {noticed} is"):
        check_step()


@pytest.mark.parametrize(
    ("flag", "noticed"),
    [
        ("eulerdamp", "otherwise .* momentum is"),
        ("clampctrl", "otherwise .* qfrc_actuator is"),
        ("actuation", "its control callback 0 times a step"),
    ],
)
def test_another_physics_is_noticed(monkeypatch: pytest.MonkeyPatch, flag: str, noticed: str) -> None:
    """An engine that leaves out what ours counts on, here by its flags, is refused when the first step is compiled."""
    probe = structs.PROBE.replace("<worldbody>", f'<option><flag {flag}="disable"/></option><worldbody>')
    monkeypatch.setattr(structs, "PROBE", probe)
    monkeypatch.setattr(kernel, "_KERNELS", {})
    with pytest.raises(ImportError, match=f"mujoco {mujoco.__version__} .*{noticed}"):
        _ = Twin(load_twin(), 1)._kernel.callback


def test_an_unknown_type_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """A field of a C type that we do not know is refused in a line that names both."""
    new = SimpleNamespace(name="gadget", type=ast_nodes.ValueType(name="mjtQuarter"))
    fields = (*declared.STRUCTS["mjOption"].fields, new)
    monkeypatch.setitem(structs.structs.STRUCTS, "mjOption", SimpleNamespace(fields=fields))
    with pytest.raises(ImportError, match=r"^mujoco .* mjOption\.gadget of a type .*, 'mjtQuarter'; expected .*$"):
        field_offset("mjModel", "opt.timestep")


def test_versions_agree() -> None:
    """Messages name the range of pyproject.toml and the release of constraints.txt."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert RANGE in project["dependencies"]
    assert re.search(r"^mujoco==(.*)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE)[1] == TESTED
