"""All that a study wants to know of a closed loop."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cosim.loop.closed_loop import Tracking
from cosim.loop.loops import (
    assemble,
    build,
    require_reachable,
    run_tracking,
    whole,
)
from cosim.loop.robustness import Overcompensation, run_overcompensation, run_sweeps
from cosim.loop.traces import TRACES, write_traces
from cosim.loop.tracking import Tracked
from cosim.systems.system import write_system
from fmu_src.arm.plant import Plant
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import RobotModel
from hesr_model.support.progress import Stages


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopOutcome:
    """What the closed loop of a study gave.

    Attributes
    ----------
    tracking : every law in every scheme, on all motions.
    long : some of them on a long motion, which shows drift.
    sweeps : some of them with a changed arm or controller.
    overcompensation : how much too much friction is borne.
    """

    tracking: Sequence[Tracked]
    long: Sequence[Tracked]
    sweeps: Sequence[Tracked]
    overcompensation: Sequence[Overcompensation]


def run_loop(
    tracking: Tracking,
    plant: Plant,
    robot: RobotModel,
    body: RigidBody,
    folder: Path,
    *,
    truth: FrictionModel,
    friction: Mapping[str, Path],
    kept: Path | None,
    progress: Stages,
) -> LoopOutcome:
    """Build the FMUs of a loop and run all that a study wants to know of it.

    Parameters
    ----------
    tracking : the study.
    plant : the arm.
    robot, body : rigid body that was identified.
    folder : of the results; the FMUs stand in fmus/ there, that of the arm as Arm.fmu. One loop of
        them is written there as closed_loop.toml, to be run or packaged, and the positions along
        the first motion as `TRACES`.
    truth : the arm's own friction.
    friction : FMU of each law.
    kept : folder in which finished rows are kept.
    progress : told how far it has come.
    """
    require_reachable(tracking, robot)
    progress("building the loop", 0, 1)
    fmus = folder / "fmus"
    build(fmus, robot, body, plant, oracle=truth)
    loop = assemble(fmus, tracking=tracking, friction=friction, plant=plant)
    write_system(whole(loop, robot), folder / "closed_loop.toml")
    progress("building the loop", 1, 1)
    tables, long = run_tracking(loop, robot, kept=kept, progress=progress)
    runs = [(t.scheme, t.law, t.trace) for t in tables if t.trace]
    write_traces(folder / TRACES, runs)
    return LoopOutcome(
        tracking=tables,
        long=long,
        sweeps=run_sweeps(loop, robot, body, fmus, known=tables, kept=kept, progress=progress),
        overcompensation=run_overcompensation(loop, robot, kept=kept, progress=progress),
    )
