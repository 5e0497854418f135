"""Where MuJoCo keeps the fields of mjModel and mjData, from the struct declarations that its package ships."""

from __future__ import annotations

import ctypes
from functools import cache

import mujoco
from mujoco.introspect import ast_nodes, enums, structs

SCALARS: dict[str, type] = {
    "mjtNum": ctypes.c_double,
    "mjtSize": ctypes.c_int64,
    "mjtBool": ctypes.c_bool,
    "mjtByte": ctypes.c_ubyte,
    "int": ctypes.c_int,
    "float": ctypes.c_float,
    "double": ctypes.c_double,
    "char": ctypes.c_char,
    "size_t": ctypes.c_size_t,
    "uintptr_t": ctypes.c_void_p,
    "uint64_t": ctypes.c_uint64,
    "unsigned int": ctypes.c_uint,
}
PROBE = """
<mujoco><size nuserdata="1"/><worldbody><body><joint name="j" type="slide"/><geom size="1"/></body></worldbody>
<actuator><motor joint="j"/></actuator></mujoco>
"""


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
    listed = [(f.name, translate_type(f.type)) for f in fields]  # type: ignore[attr-defined]
    return type(name or "anonymous", (ctypes.Structure,), {"_fields_": listed})


@cache
def mirror_struct(name: str) -> type[ctypes.Structure]:
    """The ctypes twin of one of MuJoCo's structs."""
    return make_struct(name, structs.STRUCTS[name].fields)


@cache
def check_layout() -> None:
    """Compare where fields should be with where they are in a small model.

    Raises:
        ImportError: if the installed MuJoCo does not keep its fields where it declares them.
    """
    model = mujoco.MjModel.from_xml_string(PROBE)
    data = mujoco.MjData(model)
    for struct, thing, names in (
        ("mjModel", model, ("qpos0", "body_mass", "dof_damping", "M_colind", "actuator_gainprm")),
        ("mjData", data, ("qpos", "qvel", "ctrl", "userdata", "qfrc_passive", "qfrc_constraint", "M")),
    ):
        mirror = mirror_struct(struct).from_address(thing._address)
        for name in names:
            if getattr(mirror, name) != getattr(thing, name).ctypes.data:
                raise ImportError(
                    f"mujoco {mujoco.__version__} lays out {struct}.{name} otherwise than it declares; "
                    "expected a release that vpptwin was tested with: pip install 'mujoco>=4.0,<4.1'"
                )


def field_offset(struct: str, path: str) -> int:
    """Offset of a field in a struct [bytes]; `opt.timestep` for one within."""
    check_layout()
    mirror, offset = mirror_struct(struct), 0
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
