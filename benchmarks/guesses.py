"""What `vpptwin inspect` guesses of real logs, and how long it takes: `python benchmarks/guesses.py DATA`.

Prints the two tables of docs/logs.md: fields that it is sure of and right, that it asks about, that it is wrong about;
and the seconds of log and of processor that `inspect LOG` takes from start to end, of the slowest of each kind.
"""

from __future__ import annotations

import argparse
import re
import resource
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco

from vpptwin.mapping.free_body import tell_body
from vpptwin.mapping.guess import Guess, guess_signals
from vpptwin.mapping.survey import survey

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SO_ARM = {
    "Rotation": (-2.2, 2.2), "Pitch": (-3.14158, 0.2), "Elbow": (0.0, 3.14158), "Wrist_Pitch": (-2.0, 1.8),
    "Wrist_Roll": (-3.14158, 3.14158), "Jaw": (-0.2, 2.0),
}  # fmt: skip
"""Joints of the menagerie's trs_so_arm100 and their ranges [rad]."""
BODIES = (
    r"attitude: /\S+ (att_stateestimate_)?qx, y, z, w is a quaternion", r"position: /\S+ px, y, z, velocity vx, vy, vz",
    r"position: /\S+ (est_)?stateestimate[_.]x, y, z, velocity (est_)?stateestimate[_.]vx",
    r"angles: /\S+ roll, pitch, yaw in rad; ", r"accelerometer: /\S+ imu_acc_x, .* in g$",
    r"gyro: /\S+ imu_gyro_x, y, z in rad/s",
    r"angles: /\S+ att_stateestimate_roll, pitch, yaw in deg, pitch with the other sign",
)  # fmt: skip
"""What is true of the Crazyflies' logs."""


def know_so101(guess: Guess, quantity: str) -> str:
    """positions[k] and velocities[k] of joint k, positions[k] of control for servo k."""
    place = list(SO_ARM).index(guess.target)
    return f"{'velocities' if quantity == 'velocity' else 'positions'}[{place}]"


def know_double(guess: Guess, quantity: str) -> str:
    """Column 1 of the shoulder, 2 of the elbow."""
    stem = {"position": "pos_meas", "velocity": "vel_meas", "effort": "tau_con"}[quantity]
    return f"{stem}{1 if guess.target.startswith('shoulder') else 2}"


RIGS: dict[str, tuple[str, str | None, Callable[[Guess, str], str] | None]] = {
    "so101": ("*/control.csv", None, know_so101),
    "double_pendulum": ("design_A_*.csv", "double_pendulum/double_pendulum.xml", know_double),
    "simple_pendulum": ("*.csv", "simple_pendulum/pendulum.xml",
                        lambda guess, quantity: "torque" if quantity == "effort" else quantity),
    "antx": ("*.mcap", "antx/antx.xml", lambda guess, quantity: guess.target),
    "nanobench": ("*.csv.gz", None, None),
    "crazypad": ("*/E9_log*", None, None),
}  # fmt: skip
"""Folder → its logs, the MJCF, and the field of a joint's or actuator's quantity; what flies is told by `BODIES`."""


def write_model(path: Path, joints: dict[str, tuple[float, float] | None], kind: str, slide: bool = False) -> Path:
    """A chain of hinges or slides, each with an actuator of its name."""
    body = "".join(
        f"<body pos='0 0 0.1'><inertial pos='0 0 0' mass='0.1' diaginertia='1e-4 1e-4 1e-4'/><joint name='{name}' "
        f"type='{'slide' if slide else 'hinge'}' axis='0 1 0'" + (f" range='{r[0]} {r[1]}'/>" if r else "/>")
        for name, r in joints.items()
    )
    drive = "".join(f"<{kind} name='{name}' joint='{name}'/>" for name in joints)
    text = (
        f"<compiler angle='radian'/><worldbody>{body}{'</body>' * len(joints)}</worldbody><actuator>{drive}</actuator>"
    )
    path.write_text(f"<mujoco>{text}</mujoco>")
    return path


def score_rig(data: Path, name: str, scratch: Path) -> tuple[int, int, int, int]:
    """Logs of a rig, and fields that are right, asked about and wrong."""
    pattern, model, truth = RIGS[name]
    logs, count = sorted((data / name).glob(pattern)), [0, 0, 0]
    if truth is None:
        for told in (each for log in logs for each in tell_body(survey(log)[1], name)):
            count[1 if not told.sure else 0 if any(re.match(known, told.text) for known in BODIES) else 2] += 1
        return len(logs), *count
    path = EXAMPLES / model if model else write_model(scratch / "arm.xml", dict(SO_ARM), "position")
    compiled = mujoco.MjModel.from_xml_path(str(path))
    for log in logs:
        joined = f"{log}+{log.with_name('state_motor.csv')}" if name == "so101" else log
        for guess in guess_signals(compiled, survey(joined)[1]):
            for quantity in ("position", "velocity") if guess.group == "joints" else ("effort",):
                found = guess.fields.get(quantity)
                is_right = found is not None and (found.name or found.field) == truth(guess, quantity)
                count[1 if not guess.sure or found is None else 0 if is_right else 2] += 1
    return len(logs), *count


def time_rig(data: Path, name: str) -> tuple[float, float, float]:
    """Shortest and longest log of a rig, and the most processor time that `inspect` took of one [s]."""
    spans, times = [], []
    for log in sorted((data / name).glob(RIGS[name][0])):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(
            [sys.executable, "-m", "vpptwin", "inspect", log], check=True, capture_output=True, text=True
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        spans.append(float(re.search(r"signals over\s+(\S+)\s+s", done.stdout).group(1)))
    return min(spans), max(spans), max(times)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables, as docs/logs.md has them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--rigs", nargs="+", choices=RIGS, default=list(RIGS))
    args = parser.parse_args(arguments)
    print("| log | files | right | asked | wrong |\n|---|---|---|---|---|")
    with TemporaryDirectory() as folder:
        for name in args.rigs:
            print(f"| {name} | {' | '.join(map(str, score_rig(args.data, name, Path(folder))))} |", flush=True)
    print("\n| log | seconds of log | processor |\n|---|---|---|")
    for name in args.rigs:
        low, high, longest = time_rig(args.data, name)
        print(f"| {name} | {low:.0f} to {high:.0f} | {longest:.2f} s |", flush=True)


if __name__ == "__main__":
    main()
