"""External torque over logs: `hesr.observe`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cosim.workflow.arguments import BodyArg, LawArg, Logs, RobotArg
    from hesr.extras.observer.calibration import ObservedLog


def observe(
    logs: Logs,
    *,
    law: LawArg,
    robot: RobotArg | None = None,
    rigid_body: BodyArg | None = None,
    calibration: Logs | None = None,
    bandwidth: float = 15.0,
    accept: Sequence[str] = (),
) -> list[ObservedLog]:
    """Compute the external torque over logs, with the numbers of the observer's FMU.

    Parameters
    ----------
    logs : log or sequence of logs
        Logs of one robot.
    law : path or law
        Friction model fitted to other logs of the robot.
    robot : robot or path, optional
        Robot file (.toml), URDF or MJCF; by default the robot of the logs.
    rigid_body : body or path, optional
        Result of 'hesr identify'; by default the parameters of the model file.
    calibration : log or sequence of logs, optional
        Logs without contact that the law was not fitted to; by default limits and threshold follow
        from the bands of the law.
    bandwidth : float, Hz
        Cut-off of the external torque.
    accept : sequence of str, optional
        Names of checks whose errors only warn.

    Returns
    -------
    list of ObservedLog
        For each part of a log without gaps, `outputs` by the names of the FMU, such as tau_ext
        (N, n) [N.m; N for prismatic joints], and `contact` (N,).

    Raises
    ------
    HesrError
        If a log, the robot, the law or the calibration is unusable.

    Notes
    -----
    The momentum observer of De Luca and Mattone (ICRA 2005), sampled exactly.

    Examples
    --------
    >>> import hesr
    >>> [found] = hesr.observe("pushed.csv", law="law.json", robot="robot.toml",
    ...                        rigid_body="rigid_body.json", calibration=["free.csv"])
    >>> found.outputs["tau_ext"].shape
    (2000, 3)
    """
    from cosim.workflow.arguments import checked_logs, logs_of, model_given, plant_body
    from hesr.extras.observer.calibration import calibrate, observed_logs
    from hesr.extras.observer.limits import law_limits

    model, read = model_given(law), checked_logs(logs, robot, accept)
    body = plant_body(read.robot, rigid_body)
    if calibration is None:
        limits = law_limits(model)
    else:
        limits = calibrate(model, body, logs_of(calibration, read.robot), bandwidth)
    return observed_logs(model, body, limits, read.logs, bandwidth)
