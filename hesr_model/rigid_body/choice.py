"""Choice of the rigid body by rows that did not identify it.

The masses of the model file, physically possible ones and those of plain least squares are each
identified without every fold in turn, with Coulomb, viscous and offset friction, and judged on it.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from hesr_model.errors import FitError
from hesr_model.inference.folds import MIN_FOLDS, Fold, split_into_folds, thin
from hesr_model.logs.robot_log import Log, require_moving
from hesr_model.logs.signals import Motion, smooth_logs
from hesr_model.rigid_body import extrapolation, observations
from hesr_model.rigid_body.identification import Kind, RigidBody, fix_parameters, identify_motions
from hesr_model.robots.robot import LINK_PARAMETERS, Robot
from hesr_model.support.arrays import Array, Mask

BodyOption = Literal["choose", Kind]
KINDS: tuple[Kind, ...] = get_args(Kind)
_NAMES: Mapping[Kind, str] = {
    "nominal": "the model file's as it is",
    "physical": "physically possible",
    "free": "free",
}
_ERROR_NAMES: Mapping[Kind, str] = {
    "nominal": "the model file's",
    "physical": "a physically possible one's",
    "free": "a free one's",
}
_MIN_SECONDS = 3.0  # of motion; less has no folds
_CLEAR = 2.0  # standard errors over folds
_MAX_FREE_RATIO = 0.9  # error of a free body over that of a possible one, to be preferred
_ROUNDING = 1e-4  # share of the torque, below which errors are equal


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyChoice:
    """The rigid body that predicts rows best that did not identify it.

    Attributes
    ----------
    kind : of the body.
    body : identified from all rows.
    left_out_rmse : by kind that is possible, (n,) [N.m] at friction coordinates, over the rows of
        all folds; empty without folds.
    fold_bodies : by kind that is possible, the body identified without each fold; None where its
        training rows do not determine it.
    reasons : why the other kinds are not possible.
    sentence : the choice in words.
    """

    kind: Kind
    body: RigidBody
    left_out_rmse: Mapping[Kind, Array]
    fold_bodies: Mapping[Kind, Sequence[RigidBody | None]]
    reasons: Mapping[Kind, str]
    sentence: str


def choose_body(
    motions: Sequence[Motion],
    robot: Robot,
    *,
    reversed_motions: Sequence[Motion] = (),
    folds: Sequence[Fold] | None = None,
    kinds: Sequence[Kind] = KINDS,
) -> BodyChoice:
    """Choose the kind of rigid body that predicts left-out rows best, and identify it from all.

    The error of a kind is the RMSE of torque without body and Coulomb, viscous and offset friction,
    over the moving rows of all folds; its score is the mean over joints of the logarithm. The
    lowest wins, but ``"free"`` must beat ``"physical"`` by a tenth and two standard errors, and
    ``"nominal"`` if ``"physical"`` is impossible. Its standard error at other positions must not
    exceed its error on any joint. None is worse than ``"nominal"`` on the joint with the largest
    torque by two standard errors, nor in the mean at other positions (`extrapolation`).

    Parameters
    ----------
    motions : smooth logs, or their parts between gaps.
    robot : with the masses of its model file.
    reversed_motions : further logs, such as time-reversed counterparts.
    folds : of `motions` and `reversed_motions`, in this order; by default five.
    kinds : those to choose from.

    Raises
    ------
    FitError
        If the logs determine none of the kinds.
    """
    all_motions = [*motions, *reversed_motions]
    if folds is None:
        folds = split_into_folds(all_motions)
    samples = _build_samples(all_motions, robot, folds)
    trials = {kind: _try_kind(kind, folds, samples, robot) for kind in kinds}
    reasons = {kind: trial.reason for kind, trial in trials.items() if trial.reason}
    seconds = sum(float(motion.t[-1] - motion.t[0]) for motion in all_motions)
    judged = _Judged()
    if seconds >= _MIN_SECONDS:
        judged = _find_judged(trials)
    if judged.kinds:
        torque = _compute_torque_size(samples)
        table = _ErrorTable.from_trials(trials, judged, samples, torque)
        table = _add_extrapolation(table, trials, judged, all_motions, robot)
        kind = _choose_kind(table, is_physical_possible="physical" not in reasons)
        body = identify_kind(motions, robot, kind, reversed_motions=reversed_motions)
        body = replace(body, left_out_rmse=table.rmse[kind])
        rmse = table.rmse
        sentence = _describe_choice(kind, table, seconds)
    else:
        kind, body = _identify_first_possible(motions, robot, kinds, reversed_motions, reasons)
        rmse = {}
        sentence = f"Rigid body: {_NAMES[kind]}; the logs ({seconds:.3g} s) are too short to judge."
    sentence = " ".join([sentence, *describe_held(body, robot)])
    return BodyChoice(
        kind=kind,
        body=replace(body, sentence=sentence),
        left_out_rmse=rmse,
        fold_bodies={kind: trial.bodies for kind, trial in trials.items()},
        reasons=reasons,
        sentence=sentence,
    )


def identify_from_logs(
    logs: Sequence[Log],
    robot: Robot,
    option: BodyOption = "choose",
    *,
    reversed_logs: Sequence[Log] = (),
) -> RigidBody:
    """Identify a rigid body of the stated or chosen kind from logs.

    Errors are those of `identification.identify`.
    """
    require_moving([*logs, *reversed_logs], robot.description.joints)
    motions = smooth_logs(logs, robot)
    reversed_motions = smooth_logs(reversed_logs, robot)
    if option == "choose":
        return choose_body(motions, robot, reversed_motions=reversed_motions).body
    body = identify_kind(motions, robot, option, reversed_motions=reversed_motions)
    sentences = [describe_kind(option), *describe_held(body, robot)]
    return replace(body, sentence=" ".join(sentences))


def identify_kind(
    motions: Sequence[Motion],
    robot: Robot,
    kind: Kind,
    *,
    reversed_motions: Sequence[Motion] = (),
    warns: bool = True,
) -> RigidBody:
    """Identify a rigid body of a kind; errors as `identification.identify_motions`.

    With ``"nominal"`` only springs, elastic gears and friction are identified.
    """
    if kind == "nominal":
        if not has_masses(robot):
            raise FitError(
                f"robot '{robot.name}': its model file has no masses; choose another 'body'."
            )
        inertial_names = robot.parameter_names[: robot.inertial]
        robot = fix_parameters(robot, inertial_names)
    body = identify_motions(
        motions,
        robot,
        reversed_motions=reversed_motions,
        physical=kind == "physical",
        warns=warns,
    )
    return replace(body, kind=kind)


def identify_without(
    fold: Fold,
    robot: Robot,
    body: RigidBody,
    logs: Collection[str] = (),
    *,
    reversed_logs: Collection[str] = (),
) -> RigidBody:
    """Return the rigid body that a fold does not judge, of the kind of a body.

    Parameters
    ----------
    fold : whose training part identifies it.
    body : of all rows; it is returned if the training part does not determine one.
    logs : names of the logs that identify it; by default all.
    reversed_logs : names of their time-reversed counterparts.
    """
    pieces = [thin(piece) for piece in fold.training]
    motions = [piece for piece in pieces if not logs or piece.name in logs]
    reversed_motions = [piece for piece in pieces if piece.name in reversed_logs]
    try:
        return identify_kind(
            motions, robot, body.kind, reversed_motions=reversed_motions, warns=False
        )
    except FitError:
        return body


def has_masses(robot: Robot) -> bool:
    """Return whether the model file has a mass for any link."""
    link_count = robot.links
    masses = robot.nominal_parameters[: 10 * link_count : len(LINK_PARAMETERS)]
    return bool(np.any(masses > 0.0))


def describe_kind(kind: Kind) -> str:
    """Return the sentence of a kind that was not chosen but stated."""
    return f"Rigid body: {_NAMES[kind]}."


def describe_held(body: RigidBody, robot: Robot) -> list[str]:
    """Return the sentence about parameters that are held at the model file's values, if any."""
    if not body.held:
        return []
    values = dict(zip(robot.parameter_names, robot.nominal_parameters, strict=True))
    value_texts = []
    for name in body.held:
        unit = "kg" if name.endswith(".m") else "kg.m2"
        value_texts.append(f"{values[name]:.4g} {unit}")
    verb = "is" if len(value_texts) == 1 else "are"
    return [
        f"The motion does not determine {', '.join(body.held)}; the model file's "
        f"{', '.join(value_texts)} {verb} used."
    ]


