"""Models by path or by name: our own, those of MuJoCo's menagerie, those of robot_descriptions."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from vpptwin.system.errors import InputError, load_extra
from vpptwin.system.resources import find_model_file


def find_model(name: str) -> Path:
    """The MJCF of a model.

    Args:
        name: a path, a shipped file, a robot of the menagerie (`universal_robots_ur10e`, or `ur10e` where that is one
            robot's alone), or one of robot_descriptions (`ur10e_mj_description`).

    Raises:
        InputError: if there is none of that name, several are, or it cannot be downloaded.
    """
    if Path(name).suffix or Path(name).exists():
        return find_model_file(name, Path())
    if name.endswith("_description"):
        return describe_robot(name)
    menagerie = load_extra("mujoco_menagerie", f"model {name!r}")
    known = {robot.name: robot for robot in menagerie.robots()}
    if name in known:
        robot, entry = known[name], known[name].default_model
    else:
        called = [(r, e.name) for r in known.values() for e in r.entry_points if e.kind == "robot" and e.name == name]
        called = called or [(r, r.default_model) for r in known.values() if r.name.endswith(f"_{name}")]
        if len(called) != 1:
            near = [robot.name for robot, _ in called] or [robot for robot in known if name in robot]
            expected = f"one of {', '.join(near[:8])}" if near else "a path, or a robot of MuJoCo's menagerie"
            raise InputError(
                f"model {name!r} is {len(called) or 'none'} of the menagerie's", expected, "correct the name"
            )
        robot, entry = called[0]
    try:
        return Path(robot.xml(entry))
    except (menagerie.MenagerieError, OSError) as error:
        found = f"model {name!r} of the menagerie could not be downloaded ({error})"
        raise InputError(found, "a download, once", "go online, or give the path of an MJCF") from None


def describe_robot(name: str) -> Path:
    """The MJCF of a robot of robot_descriptions.

    Raises:
        InputError: if the library or the robot is missing, or the robot comes as URDF alone.
    """
    load_extra("robot_descriptions", f"model {name!r}")
    try:
        return Path(import_module(f"robot_descriptions.{name}").MJCF_PATH)
    except (ModuleNotFoundError, AttributeError):
        raise InputError(
            f"robot_descriptions has no MJCF {name!r}", "such as ur10e_mj_description", "correct it"
        ) from None
    except Exception as error:  # git's, while it is cloned
        found = f"model {name!r} of robot_descriptions could not be downloaded ({error})"
        raise InputError(found, "a download, once", "go online, or give the path of an MJCF") from None
