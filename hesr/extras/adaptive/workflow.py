"""The command `monitor`."""

from __future__ import annotations

from typing import TYPE_CHECKING, overload

from cosim.workflow.answer import Answer
from hesr_model.errors import ArgumentError
from hesr_model.support.progress import Stages, silent

if TYPE_CHECKING:
    from cosim.workflow.arguments import BodyArg, LawArg, Logs, Names, RobotArg
    from hesr.extras.adaptive.page import Monitoring
    from hesr_model.support.files import PathArg


@overload
def monitor(
    logs: Logs,
    *,
    law: LawArg,
    robot: RobotArg | None = None,
    rigid_body: BodyArg | None = None,
    output: PathArg | None = None,
    accept: Names = (),
    progress: Stages = silent,
) -> Monitoring: ...


@overload
def monitor(
    logs: PathArg,
    *,
    output: PathArg | None = None,
    workers: int | None = None,
    progress: Stages = silent,
) -> Answer: ...


def monitor(
    logs: Logs,
    *,
    law: LawArg | None = None,
    robot: RobotArg | None = None,
    rigid_body: BodyArg | None = None,
    output: PathArg | None = None,
    workers: int | None = None,
    accept: Names = (),
    progress: Stages = silent,
) -> Answer:
    r"""Find changes of friction over days, and deviating robots.

    An interrupted fleet continues where it stopped, and processes only new
    logs.

    Parameters
    ----------
    logs : log or sequence of logs
        Logs of one robot in the order of time, or one fleet file (.toml).
    law : path or law, optional
        Friction model fitted to other logs of the robot.
    robot : robot or path, optional
        Robot file (.toml), URDF or MJCF; by default the robot of the logs.
    rigid_body : body or path, optional
        Result of `identify`; by default identified from the logs.
    output : path, optional
        Page to write; for a fleet, the folder (default: results/NAME).
    workers : int, optional
        Processes of a fleet; by default one per core.
    accept : str or sequence of str, optional
        Names of checks whose errors only warn.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    Monitoring or Fleet
        Alarms with their likely causes and the state of each joint; or
        deviations and changes.

    Raises
    ------
    HesrError
        If a log, the robot, the law or the fleet file is unusable.

    Examples
    --------
    On the command line::

        $ hesr monitor monday.csv tuesday.csv --law law.json \
          --robot robot.toml --rigid-body rigid_body.json -o page.html
        $ hesr monitor fleet.toml -o results/fleet

    >>> import hesr
    >>> log = hesr.Log.read("my_arm/logs/sample_test.csv", "my_arm/robot.toml")
    >>> hesr.monitor(log, law="law.json", rigid_body="rigid_body.json").passed
    True
    """
    from dataclasses import replace
    from pathlib import Path

    from cosim.report.result_page import write_answer
    from cosim.workflow.answer import find_job
    from cosim.workflow.arguments import (
        find_body,
        list_logs,
        list_names,
        read_checked_logs,
        read_model,
        require_items,
        to_optional_output,
        to_optional_path,
    )
    from hesr.extras.adaptive.monitor import watch
    from hesr.extras.adaptive.page import Monitoring

    sources = list_logs("logs", logs)
    accepted = list_names("accept", accept)
    require_items("logs", sources)
    first_source = sources[0]
    job = None
    if isinstance(first_source, Path):
        job = find_job(first_source, "monitor")
    if job is not None:
        if len(sources) > 1 or law or robot or rigid_body or accepted:
            raise ArgumentError(f"{first_source}: a fleet file names its own logs; give it alone.")
        return job.run(
            first_source,
            output=to_optional_path("output", output),
            workers=workers,
            progress=progress,
        )
    if law is None:
        raise ArgumentError("'law' is missing; give a friction model of other logs.")
    if workers is not None:
        raise ArgumentError("'workers' is for a fleet file.")
    page_path = to_optional_output("output", output)
    model = read_model(law)
    checked_logs = read_checked_logs(sources, robot, accepted, progress)
    records = checked_logs.compute_records(
        find_body(rigid_body, checked_logs.logs, checked_logs.robot)
    )
    progress("following friction", 0, 1)
    answer = Monitoring(**vars(watch(model, records)), findings=checked_logs.findings)
    if page_path is None:
        return answer
    write_answer(answer, page_path)
    return replace(answer, files=[page_path])