def _identify_first_possible(
    motions: Sequence[Motion],
    robot: Robot,
    kinds: Sequence[Kind],
    reversed_motions: Sequence[Motion],
    reasons: dict[Kind, str],
) -> tuple[Kind, RigidBody]:
    """Return the first kind that all rows determine, the model file's masses before others.

    They are what the user already has, and nothing shows that others are better.
    """
    errors = []
    for kind in KINDS:
        if kind not in kinds:
            continue
        try:
            body = identify_kind(motions, robot, kind, reversed_motions=reversed_motions)
        except FitError as error:
            errors.append(error)
            reasons[kind] = str(error)
        else:
            reasons.pop(kind, None)
            return kind, body
    raise errors[-1]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Samples:
    """The thinned judged rows of a fold, at friction coordinates, (N, n) each."""

    motions: Sequence[Motion]
    dq: Array
    tau: Array
    is_moving: Mask


def _build_samples(
    motions: Sequence[Motion], robot: Robot, folds: Sequence[Fold]
) -> list[_Samples]:
    """Return the judged rows of each fold.

    Only moving rows are judged: at rest, friction of either sign hides the load.
    """
    min_speeds = observations.find_min_speeds(motions, robot)
    samples = []
    for fold in folds:
        pairs = zip(motions, fold.judged, strict=True)
        # The median step of a single row is unknown.
        parts = [thin(motion.rows(rows)) for motion, rows in pairs if np.sum(rows) > 1]
        dq = np.zeros((0, robot.n))
        tau = np.zeros((0, robot.n))
        if parts:
            dq = observations.friction_speeds(parts, robot)
            tau = np.concatenate([motion.tau for motion in parts])
        samples.append(
            _Samples(
                motions=parts,
                dq=dq,
                tau=_to_friction_torque(tau, robot),
                is_moving=np.abs(dq) > min_speeds,
            )
        )
    return samples


