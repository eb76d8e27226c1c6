"""Adaptive friction FMUs, which estimate friction from measured torques, and runs over logs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmu_src.export.package import Content, Version, check_request, write_fmu
from fmu_src.friction.discrete_fmu import discrete_equations
from fmu_src.friction.friction_fmu import about_model, bare_content
from fmu_src.friction.validity import require_numbers
from hesr.extras.adaptive.component import ADAPT, TUNING, Tuning, adaptive_component
from hesr_model.audit.certificate import least_viscosity
from hesr_model.equations.component import Component, Parameter
from hesr_model.equations.stepping import Steps
from hesr_model.errors import SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import predict_record
from hesr_model.friction.thermal_law import inputs_over
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array
from hesr_model.support.progress import Progress, silent


def export_adaptive(
    model: FrictionModel,
    path: Path,
    *,
    platforms: Sequence[str] = ("linux64",),
    progress: Progress = silent,
    fmi: Version = 2,
) -> Path:
    """Write a friction model with stops or bristles as an adaptive FMU, without pages."""
    check_request(path, platforms)
    return write_fmu(adaptive_content(model), path, platforms=platforms, progress=progress, fmi=fmi)


def adaptive_content(model: FrictionModel) -> Content:
    """Return the adaptive FMU before compilation."""
    about = about_model(model, "adaptive", "that adapts to measured torques")
    equations = discrete_equations(model, adaptive_components(model), (ADAPT,))
    require_numbers(model)
    return bare_content(model, about, *equations)


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """Estimates of one joint in one log, before the torque of each row is used.

    `fixed` is the torque of the law (N,) [N.m]; `outputs` are (N,) by name.
    """

    record: FrictionRecord
    fixed: Array
    outputs: dict[str, Array]


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
    thermal = model.thermal or (None,) * len(model.laws)
    rows = zip(model.laws, model.training_rmse, model.trained, thermal, strict=True)
    return tuple(
        adaptive_component(
            law,
            tuning,
            noise=noise,
            speed=trained.speed,
            viscosity_least=least_viscosity(law),
            thermal=thermal,
        )
        for law, noise, trained, thermal in rows
    )


class Follower:
    """Follows friction over logs; each starts from a share of the learned factors."""

    def __init__(self, model: FrictionModel, tuning: Tuning = TUNING) -> None:
        self._model, self._tuning = model, tuning
        components = adaptive_components(model, tuning)
        self._steps = [Steps(own) for own in components]
        self._values = [
            dict(law.values) | {p.name: p.start for p in own.parameters if isinstance(p, Parameter)}
            for law, own in zip(model.laws, components, strict=True)
        ]

    def follow(self, records: Sequence[FrictionRecord], *, adapt: bool = True) -> list[Followed]:
        """Follow the records of all joints in one log; `tau` may hold NaN."""
        if (found := tuple(r.joint for r in records)) != self._model.joints:
            raise SimulationError(
                f"friction model '{self._model.law}': the records are of the joints "
                f"{', '.join(found) or 'none'}, not {', '.join(self._model.joints)}."
            )
        return [self._of_joint(j, record, adapt) for j, record in enumerate(records)]

    def _of_joint(self, j: int, record: FrictionRecord, adapt: bool) -> Followed:
        law, steps = self._model.laws[j], self._steps[j]
        columns, more = inputs_over(record)
        columns["tau_meas"] = record.measured
        columns["tau_rigid"] = record.of_bodies
        columns["adapt"] = np.full_like(record.t, float(adapt))
        slow = len(steps.component.memory) - len(law.start)
        start = (*(0.0,) * slow, *law.start)
        values = steps.over(record.t, columns, self._values[j] | more, start)
        outputs = dict(zip(steps.observed, values, strict=True))
        for name, known in (("level", 1.0), ("viscosity", 1.0), ("offset", 0.0)):
            learned = self._tuning.carried * (float(outputs[name][-1]) - known)
            self._values[j][f"{name}_start"] = known + learned
        return Followed(record=record, fixed=predict_record(law, record), outputs=outputs)
