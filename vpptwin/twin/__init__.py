"""The twin: a rig in MuJoCo, driven through the actuator layer, with any of the catalogue's effects switched on."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vpptwin.twin.spec import TwinSpec as TwinSpec
    from vpptwin.twin.spec import load_twin as load_twin
    from vpptwin.twin.state import TwinState as TwinState
    from vpptwin.twin.twin import Twin as Twin

__all__ = ["Twin", "TwinSpec", "TwinState", "load_twin"]
_PLACES = {"Twin": "twin", "TwinSpec": "spec", "TwinState": "state", "load_twin": "spec"}


def __getattr__(name: str) -> object:
    """Import what is asked for (PEP 562): reading a twin takes no compiler, flying it does."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
