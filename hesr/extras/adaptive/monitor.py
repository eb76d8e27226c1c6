"""Adaptive friction FMUs, and friction over days of logs: factors, alarms, likely causes."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fmu_src.export.package import Content, Version, check_request, write_fmu
from fmu_src.export.toolchain import HOST
from fmu_src.friction.discrete_fmu import THERMAL_LINES, add_documentation, discrete_equations
from fmu_src.friction.friction_fmu import build_bare_content, describe_friction_fmu
from fmu_src.friction.validity import require_numbers
from hesr.extras.adaptive.component import ADAPT, TUNING, Tuning, adaptive_component
from hesr.extras.adaptive.fmu_page import ADAPTIVE_NOTES, adaptive_lines
from hesr_model.audit.certificate import find_min_viscous_scale
from hesr_model.equations.component import Component, Parameter
from hesr_model.equations.stepping import Steps
from hesr_model.errors import SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import predict_record, rmse
from hesr_model.friction.thermal_law import build_inputs
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array
from hesr_model.support.progress import Progress, silent


def export_adaptive(
    model: FrictionModel,
    output: Path,
    *,
    platforms: Sequence[str] = HOST,
    progress: Progress = silent,
    fmi: Version = 2,
    no_documentation: bool = False,
) -> Path:
    """Write a friction model with stops or bristles as an adaptive FMU.

    With `no_documentation` it has neither page nor reference results.
    """
    check_request(output, platforms)
    content = adaptive_content(model, bare=no_documentation)
    return write_fmu(content, output, platforms=platforms, progress=progress, fmi=fmi)


def adaptive_content(model: FrictionModel, *, bare: bool = False) -> Content:
    """Return the adaptive FMU before compilation."""
    about = describe_friction_fmu(model, "adaptive", "that adapts to measured torques")
    equations = discrete_equations(model, adaptive_components(model), (ADAPT,))
    require_numbers(model)
    content = build_bare_content(model, about, *equations)
    if bare:
        return content
    lines = adaptive_lines(TUNING)
    if model.thermal:
        lines = (*THERMAL_LINES, *lines)
    return add_documentation(content, model, lines, ADAPTIVE_NOTES)


@dataclass(frozen=True, kw_only=True, eq=False)
class JointEstimates:
    """Estimates of one joint in one log, before the torque of each row is used."""

    record: FrictionRecord
    tau_fixed: Array  # torque of the law (N,) [N.m]
    outputs: dict[str, Array]  # (N,) by name


def adaptive_components(model: FrictionModel, tuning: Tuning = TUNING) -> tuple[Component, ...]:
    """Return the adaptive equations of each joint."""
    if model.coupling is not None:
        raise SimulationError(
            f"friction model '{model.law}': adaptation does not support coupled joints."
        )
    if not (model.trained and model.training_rmse):
        raise SimulationError(
            f"friction model '{model.law}': training ranges and errors are missing; fit it again."
        )
    thermal_models = model.thermal or (None,) * len(model.laws)
    components = []
    for j, law in enumerate(model.laws):
        joint_component = adaptive_component(
            law,
            tuning,
            noise=model.training_rmse[j],
            speed=model.trained[j].speed,
            min_viscosity=find_min_viscous_scale(law),
            thermal=thermal_models[j],
        )
        components.append(joint_component)
    return tuple(components)


class Follower:
    """Follows friction over logs; each starts from a share of the learned factors."""

    def __init__(self, model: FrictionModel, tuning: Tuning = TUNING) -> None:
        self._model = model
        self._tuning = tuning
        components = adaptive_components(model, tuning)
        self._steps = [Steps(component) for component in components]
        self._values = []  # of coefficients and parameters, by joint
        for law, component in zip(model.laws, components, strict=True):
            starts = {
                parameter.name: parameter.start
                for parameter in component.parameters
                if isinstance(parameter, Parameter)
            }
            self._values.append(dict(law.values) | starts)

    def follow(
        self, log_records: Sequence[FrictionRecord], *, adapt: bool = True
    ) -> list[JointEstimates]:
        """Follow the records of all joints in one log; `tau` may hold NaN."""
        joints = tuple(record.joint for record in log_records)
        if joints != self._model.joints:
            raise SimulationError(
                f"friction model '{self._model.law}': the records are of the joints "
                f"{', '.join(joints) or 'none'}, not {', '.join(self._model.joints)}."
            )
        return [self._follow_joint(j, record, adapt) for j, record in enumerate(log_records)]

    def _follow_joint(self, j: int, record: FrictionRecord, adapt: bool) -> JointEstimates:
        law = self._model.laws[j]
        steps = self._steps[j]
        columns, record_values = build_inputs(record)
        columns["tau_meas"] = record.measured
        columns["tau_rigid"] = record.of_bodies
        columns["adapt"] = np.full_like(record.t, float(adapt))
        extra_state_count = len(steps.component.memory) - len(law.start)
        initial_state = (*(0.0,) * extra_state_count, *law.start)
        values = steps.simulate(record.t, columns, self._values[j] | record_values, initial_state)
        outputs = dict(zip(steps.observed, values, strict=True))
        for name, neutral in (("level", 1.0), ("viscosity", 1.0), ("offset", 0.0)):
            learned_change = self._tuning.carried * (float(outputs[name][-1]) - neutral)
            self._values[j][f"{name}_start"] = neutral + learned_change
        return JointEstimates(record=record, tau_fixed=predict_record(law, record), outputs=outputs)


_MIN_SHARED_SHARE = 0.5  # share of joints above which a change is shared
_ESTIMATES = ("level", "level_sd", "viscosity", "viscosity_sd", "offset", "offset_sd")

POINTS_TO = {
    "drift": "wear, damage or heat of this joint",
    "shared drift": "temperature or lubrication: most joints change in the same way",
    "shift": "a payload, a gravity error, or a sensor",
}
"""Likely cause by kind of alarm."""


@dataclass(frozen=True, kw_only=True)
class Alarm:
    """A change of friction.

    Attributes
    ----------
    time : time of the alarm in the log [s].
    kind : drift, shared drift or shift.
    sign : 1 for more friction or torque, -1 for less.
    """

    log: str
    joint: str
    time: float
    kind: str
    sign: int

    @property
    def change(self) -> str:
        """Direction of the change: "more" or "less"."""
        if self.sign > 0:
            return "more"
        return "less"

    @property
    def points_to(self) -> str:
        """Likely cause."""
        return POINTS_TO[self.kind]


@dataclass(frozen=True, kw_only=True)
class State:
    """One joint at the end of a log.

    Attributes
    ----------
    level, viscosity : factors on Coulomb and viscous friction.
    offset : torque in addition to the law [N.m; N].
    level_sd, viscosity_sd, offset_sd : standard deviations, in the same units.
    learning : share of the rows in which the factors adapt.
    rmse_fixed, rmse : errors of the law and of the adaptive law [N.m; N].
    """

    log: str
    joint: str
    level: float
    level_sd: float
    viscosity: float
    viscosity_sd: float
    offset: float
    offset_sd: float
    learning: float
    rmse_fixed: float
    rmse: float

    def intervals(self) -> tuple[str, str, str]:
        """Return the factors with two standard deviations."""
        return (
            f"{self.level:.3f} ± {2 * self.level_sd:.3f}",
            f"{self.viscosity:.3f} ± {2 * self.viscosity_sd:.3f}",
            f"{self.offset:.3g} ± {2 * self.offset_sd:.2g}",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class FollowedLogs:
    """Friction of a robot over logs; `followed` is [log][joint]."""

    model: FrictionModel
    followed: tuple[tuple[JointEstimates, ...], ...]
    states: tuple[State, ...]
    alarms: tuple[Alarm, ...]


def watch(model: FrictionModel, records: Sequence[Sequence[FrictionRecord]]) -> FollowedLogs:
    """Follow friction over records [log][joint] in order of time."""
    follower = Follower(model, TUNING)
    followed = tuple(tuple(follower.follow(log_records)) for log_records in records)
    states: list[State] = []
    alarms: list[Alarm] = []
    for log_estimates in followed:
        states += [_summarise_joint(estimates) for estimates in log_estimates]
        alarms += _find_alarms(log_estimates)
    return FollowedLogs(model=model, followed=followed, states=tuple(states), alarms=tuple(alarms))


def _summarise_joint(estimates: JointEstimates) -> State:
    """Return the state of a joint at the end of a log."""
    record = estimates.record
    outputs = estimates.outputs
    last_estimates = {name: float(outputs[name][-1]) for name in _ESTIMATES}
    is_finite = np.isfinite(record.tau)
    return State(
        log=record.log,
        joint=record.joint,
        **last_estimates,
        learning=float(np.mean(outputs["health"] == 0.0)),
        rmse_fixed=rmse((estimates.tau_fixed - record.tau)[is_finite]),
        rmse=rmse((outputs["tau"] - record.tau)[is_finite]),
    )


def _find_alarms(log_estimates: Sequence[JointEstimates]) -> list[Alarm]:
    """Return the alarms of all joints in a log in order of time; most joints share some drifts."""
    alarms: list[Alarm] = []
    for estimates in log_estimates:
        for kind in ("drift", "shift"):
            alarms += _find_rises(estimates, kind)
    alarms.sort(key=lambda alarm: alarm.time)
    drifts = [(alarm.joint, alarm.sign) for alarm in alarms if alarm.kind == "drift"]
    shared_signs = find_shared_signs(drifts, len(log_estimates))
    named_alarms = []
    for alarm in alarms:
        is_shared = alarm.kind == "drift" and alarm.sign in shared_signs
        if is_shared:
            named_alarms.append(replace(alarm, kind="shared drift"))
        else:
            named_alarms.append(alarm)
    return named_alarms


def _find_rises(estimates: JointEstimates, kind: str) -> list[Alarm]:
    """Return the alarms of a kind of a joint where they begin or change their sign."""
    record = estimates.record
    signs = estimates.outputs[kind]
    is_new = (signs != 0.0) & (np.diff(signs, prepend=0.0) != 0.0)
    return [
        Alarm(
            log=record.log,
            joint=record.joint,
            time=float(record.t[row]),
            kind=kind,
            sign=int(signs[row]),
        )
        for row in np.flatnonzero(is_new)
    ]


def find_shared_signs(drifts: Iterable[tuple[str, int]], joint_count: int) -> list[int]:
    """Return the signs of drifts (joint, sign) that most joints share."""
    # A joint that drifts repeatedly counts once for each sign.
    counts = Counter(sign for _, sign in set(drifts))
    threshold = max(1.0, _MIN_SHARED_SHARE * joint_count)
    return [sign for sign in (1, -1) if counts[sign] > threshold]
