"""JSON form of a friction model: names, structures, numbers and units, never code."""

from collections.abc import Mapping, ValuesView
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from pydantic import StrictBool

from hesr_model.equations.memory import Discretisation
from hesr_model.errors import ArtifactError
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.band import Band
from hesr_model.friction.inputs import MOVING
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.servo import FittedServo
from hesr_model.friction.thermal import Thermal
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.inference.covariance import Covariance
from hesr_model.robots.transmission import Coupling
from hesr_model.units import unit_of_joint

MODEL_FORMAT = "hesr-friction-model-1"
_LAW_FIELDS = ("discretisation", "start", "start_samples", "covariance", "band")
_MAX_COEFFICIENTS = 1000  # coefficients of a joint; expressions of many terms take seconds


@dataclass(frozen=True, kw_only=True)
class _CoefficientEntry:
    value: float
    unit: str
    standard_error: float | None = None


@dataclass(frozen=True, kw_only=True)
class JointEntry:
    """Law of one joint and its training data."""

    joint: str
    # Written for sliding joints only: version 1 has no such key.
    sliding: StrictBool | None = None
    law: str
    structure: Mapping[str, Any]
    coefficients: Mapping[str, _CoefficientEntry]
    discretisation: Discretisation
    start: tuple[float, ...]
    start_samples: int = 0
    # Written for slow joints only.
    steady_speed: float | None = None
    covariance: Covariance | None = None
    band: Band | None = None
    trained: TrainedRange | None = None
    training_rmse: float | None = None
    left_out_rmse: float | None = None
    thermal: Thermal | None = None
    # Written for laws from commands only.
    servos: FittedServo | None = None

    @classmethod
    def from_law(cls, law: FrictionLaw, **joint_fields: Any) -> Self:
        """Return the entry of a law; `joint_fields` are the fields outside the law."""
        units = {quantity.name: quantity.unit for quantity in law.form.coefficients}
        coefficients = {}
        for name, value in law.values.items():
            error = law.standard_errors.get(name)
            coefficients[name] = _CoefficientEntry(
                value=value, unit=units[name], standard_error=error
            )
        has_usual_start = law.form.steady_speed == MOVING
        return cls(
            steady_speed=None if has_usual_start else law.form.steady_speed,
            law=law.name,
            structure=law.structure,
            coefficients=coefficients,
            **{name: getattr(law, name) for name in _LAW_FIELDS},
            **joint_fields,
        )

    def rebuild_law(self) -> FrictionLaw:
        """Rebuild the law; raise ArtifactError if it is too long or something is unknown."""
        count = max(len(self.coefficients), _count_leaves(self.structure))
        if count > _MAX_COEFFICIENTS:
            raise ArtifactError(
                f"joint '{self.joint}' has {count} coefficients or terms; at most "
                f"{_MAX_COEFFICIENTS} are read.",
                code="law.most",
                key="coefficients",
            )
        form = estimator(self.law).form(self.structure)
        if self.steady_speed is not None:
            form = replace(form, steady_speed=self.steady_speed)
        entries = self.coefficients
        for coefficient in form.coefficients:
            entry = entries.get(coefficient.name)
            unit = unit_of_joint(coefficient.unit, is_prismatic=bool(self.sliding))
            if entry is not None and entry.unit != unit:
                raise ArtifactError(
                    f"coefficient '{coefficient.name}' has the unit '{entry.unit}', expected "
                    f"'{unit}'.",
                    code="law.unit",
                    key=f"coefficients.{coefficient.name}.unit",
                )
        errors = {name: entry.standard_error for name, entry in entries.items()}
        return FrictionLaw(
            name=self.law,
            structure=self.structure,
            form=form,
            values={name: entry.value for name, entry in entries.items()},
            standard_errors={name: error for name, error in errors.items() if error is not None},
            **{name: getattr(self, name) for name in _LAW_FIELDS},
        )


def _count_leaves(data: Any) -> int:
    """Return the number of values in nested lists and mappings."""
    if isinstance(data, Mapping):
        return sum(map(_count_leaves, data.values()))
    if isinstance(data, list | tuple | ValuesView):
        return sum(map(_count_leaves, data))
    return 1


@dataclass(frozen=True, kw_only=True)
class ModelFile:
    """Keys of a file."""

    IRRELEVANT_KEYS: ClassVar = {
        "format": "it is checked before",
        "joints.audit": "of version 1; certificates are computed anew for each law",
    }

    law: str
    robot: str
    sample_time: float
    joints: tuple[JointEntry, ...]
    # Written for coupled joints only.
    coupling: Coupling | None = None
    provenance: Mapping[str, Any]
