"""Where MuJoCo keeps its fields: as declared, or refused."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco.introspect import structs as declared

from vpptwin.engine import structs
from vpptwin.engine.structs import check_layout, data_offset, field_offset, mirror_size, mirror_struct, model_offset
from vpptwin.engine.view import DATA_ARRAYS, MODEL_ARRAYS
from vpptwin.twin import load_twin

MODEL = load_twin().model
DATA = mujoco.MjData(MODEL)


@pytest.fixture
def fresh() -> Iterator[None]:
    """Nothing remembered of the layout, before and after."""
    caches = (mirror_struct, check_layout)
    for function in caches:
        function.cache_clear()
    yield
    for function in caches:
        function.cache_clear()


@pytest.mark.parametrize(("struct", "thing"), [("mjModel", MODEL), ("mjData", DATA)])
def test_every_array_lies_where_it_is_declared(struct: str, thing: mujoco.MjModel | mujoco.MjData) -> None:
    """For each array that the bindings show, the pointer at its offset leads to the very same memory."""
    mirror, checked = mirror_struct(struct).from_address(thing._address), 0
    for name, kind, *_ in mirror._fields_:
        array = getattr(thing, name, None)
        if not getattr(mirror, name):  # of the solver's arena, not there yet
            continue
        if kind is ctypes.c_void_p and isinstance(array, np.ndarray) and array.size and array.dtype.kind in "fiub":
            assert getattr(mirror, name) == array.ctypes.data, name
            checked += 1
    assert checked > 60


def test_what_the_step_reads_is_there() -> None:
    """Every field that the compiled step looks up is an array of the size and type that it is read with."""
    for table, thing, offset in ((MODEL_ARRAYS, MODEL, model_offset), (DATA_ARRAYS, DATA, data_offset)):
        for field, dtype, size in table.values():
            array = getattr(thing, field)
            assert (array.dtype.itemsize, array.dtype.kind == "f") == (np.dtype(dtype).itemsize, dtype is np.float64)
            assert len(array) == getattr(MODEL, size), field
            assert ctypes.c_int64.from_address(thing._address + offset(field)).value == array.ctypes.data


@pytest.mark.parametrize(
    ("struct", "path", "kind"),
    [
        ("mjModel", "nuserdata", ctypes.c_int64),
        ("mjModel", "opt.timestep", ctypes.c_double),
        ("mjModel", "nbody", ctypes.c_int64),
        ("mjData", "time", ctypes.c_double),
        ("mjData", "nefc", ctypes.c_int),
        ("mjData", "ncon", ctypes.c_int),
    ],
)
def test_single_numbers_lie_where_they_are_declared(struct: str, path: str, kind: Any) -> None:  # noqa: ANN401
    """Numbers within the structs, those in structs within included, are read at their offsets."""
    thing: mujoco.MjModel | mujoco.MjData = MODEL
    if struct == "mjData":
        thing = DATA
        DATA.qpos[:] = -1.51, 0.1, 1.2  # on the end stops, a tip in the floor
        DATA.time = 1.25
        mujoco.mj_forward(MODEL, DATA)
        assert DATA.ncon > 0
    expected: object = thing
    for name in path.split("."):
        expected = getattr(expected, name)
    assert kind.from_address(thing._address + field_offset(struct, path)).value == expected


def test_gravity_and_sizes() -> None:
    """An array within a struct within is found too, and sizes are whole words."""
    address = MODEL._address + model_offset("opt.gravity")
    np.testing.assert_array_equal((ctypes.c_double * 3).from_address(address), [0.0, 0.0, -9.81])
    assert mirror_size("mjModel") % 8 == mirror_size("mjData") % 8 == 0


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize("struct", ["mjModel", "mjData"])
@pytest.mark.parametrize("change", ["a field less", "a field more", "two exchanged"])
def test_another_layout_is_refused(monkeypatch: pytest.MonkeyPatch, struct: str, change: str) -> None:
    """A MuJoCo that keeps its fields otherwise than it declares is refused, with the release that is known to work."""
    fields = list(declared.STRUCTS[struct].fields)
    first = next(i for i, f in enumerate(fields) if f.name in ("nq", "narena"))
    if change == "a field less":
        del fields[first]
    elif change == "a field more":
        fields.insert(first, SimpleNamespace(name="something_new", type=fields[first].type))
    else:
        names = [f.name for f in fields]
        i, j = (names.index(name) for name in (("qpos0", "body_mass") if struct == "mjModel" else ("qpos", "qvel")))
        fields[i], fields[j] = fields[j], fields[i]
    changed = {**declared.STRUCTS, struct: SimpleNamespace(fields=tuple(fields))}
    monkeypatch.setattr(structs.structs, "STRUCTS", changed)
    with pytest.raises(ImportError, match=rf"lays out {struct}\..* otherwise than it declares.*pip install"):
        model_offset("opt.timestep")


@pytest.mark.usefixtures("fresh")
def test_layout_is_checked_before_the_first_offset(monkeypatch: pytest.MonkeyPatch) -> None:
    """No offset is given out unchecked, and the check is made once."""
    calls = []
    monkeypatch.setattr(structs, "check_layout", lambda: calls.append(1))
    data_offset("qpos")
    model_offset("qpos0")
    assert len(calls) == 2
    monkeypatch.undo()
    check_layout()
    assert check_layout.cache_info().misses == 1
    data_offset("qpos")
    assert check_layout.cache_info().misses == 1


def test_unknown_field_is_an_error() -> None:
    """A field that MuJoCo does not have is no offset."""
    with pytest.raises(AttributeError):
        model_offset("no_such_field")


@pytest.mark.usefixtures("fresh")
def test_a_field_that_is_gone_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """A MuJoCo without one of the arrays that the step reads is refused in the same line."""
    monkeypatch.setitem(DATA_ARRAYS, "inertia", ("qM", np.float64, "nC"))
    with pytest.raises(ImportError, match=r"lays out mjData\.qM otherwise"):
        check_layout()
