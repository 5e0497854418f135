"""Where MuJoCo keeps the fields of mjModel and mjData, from the struct declarations that its package ships."""

from __future__ import annotations

import ctypes
from functools import cache

import mujoco
from mujoco.introspect import ast_nodes, enums, structs

from vpptwin.engine.callback import installed
from vpptwin.engine.view import DATA_ARRAYS, MODEL_ARRAYS

SCALARS: dict[str, type] = {
    "mjtNum": ctypes.c_double, "mjtSize": ctypes.c_int64, "mjtBool": ctypes.c_bool, "mjtByte": ctypes.c_ubyte,
    "int": ctypes.c_int, "float": ctypes.c_float, "double": ctypes.c_double, "char": ctypes.c_char,
    "size_t": ctypes.c_size_t, "uintptr_t": ctypes.c_void_p, "uint64_t": ctypes.c_uint64,
    "unsigned int": ctypes.c_uint,
}  # fmt: skip
RANGE, TESTED = "mujoco>=4.0,<5", "4.0.0"
"""Releases that may be installed, as pyproject.toml says, and the one of constraints.txt."""
PROBE = """
<mujoco><size nuserdata="3"/><option timestep="0.003" gravity="0.3 0 -9.7"/><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 0.15" gravcomp="0.4"><joint name="x" type="slide" axis="1 0 0" damping="2" stiffness="5"/>
<joint name="z" type="slide" axis="0 0 1" damping="1" actuatorgravcomp="true"/><geom size="0.16" mass="0.7"/>
<body pos="0.3 0 0.4"><joint name="turn" axis="0 1 0" damping="0.3" armature="0.02" actuatorfrcrange="-0.5 0.3"/>
<geom type="capsule" fromto="0 0 0 0.2 0 0.1" size="0.02" mass="0.2"/></body></body></worldbody>
<tendon><fixed name="both"><joint joint="x" coef="0.7"/><joint joint="turn" coef="-0.2"/></fixed></tendon>
<actuator><motor joint="x" gear="2" ctrlrange="-1 1"/><motor joint="z" forcerange="-1.5 1.5"/>
<position joint="turn" kp="20" kv="0.5"/><general tendon="both" gaintype="affine" gainprm="2 0.3 -0.4"/></actuator>
</mujoco>
"""
"""A model in contact that has something in every array of a `View`; one limit of each kind, where a test reaches it."""


def translate_type(declared: object) -> type:
    """The ctypes type of a declared C type."""
    if isinstance(declared, ast_nodes.PointerType):
        return ctypes.c_void_p
    if isinstance(declared, ast_nodes.ArrayType):
        result = translate_type(declared.inner_type)
        for extent in reversed(declared.extents):
            result = result * extent
        return result
    if isinstance(declared, ast_nodes.AnonymousStructDecl):
        return make_struct("", declared.fields)
    name = str(getattr(declared, "name", declared)).removeprefix("struct ").rstrip("_")
    if name in SCALARS:
        return SCALARS[name]
    if name in enums.ENUMS:
        return ctypes.c_int
    return mirror_struct(name)


def make_struct(name: str, fields: object) -> type[ctypes.Structure]:
    """A ctypes structure with declared fields."""
    listed = []
    for field in fields:  # type: ignore[attr-defined]
        try:
            listed.append((field.name, translate_type(field.type)))
        except KeyError as unknown:
            raise unsupported(f"declares {name}.{field.name} of a type that is not known, {unknown}") from None
    return type(name or "anonymous", (ctypes.Structure,), {"_fields_": listed})


@cache
def mirror_struct(name: str) -> type[ctypes.Structure]:
    """The ctypes twin of one of MuJoCo's structs."""
    return make_struct(name, structs.STRUCTS[name].fields)


def unsupported(found: str) -> ImportError:
    """The error for a MuJoCo other than we know it: what it does, what was expected and what to do."""
    return ImportError(
        f"mujoco {mujoco.__version__} {found}; expected a release of {RANGE} that vpptwin was tested with: "
        f"pip install mujoco=={TESTED}"
    )


def make_probe() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The small model that checks are made with."""
    with installed(None):  # MuJoCo calls it while it compiles, and one in Python would fail there
        model = mujoco.MjModel.from_xml_string(PROBE)
    return model, mujoco.MjData(model)


@cache
def check_layout() -> None:
    """Compare where the arrays of a `View` should be with where they are in a small model.

    Raises:
        ImportError: if the installed MuJoCo does not keep its fields where it declares them.
    """
    model, data = make_probe()
    for struct, thing, table in (("mjModel", model, MODEL_ARRAYS), ("mjData", data, DATA_ARRAYS)):
        mirror = mirror_struct(struct).from_address(thing._address)
        for name in [field for field, *_ in table.values()] + ["userdata"] * (thing is data):
            if not hasattr(thing, name) or getattr(mirror, name, 0) != getattr(thing, name).ctypes.data:
                raise unsupported(f"lays out {struct}.{name} otherwise than it declares")


def field_offset(struct: str, path: str) -> int:
    """Offset of a field in a struct [bytes]; `opt.timestep` for one within."""
    check_layout()
    return find_offset(mirror_struct(struct), path)


@cache
def find_offset(mirror: type[ctypes.Structure], path: str) -> int:
    """The same in the mirror of a struct, which a thousand lookups share."""
    offset = 0
    for name in path.split("."):
        offset += getattr(mirror, name).offset
        mirror = {field[0]: field[1] for field in mirror._fields_}[name]  # type: ignore[assignment]
    return offset


def mirror_size(struct: str) -> int:
    """Size of a struct [bytes]."""
    return ctypes.sizeof(mirror_struct(struct))


def model_offset(field: str) -> int:
    """Offset of a field in mjModel [bytes]."""
    return field_offset("mjModel", field)


def data_offset(field: str) -> int:
    """Offset of a field in mjData [bytes]."""
    return field_offset("mjData", field)