def _to_friction_torque(torque: Array, robot: Robot) -> Array:
    """Return the torque (N, n) at friction coordinates."""
    coupling = robot.description.coupling
    if coupling is None:
        return torque
    return coupling.torque(torque)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Trial:
    """Bodies of a kind without each fold, and their sums of squares (folds, n) on it."""

    bodies: Sequence[RigidBody | None]
    squares: Array
    reason: str  # why the kind is impossible, if it is on all folds


def _try_kind(
    kind: Kind, folds: Sequence[Fold], samples: Sequence[_Samples], robot: Robot
) -> _Trial:
    """Identify a kind without each fold, and judge it there."""
    bodies: list[RigidBody | None] = []
    squares = np.full((len(folds), robot.n), np.nan)
    reason = "no fold leaves rows to identify it from"
    for number, (fold, fold_samples) in enumerate(zip(folds, samples, strict=True)):
        training = [thin(piece) for piece in fold.training]
        body = None
        if training:
            try:
                body = identify_kind(training, robot, kind, warns=False)
            except FitError as error:
                reason = str(error)
        bodies.append(body)
        if body is not None:
            friction = fit_friction(body, training, robot)
            squares[number] = _sum_squares(body, friction, fold_samples, robot)
    if any(body is not None for body in bodies):
        reason = ""
    return _Trial(bodies=bodies, squares=squares, reason=reason)


def fit_friction(body: RigidBody, motions: Sequence[Motion], robot: Robot) -> Array:
    """Return Coulomb and viscous friction, not negative, and offset of each joint, (n, 3)."""
    from scipy.optimize import nnls  # slow to import

    dq = observations.friction_speeds(motions, robot)
    residual = np.concatenate([motion.tau - body.torque(robot, motion) for motion in motions])
    residual = _to_friction_torque(residual, robot)
    is_determined = observations.find_determined_friction(motions, robot)
    friction = np.zeros((robot.n, 3))
    for j, is_fast in enumerate(observations.find_fast_rows(motions, robot)):
        if not np.any(is_determined[j]):
            continue
        coulomb, viscous, offset = observations.stack_friction(dq[is_fast, j]).T
        # The offset has either sign.
        columns = np.column_stack([coulomb, viscous, offset, -offset])
        is_used = is_determined[j][[0, 1, 2, 2]]
        coefficients = np.zeros(4)
        coefficients[is_used], _ = nnls(columns[:, is_used], residual[is_fast, j])
        friction[j] = *coefficients[:2], coefficients[2] - coefficients[3]
    return friction


