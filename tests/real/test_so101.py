"""A measured hobby arm (SO-101): its motion predicted from commands alone, without a torque.

Every second motion of the folder trains, the others are unseen. The bounds are those that the
project set for motions of the same arm.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

from cosim.servo.engine import FINE_SUBSTEP, JointEngine
from cosim.servo.fit import JointProblem
from cosim.servo.record import ServoRecord, read_servo_records
from hesr_model.fitting.estimator import estimator
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot

SO101 = Path(__file__).parents[3] / "shared" / "examples" / "so101"
pytestmark = [
    pytest.mark.nightly("real"),
    pytest.mark.skipif(not SO101.is_dir(), reason="needs the logs in ../shared/examples"),
]
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
LAW = "bam_m3"
# RMS of all unseen motions, and of the median motion [rad].
BOUNDS = {
    "shoulder_lift": (16e-3, 5.5e-3),
    "elbow_flex": (20e-3, None),
    "wrist_flex": (7.5e-3, 4e-3),
}


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[ServoRecord]]:
    """Return the records of each joint, by name."""
    columns = {
        signal: [f"{signal}_{number}" for number in range(1, len(JOINTS) + 1)]
        for signal in ("q", "dq", "q_cmd")
    }
    lines = [f"{signal} = {names}" for signal, names in columns.items()]
    file = tmp_path_factory.mktemp("so101") / "robot.toml"
    file.write_text(
        f'name = "so101"\nmodel = "{SO101 / "so101.urdf"}"\njoints = {list(JOINTS)}\n'
        "[log.columns]\n" + "\n".join(lines)
    )
    robot = Robot(file)
    logs = [Log.read(path, robot) for path in sorted(SO101.glob("*.csv.gz"))]
    by_joint = read_servo_records(logs, robot, robot.nominal_parameters)
    return dict(zip(JOINTS, by_joint, strict=True))


@pytest.mark.parametrize("joint", BOUNDS)
def test_unseen_motions_follow_from_commands(
    joint: str, records: dict[str, list[ServoRecord]]
) -> None:
    training, unseen = records[joint][0::2], records[joint][1::2]
    with JointProblem(training, estimator(LAW)) as problem:
        fit = problem.fit()
    with JointEngine(fit.law) as engine:
        errors = [
            engine.run(record, fit.servo, fit.law.values, substep=FINE_SUBSTEP) - record.q
            for record in unseen
        ]
    by_motion = [float(np.sqrt(np.mean(error**2))) for error in errors]
    total = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    median = float(np.median(by_motion))
    sys.stdout.write(f"{joint}: {1e3 * total:.2f} mrad, median {1e3 * median:.2f} mrad\n")
    most, most_of_median = BOUNDS[joint]
    assert total < most
    if most_of_median is not None:
        assert median < most_of_median
