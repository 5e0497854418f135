"""The twin: a rig in MuJoCo, driven through the actuator layer, with any of the catalogue's effects switched on."""

from vpptwin.twin.spec import TwinSpec, load_twin
from vpptwin.twin.state import TwinState
from vpptwin.twin.twin import Twin

__all__ = ["Twin", "TwinSpec", "TwinState", "load_twin"]
