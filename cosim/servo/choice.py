"""Choice of the law of each joint from commands, by motion that no fit has seen.

Whole logs run from their commands; the rows of a fold do not count in the fit that is judged on
them. What is compared is the error of positions.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from cosim.servo.fit import JointProblem
from cosim.servo.joint_fit import JointFit
from cosim.servo.model import find_common_latency, finish_model, require_suitable
from cosim.servo.record import ServoRecord, read_servo_records
from cosim.servo.start import delay_commands
from cosim.study.verdict import describe_choice
from hesr_model.audit.certificate import has_proof
from hesr_model.errors import FitError
from hesr_model.fitting.estimator import estimator, select_laws
from hesr_model.friction.model import FrictionModel
from hesr_model.inference.choice import CHOOSE, choose_laws, is_better
from hesr_model.inference.folds import FOLD_COUNT, number_rows
from hesr_model.inference.left_out import LeftOutErrors
from hesr_model.laws.baselines import Constant, CoulombViscous, NoFriction
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot
from hesr_model.robots.servo_description import ServoKind
from hesr_model.support import parallel
from hesr_model.support.arrays import Array, Integers
from hesr_model.support.progress import Progress, silent

FROM_COMMANDS = "from_commands"  # fact of the laws that are tried
_CONFOUNDED = 1.5  # greatest gain over the smallest of equally good laws


@dataclass(frozen=True, kw_only=True, eq=False)
class _Judgement:
    """A fit to all rows, and the position errors (N,) on left-out ones."""

    fit: JointFit
    errors: Array


def choose_from_commands(
    logs: Sequence[Log],
    robot: Robot,
    laws: Sequence[str] = (),
    *,
    provenance: Mapping[str, Any] | None = None,
    workers: int | None = None,
    progress: Progress = silent,
) -> FrictionModel:
    """Fit laws and servos to commands, and return the law of each joint that predicts best.

    Parameters
    ----------
    logs : logs with commanded positions.
    robot : robot of the logs.
    laws : tried in addition to the baselines, the simplest first; by default some without memory.
    provenance : JSON data on the origin of the model.
    workers : processes, by default one per core.
    progress : called with fits done and in total.

    Raises
    ------
    FitError
        If no law can be fitted to a joint, or commands do not explain its motion.
    """
    candidates = _list_laws(laws)
    records = read_servo_records(logs, robot, robot.nominal_parameters)
    fold_of_row = _number_folds(records[0])
    judged = _judge_all(records, robot, candidates, np.concatenate(fold_of_row), workers, progress)
    latency = find_common_latency([joint[CoulombViscous.name].fit for joint in judged])
    fitted_laws = _find_common_laws(candidates, judged)
    errors = _collect_errors(records, judged, fitted_laws, fold_of_row, latency[0])
    choice = choose_laws(
        _keep_simple_laws(errors, fitted_laws),
        is_proven=lambda law, j: has_proof(judged[j][_to_fitted_law(law)].fit.law),
        can_join=lambda *_: True,  # none has memory that needs an integration of its own
    )
    chosen_fits = [
        joint[_to_fitted_law(law)].fit for law, joint in zip(choice.laws, judged, strict=True)
    ]
    model = finish_model(
        records,
        robot,
        chosen_fits,
        provenance=provenance or {},
        workers=workers,
        report=lambda *_: None,
        latency=latency,
    )
    sentences = [*describe_choice(choice), *_describe_ties(errors, judged, choice.laws)]
    return replace(model, provenance={**model.provenance, CHOOSE: sentences})


def _number_folds(joint_records: Sequence[ServoRecord]) -> list[Integers]:
    """Return the fold of each row (N,) of each log."""
    names = [record.log for record in joint_records]
    times = [record.t for record in joint_records]
    return [numbers.astype(int) for numbers in number_rows(names, times, FOLD_COUNT)]


def _find_common_laws(laws: Iterable[str], judged: Sequence[Mapping[str, _Judgement]]) -> list[str]:
    """Return the laws that could be fitted to all joints."""
    fitted_to_all = set.intersection(*map(set, judged))
    return [law for law in laws if law in fitted_to_all]


def _describe_ties(
    errors: LeftOutErrors, judged: Sequence[Mapping[str, _Judgement]], chosen: Sequence[str]
) -> Iterator[str]:
    """Yield a sentence where three numbers suffice, and where equally good laws differ in gain."""
    for j, joint in enumerate(errors.joints):
        if chosen[j] == CoulombViscous.name:
            yield f"{joint}: no law beats frictionloss, damping and armature on this log."
        equal_fits = [
            judged[j][law].fit for law in judged[j] if not is_better(errors, chosen[j], law, j)
        ]
        factors = [fit.servo.body_factor for fit in equal_fits if fit.servo.body_factor > 0.0]
        if factors and max(factors) > _CONFOUNDED * min(factors):
            yield (
                f"{joint}: gain and friction are confounded in this log: equally good laws "
                f"have gains of {1.0 / max(factors):.3g} to {1.0 / min(factors):.3g} N.m/rad. "
                "Log motion against more gravity, or state servo.kp."
            )


def _list_laws(laws: Sequence[str]) -> list[str]:
    """Return the laws that are tried, the baselines first; raise FitError for one with memory."""
    for law in laws:
        require_suitable(law)
    baselines = (NoFriction.name, CoulombViscous.name)
    return list(dict.fromkeys([*baselines, *(laws or select_laws(FROM_COMMANDS))]))


def _keep_simple_laws(errors: LeftOutErrors, laws: Sequence[str]) -> LeftOutErrors:
    """Return the errors of the baselines, and of each joint's simplest law that none beats.

    Laws contain each other: the last ones predict as well as the true one, with coefficients that
    the motion does not determine.
    """
    simple_laws = {NoFriction.name, Constant.name, CoulombViscous.name}
    for j in range(len(errors.joints)):
        simple_laws.add(next(law for law in laws if not _is_beaten(errors, law, j)))
    simple_errors = {law: values for law, values in errors.errors.items() if law in simple_laws}
    return replace(errors, errors=simple_errors, joint_errors=simple_errors)


def _is_beaten(errors: LeftOutErrors, law: str, j: int) -> bool:
    """Return whether any law predicts a joint better than this one."""
    return any(is_better(errors, other, law, j) for other in errors.laws)


def _to_fitted_law(law: str) -> str:
    """Return the law that was fitted for a chosen one: no friction in place of an offset."""
    if law == Constant.name:
        return NoFriction.name
    return law


def _judge_all(
    records: Sequence[Sequence[ServoRecord]],
    robot: Robot,
    laws: Sequence[str],
    fold_of_row: Integers,
    workers: int | None,
    progress: Progress,
) -> list[dict[str, _Judgement]]:
    """Return the judgements of all laws that can be fitted, by joint."""
    kind = robot.description.servo.kind
    pairs = list(product(range(robot.n), laws))
    jobs = [partial(_judge, records[j], law, kind, fold_of_row) for j, law in pairs]
    judged: list[dict[str, _Judgement]] = [{} for _ in records]
    labels = [f"{robot.joints[j]}, {law}" for j, law in pairs]
    failures: dict[int, FitError] = {}
    with parallel.results_of(jobs, workers, names=labels) as answers:
        for done, ((j, law), answer) in enumerate(zip(pairs, answers, strict=True), start=1):
            progress(done, len(pairs))
            if isinstance(answer, FitError):
                failures.setdefault(j, answer)
            else:
                judged[j][law] = answer
    for j, joint in enumerate(judged):
        if CoulombViscous.name not in joint:
            raise failures[j]
    return judged


def _judge(
    records: Sequence[ServoRecord], law: str, kind: ServoKind, fold_of_row: Integers
) -> _Judgement | FitError:
    try:
        with threadpool_limits(1), JointProblem(records, estimator(law), kind) as problem:
            fit = problem.fit()
            return _Judgement(fit=fit, errors=problem.predict_left_out(fit, fold_of_row))
    except FitError as error:
        return error


def _collect_errors(
    records: Sequence[Sequence[ServoRecord]],
    judged: Sequence[Mapping[str, _Judgement]],
    laws: Sequence[str],
    fold_of_row: Sequence[Integers],
    latency: float,
) -> LeftOutErrors:
    """Return the position errors of all laws by log; the servo's own error is to be explained."""
    first = records[0]
    ends = np.cumsum([len(record.t) for record in first])[:-1]
    errors = {}
    for law in laws:
        columns = np.column_stack([joint[law].errors for joint in judged])
        errors[law] = tuple(np.split(columns, ends))
    errors[Constant.name] = errors[NoFriction.name]

    servo_errors = []
    speeds = []
    loads = []
    for log_records in zip(*records, strict=True):
        errors_by_joint = [delay_commands(record, latency) - record.q for record in log_records]
        servo_errors.append(np.column_stack(errors_by_joint))
        speeds.append(np.column_stack([record.dq for record in log_records]))
        loads.append(np.column_stack([record.tau_load for record in log_records]))
    return LeftOutErrors(
        joints=tuple(joint_records[0].joint for joint_records in records),
        t=tuple(record.t for record in first),
        log_names=tuple(record.log for record in first),
        fold_of_row=tuple(fold_of_row),
        errors=errors,
        joint_errors=errors,
        tau=tuple(servo_errors),
        dq=tuple(speeds),
        tau_load=tuple(loads),
        counts=np.ones((FOLD_COUNT, len(records)), dtype=bool),
        failed={},
    )
