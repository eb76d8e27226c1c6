"""Options of all export formats for type checkers; `hesr.export_types` writes this file."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Literal, TypedDict

if TYPE_CHECKING:
    from cosim.workflow.arguments import BodyArg, LogArg, PerJoint, RobotArg
    from hesr_model.support.files import PathArg


class ExportOptions(TypedDict, total=False):
    """Options of the formats of `export`."""

    fmi: Literal[2, 3]
    """adaptive, drive, fmu, observer and plant: Version of FMI; 3 has arrays, dq for dq[i]."""
    no_documentation: bool
    """adaptive and fmu: No page, picture and reference results, for pipelines; takes half the
    time."""
    inertia: PerJoint
    """drive: Inertia of the rotors, one value or one per joint.  [kg.m2]"""
    stiffness: PerJoint
    """drive: Stiffness of the flexsplines; by default rigid.  [N.m/rad]"""
    damping: PerJoint
    """drive: Damping of the flexsplines; by default 0.  [N.m.s/rad]"""
    ratio: PerJoint
    """drive: Turns of the motor per turn of the joint; by default 1."""
    rigid_body: BodyArg
    """drive: Result of 'hesr identify' with inertia, stiffness and damping of elastic gears.
    isaaclab, mjcf-joint, newton, sdf-dynamics and urdf-dynamics: Result of 'hesr identify' for
    'robot', which separates friction from the torque of logs; by default that of a law fitted
    in Python. observer and plant: Result of 'hesr identify' for 'robot'; by default the
    parameters of the model file."""
    properties: bool
    """fmu: Run the physics checks and add their table to the pages."""
    power: bool
    """fmu: Add the dissipated power as an output."""
    band: bool
    """fmu: Add the 95 % band of measured friction as outputs, and write coefficients and
    covariance as NAME.ssv."""
    low_pass: float
    """fmu: Cut-off of a causal low pass of the velocity; by default none.  [Hz]"""
    no_events: bool
    """fmu: No event indicators in model exchange; where a law jumps at reversals, the jump is a
    steep line below 0.001 rad/s."""
    robot: RobotArg
    """isaaclab, mjcf-joint, newton, observer, plant, sdf-dynamics and urdf-dynamics: The robot
    of the law."""
    log: LogArg | Iterable[LogArg]
    """isaaclab, mjcf-joint, newton, sdf-dynamics and urdf-dynamics: Logs at whose speeds and
    loads the numbers hold; as a rule those of the fit."""
    test_log: LogArg | Iterable[LogArg]
    """isaaclab, mjcf-joint, newton, sdf-dynamics and urdf-dynamics: Logs that decide on the
    price of the numbers; by default those of 'log'."""
    weight: Literal["rows", "power"]
    """isaaclab, mjcf-joint, newton, sdf-dynamics and urdf-dynamics: Equal weights of rows, or
    their speeds, which keep the dissipated energy."""
    kp: PerJoint
    """isaaclab, mjcf-joint, newton, sdf-dynamics and urdf-dynamics: Gains of servos, to state
    the price in positions as well; by default those of the robot file, or those that were
    fitted to commands.  [N.m/rad] plant: Gains of a position command of the servo; by default
    it has only a speed command.  [1/s]"""
    project: bool
    """mjcf: Approximate a law that MuJoCo cannot express exactly."""
    into: PathArg
    """mjcf-joint, sdf-dynamics and urdf-dynamics: Your model; a copy with the numbers is
    written, with all else byte for byte."""
    calibration: LogArg | Iterable[LogArg]
    """observer: Logs without contact that the law was not fitted to, or results of 'hesr run'
    for its test logs, which determine limits and threshold; repeatable; by default those follow
    from the bands of the law."""
    bandwidth: float
    """observer: Cut-off of the external torque; by default 15.  [Hz]"""
    torque_constants: PerJoint
    """observer: Torque of a joint per current; the inputs are then currents.  [N.m/A]"""
    kv: PerJoint
    """plant: Proportional gains of a servo with a speed command; by default no servo.
    [N.m.s/rad]"""
    ki: PerJoint
    """plant: Integral gains of the servo; by default 0.  [N.m/rad]"""
    tool: bool
    """plant: Add the pose of the last joint's frame as outputs."""
    signals: PathArg
    """fmu and python-arm of a robot: TOML file with inputs and outputs; by default every
    control and sensor, or torques, positions and speeds of its joints if it has none."""
    ssp: Literal["1.0", "2.0"]
    """ssp of a system: Version of SSP; by default 1.0."""
