"""Design of an excitation: setpoints and a picture."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from hesr_model.errors import ConfigError, HesrError
from hesr_model.logs.tables import write_table
from hesr_model.motions.excitation import Excitation, ExcitationSettings, condition, random_motions
from hesr_model.motions.excitation import design as design_excitation
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array
from hesr_model.support.files import written_together
from hesr_model.support.progress import Progress, silent

_COMPARED = 200
_TABLES = {".csv", ".parquet", ".pq"}


@dataclass(frozen=True, kw_only=True, eq=False)
class ExcitationDesign:
    """A designed excitation and its files."""

    excitation: Excitation
    random_condition: float  # median condition of W_b over 200 random motions
    forward: Path
    backward: Path  # time-reversed
    picture: Path


def design(
    robot: Path, output: Path, settings: Path | None = None, *, progress: Progress = silent
) -> ExcitationDesign:
    """Design an excitation; write setpoints `output`, ``<name>_reversed`` and ``<name>.png``.

    Columns are ``t, q1.., dq1.., ddq1..`` [s, rad, rad/s, rad/s2; m for prismatic joints].
    Collisions are not checked: position limits must exclude them.
    """
    from cosim.report.figures.motions import excitation

    if output.suffix.lower() not in _TABLES:
        raise ConfigError(
            f"{output}: the motion is written as a table; the suffix must be one of "
            f"{', '.join(sorted(_TABLES))}."
        )
    model = Robot(RobotDescription.read(robot))
    chosen = ExcitationSettings.read(settings) if settings else ExcitationSettings()
    try:
        found = design_excitation(model, chosen, progress=progress)
    except HesrError as error:
        raise type(error)(f"{settings or robot}: {error}") from error
    base = base_columns(model)
    with threadpool_limits(1):  # threads cost more than they save
        random = random_motions(model, chosen, _COMPARED, chosen.seed)
        conditions = [condition(model, base, motion) for motion in random]
    backward = output.with_stem(f"{output.stem}_reversed")
    picture = output.with_suffix(".png")
    t, q, dq, ddq = found.setpoints()
    with written_together(output) as file:
        _write(file(output), t, q, dq, ddq)
        _write(file(backward), t, q[::-1], -dq[::-1], ddq[::-1])
        excitation(file(picture), found, model.description.joints)
    return ExcitationDesign(
        excitation=found,
        random_condition=float(np.median(conditions)),
        forward=output,
        backward=backward,
        picture=picture,
    )


def _write(path: Path, t: Array, q: Array, dq: Array, ddq: Array) -> None:
    columns = {"t": t}
    for name, values in (("q", q), ("dq", dq), ("ddq", ddq)):
        columns |= {f"{name}{k}": column for k, column in enumerate(values.T, start=1)}
    write_table(path, columns)