def _sum_squares(body: RigidBody, friction: Array, samples: _Samples, robot: Robot) -> Array:
    """Return the sum of squared errors (n,) over the moving rows of a fold."""
    if not samples.motions:
        return np.zeros(robot.n)
    torque = np.concatenate([body.torque(robot, motion) for motion in samples.motions])
    coulomb, viscous, offset = friction.T
    predicted = coulomb * np.sign(samples.dq) + viscous * samples.dq + offset
    error = samples.tau - _to_friction_torque(torque, robot) - predicted
    return np.asarray(np.sum(error**2 * samples.is_moving, axis=0))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Judged:
    """Kinds that can be compared, and the folds on which all of them have a body."""

    kinds: Sequence[Kind] = ()
    folds: Sequence[int] = ()


def _find_judged(trials: Mapping[Kind, _Trial]) -> _Judged:
    """Return the kinds with enough folds, and their common folds; nothing if too few."""
    has_body = {}
    for kind, trial in trials.items():
        has_body[kind] = np.array([body is not None for body in trial.bodies])
    judged_kinds = [kind for kind in trials if np.sum(has_body[kind]) >= MIN_FOLDS]
    if not judged_kinds:
        return _Judged()
    is_common = np.all([has_body[kind] for kind in judged_kinds], axis=0)
    if np.sum(is_common) < MIN_FOLDS:
        return _Judged()
    return _Judged(kinds=judged_kinds, folds=np.flatnonzero(is_common).tolist())


def _compute_torque_size(samples: Sequence[_Samples]) -> Array:
    """Return the RMS torque (n,) [N.m] of the judged rows."""
    tau = np.concatenate([fold_samples.tau for fold_samples in samples])
    return np.asarray(np.sqrt(np.mean(tau**2, axis=0)))


@dataclass(frozen=True, kw_only=True, eq=False)
class _ErrorTable:
    """Errors of the kinds on their common folds."""

    rmse: dict[Kind, Array]  # (n,)
    scores: dict[Kind, float]  # mean over joints of the logarithm of the error
    fold_logs: dict[Kind, Array]  # (folds, n) logarithms of the errors
    largest_joint: int  # with the largest torque
    other_errors: Mapping[Kind, Array] = field(default_factory=dict)  # (n,) at other positions
    other_ratios: Mapping[Kind, float] = field(default_factory=dict)  # to the model file's, there

    @classmethod
    def from_trials(
        cls,
        trials: Mapping[Kind, _Trial],
        judged: _Judged,
        samples: Sequence[_Samples],
        torque: Array,
    ) -> "_ErrorTable":
        """Return the table of all judged kinds; `torque` (n,) is its size."""
        folds = list(judged.folds)
        counts = np.array([np.sum(samples[number].is_moving, axis=0) for number in folds])
        floor = np.maximum(_ROUNDING * torque, np.finfo(float).tiny)
        rmse: dict[Kind, Array] = {}
        scores: dict[Kind, float] = {}
        fold_logs: dict[Kind, Array] = {}
        for kind in judged.kinds:
            squares = trials[kind].squares[folds]
            errors = np.sqrt(squares.sum(axis=0) / np.maximum(counts.sum(axis=0), 1))
            rmse[kind] = np.maximum(errors, floor)
            scores[kind] = float(np.mean(np.log(rmse[kind])))
            fold_errors = np.sqrt(squares / np.maximum(counts, 1))
            fold_logs[kind] = np.log(np.maximum(fold_errors, floor))
        return cls(
            rmse=rmse,
            scores=scores,
            fold_logs=fold_logs,
            largest_joint=int(np.argmax(torque)),
        )

    def fold_scores(self, kind: Kind) -> Array:
        """Return the score of a kind on each fold (folds,)."""
        return np.asarray(np.mean(self.fold_logs[kind], axis=1))

    def beats(self, kind: Kind, other: Kind) -> bool:
        """Return whether a kind is better than another by two standard errors and a tenth.

        A free body absorbs friction that Coulomb and viscous friction do not describe: on draws of
        a twin it is better by 1 to 8 % on left-out blocks, and up to four times worse on other
        motions.
        """
        std_error = _compute_std_error(self.fold_scores(kind) - self.fold_scores(other))
        gain = self.scores[other] - self.scores[kind]
        return bool(gain > max(_CLEAR * std_error, -np.log(_MAX_FREE_RATIO)))

    def is_determined(self, kind: Kind) -> bool:
        """Return whether the standard error at other positions is below the error on all joints."""
        if kind not in self.other_errors:
            return True
        return bool(np.all(self.other_errors[kind] <= self.rmse[kind]))

    def is_safe(self, kind: Kind) -> bool:
        """Return whether a kind is not worse than the model file, here and at other positions.

        Where torque is largest, it may be by two standard errors over folds: with one, 5 % on one
        joint outweigh an error that is 0.6 in the mean of all (TIAGo).
        """
        if "nominal" not in self.rmse:
            return True
        if self.other_ratios.get(kind, 1.0) > 1.0:
            return False
        j = self.largest_joint
        std_error = _compute_std_error(self.fold_logs[kind][:, j] - self.fold_logs["nominal"][:, j])
        excess = np.log(self.rmse[kind][j] / self.rmse["nominal"][j])
        return bool(excess <= _CLEAR * std_error)


