"""Motors that drive another joint too: told of tendons, belts and differentials, of no serial arm whatever is wrong."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from proving import servo_arm
from proving.torque_arm import Truth, swing_arm, write_arm
from vpptwin.diagnosis.evidence.other_motors import describe_other_motors
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.flight import Stream
from vpptwin.twin import TwinSpec, load_twin

BELT, DIFFERENTIAL = ((1.0, 0.0), (0.8, 1.0)), ((1.0, 1.0), (1.0, -1.0))


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> TwinSpec:
    """An arm with a motor on each joint."""
    return write_arm(tmp_path_factory.mktemp("torque_arm"))


def tell(spec: TwinSpec, truth: Truth, seed: int) -> list[tuple[str, str, float]]:
    """Joint, motor and torque per torque of every hint."""
    lines = describe_other_motors(spec, [read_measurements(spec, swing_arm(truth, 10.0, seed))])
    found = [re.match(r"what joint (\w+)'s model lacks follows motor (\w+): (\S+) N m per N m of it", x) for x in lines]
    return [(match[1], match[2], float(match[3])) for match in found if match]


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("truth", "joint", "motor", "ratio"),
    [
        (Truth(drive=BELT), "elbow", "shoulder", 0.8),
        (Truth(drive=DIFFERENTIAL), "elbow", "shoulder", -1.0),  # its own has the other sign: -1 of that is 1
        (Truth(drive=((1.0, -2.0), (0.0, 1.0))), "shoulder", "elbow", -2.0),
        (Truth(drive=((1.0, -0.4), (0.0, 1.0)), rotor=0.05), "shoulder", "elbow", -0.4),
        (Truth(drive=((1.0, 0.0), (0.3, 1.0)), coulomb=(0.4, 0.2), load=0.4), "elbow", "shoulder", 0.3),
    ],
)
def test_motors_of_other_joints_are_named(
    arm: TwinSpec, truth: Truth, joint: str, motor: str, ratio: float, seed: int
) -> None:
    """With how much torque they add, friction and a load beside."""
    told = {(where, by): size for where, by, size in tell(arm, truth, seed)}
    assert told[joint, motor] == pytest.approx(ratio, rel=0.1)


@pytest.mark.parametrize(
    "truth",
    [
        Truth(), Truth(gain=(0.7, 1.3)), Truth(gain=(-1.0, 1.0)), Truth(coulomb=(0.6, 0.3), viscous=(0.3, 0.2)),
        Truth(load=2.4), Truth(heavier=(1.5, 2.0)), Truth(rotor=0.3),
        Truth(gain=(0.8, 1.2), coulomb=(0.4, 0.2), load=0.5, rotor=0.05),
    ],
)  # fmt: skip
def test_a_serial_arm_gives_no_hint(arm: TwinSpec, truth: Truth) -> None:
    """Whatever is wrong with its masses, friction, gains and rotors."""
    assert tell(arm, truth, 3) == []


def test_servos_and_equal_commands_give_no_hint(arm: TwinSpec, tmp_path_factory: pytest.TempPathFactory) -> None:
    """An arm with servos and a weight in its hand; motors that are asked for one and the same."""
    servos = load_twin(servo_arm.write_twin(tmp_path_factory.mktemp("servo_arm")))
    motion = servo_arm.move({"forearm.payload": {"mass": 0.1}, "elbow.coulomb": {"torque": 0.1}}, 10.0, 1)
    assert describe_other_motors(servos, [read_measurements(servos, motion)]) == []
    flight = swing_arm(Truth(load=0.5), 8.0, 1)
    same = flight.joints["/efforts"]["m_shoulder"]
    efforts = {
        name: Stream(same.time, {"effort": same["effort"] * np.ones(len(same))}) for name in ("m_shoulder", "m_elbow")
    }
    both = replace(flight, joints={**flight.joints, "/efforts": efforts})
    assert describe_other_motors(arm, [read_measurements(arm, both)]) == []


@pytest.mark.slow
def test_the_verdict_begins_with_it(arm: TwinSpec) -> None:
    """Before whatever gain or inertia stands for it."""
    verdict = diagnose(arm, [swing_arm(Truth(drive=BELT), 10.0, 4)]).verdict
    assert verdict.warnings[0].startswith("what joint elbow's model lacks follows motor shoulder: 0.8 N m per N m")