def _add_extrapolation(
    table: _ErrorTable,
    trials: Mapping[Kind, _Trial],
    judged: _Judged,
    motions: Sequence[Motion],
    robot: Robot,
) -> _ErrorTable:
    """Return the table with errors at positions that the logs did not visit.

    Behind elastic gears these are positions of links, which no random position has.
    """
    if any(motion.q_link is not None for motion in motions):
        return table
    states = extrapolation.States.from_motions(motions, robot)
    bodies: dict[Kind, list[RigidBody]] = {}
    errors: dict[Kind, Array] = {}
    for kind in judged.kinds:
        fold_bodies = [trials[kind].bodies[k] for k in judged.folds]
        bodies[kind] = [body for body in fold_bodies if body is not None]
        if kind != "nominal":
            errors[kind] = extrapolation.compute_standard_errors(bodies[kind], robot, states)
    ratios: dict[Kind, float] = {}
    if "nominal" in judged.kinds:
        for kind in errors:
            joint_ratios = extrapolation.estimate_ratios(
                bodies[kind],
                bodies["nominal"],
                table.rmse[kind],
                table.rmse["nominal"],
                robot,
                states,
            )
            ratios[kind] = float(np.exp(np.mean(np.log(joint_ratios))))
    return replace(table, other_errors=errors, other_ratios=ratios)


def _compute_std_error(differences: Array) -> float:
    """Return the standard error of the mean of differences (folds,)."""
    return float(np.std(differences, ddof=1)) / float(np.sqrt(len(differences)))


def _choose_kind(table: _ErrorTable, *, is_physical_possible: bool) -> Kind:
    """Return the kind with the lowest score, by the rules of `choose_body`."""
    safe_kinds = [kind for kind in table.scores if table.is_safe(kind)]
    best_kind = min(safe_kinds, key=lambda kind: table.scores[kind])
    if best_kind != "free":
        return best_kind
    # Plain least squares has the most parameters, and must be better than by chance.
    simpler_kind: Kind = "physical" if is_physical_possible else "nominal"
    if simpler_kind not in safe_kinds:
        return best_kind
    if table.is_determined("free") and table.beats("free", simpler_kind):
        return best_kind
    return simpler_kind


def _describe_choice(kind: Kind, table: _ErrorTable, seconds: float) -> str:
    """Return the sentence of a choice by left-out rows."""
    ratios: dict[Kind, float] = {}
    for other, score in table.scores.items():
        if other != kind:
            ratios[other] = float(np.exp(score - table.scores[kind]))
    if not ratios:
        return describe_kind(kind)
    better_kinds = [other for other, ratio in ratios.items() if ratio < 1.0]
    if kind == "nominal" and better_kinds:
        best_kind = min(better_kinds, key=lambda other: ratios[other])
        return (
            f"{describe_kind(kind)} {_ERROR_NAMES[best_kind].capitalize()} error is "
            f"{ratios[best_kind]:.2f} of its own on left-out blocks, but the motion does not "
            "confirm it at other positions."
        )
    if kind == "nominal":
        ratio_texts = [f"{other}: {ratio:.2g} times its error" for other, ratio in ratios.items()]
        return (
            f"Rigid body: {_NAMES[kind]}; the logs ({seconds:.3g} s) determine no better one "
            f"({', '.join(ratio_texts)})."
        )
    ratio_texts = [f"{1.0 / ratio:.2f} of {_ERROR_NAMES[other]}" for other, ratio in ratios.items()]
    return f"Rigid body: {_NAMES[kind]}, by left-out blocks: error {', '.join(ratio_texts)}."
