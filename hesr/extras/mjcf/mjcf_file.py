"""MJCF export: friction as passive actuators."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import astuple, dataclass
from importlib.metadata import version
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import sympy
from threadpoolctl import threadpool_limits

from fmu_src.friction.reference import trained_speed
from fmu_src.friction.validity import require_exportable
from hesr.extras.mjcf.parts import JointFriction, NoCounterpartError, find_parts
from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ExportError, HesrError
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import SearchSpace, Separable
from hesr_model.friction.inputs import DQ, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.dahl import DEFLECTIONS
from hesr_model.laws.lugre import STATIC_RATIO_BOUNDS
from hesr_model.laws.stribeck import SIGMA_2, TAU_0, V_S, VELOCITY_BOUNDS
from hesr_model.motions.trajectories import random_fourier
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.files import written_whole
from hesr_model.support.progress import Progress, report_progress, silent
from hesr_model.units import unit_of_joint

RATIO = Coefficient(name="ratio", unit="1", description="static over Coulomb friction")
TIME = Coefficient(name="T", unit="s", description="micro-damping over stiffness")
TIME_BOUNDS = (1e-7, 0.05)  # bounds of T [s]; the lower one has no effect at any step in use
_FORCES = tuple(
    Coefficient(name=f"F_{i}", unit="N.m", description="Coulomb friction of a bristle")
    for i in range(1, len(DEFLECTIONS) + 1)
)
_LOAD_FREQUENCY = 0.25


@dataclass(frozen=True, kw_only=True)
class Misfit:
    """RMSE of a torque [N.m], and largest error over largest torque."""

    rmse: float
    relative: float


def project_law(
    law: FrictionLaw, trained_range: TrainedRange | None, sample_time: float
) -> tuple[FrictionLaw, Misfit, Misfit]:
    """Return the nearest law from parts of MuJoCo, and its errors on the fitted and another motion.

        tau = sum_i F_i / x_i (z_i + T z_i') + sigma_2 v + tau_0 + sum_p a_p cos(p q) + b_p sin(p q)
        z_i' = v - |v| / (x_i s(v)) z_i,    s = 1 + (ratio - 1) exp(-(v / v_s)^2)

    The deflections x_i are those of the Dahl basis; ratio, v_s and T are searched, the rest is
    least squares with non-negative F_i and sigma_2, on the law along a Fourier motion at trained
    speeds. Reproducible bit for bit on one machine; the step of the law is `sample_time` [s].
    """
    record, test_record = simulate_records(law, trained_range, sample_time)
    form, space = _build_family(_find_poles(law))
    problem = Separable(
        form, space, JointRows.from_records([record], coefficients=len(form.coefficients))
    )
    with threadpool_limits(1):
        point = problem.polish(problem.search(np.random.default_rng(0)))
        unknowns, _ = problem.solve(point)
    nearest_law = FrictionLaw(name="projected", form=form, values=problem.values(point, unknowns))
    return (
        nearest_law,
        compute_misfit(nearest_law, record),
        compute_misfit(nearest_law, test_record),
    )


def simulate_records(
    law: FrictionLaw, trained_range: TrainedRange | None, sample_time: float
) -> list[FrictionRecord]:
    """Return records for the fit and the test of a projection."""
    peak = np.array([trained_speed(trained_range)])
    zero_offset = np.zeros(1)
    lowest = 0.0
    highest = 0.0
    if trained_range:
        lowest, highest = trained_range.tau_load
    joint_records = []
    for seed, period in ((2, 40.0), (1, 20.0)):
        trajectory = random_fourier(
            seed=seed, harmonics=10, period=period, peak_velocity=peak, offset=zero_offset
        )
        t = sample_time * np.arange(round(period / sample_time), dtype=np.float64)
        q, dq, _ = (column[:, 0] for column in trajectory.sample(t))
        if trained_range:
            q = q + trained_range.middle
        tau_load = 0.5 * (lowest + highest) + 0.5 * (highest - lowest) * np.cos(
            2.0 * np.pi * _LOAD_FREQUENCY * t
        )
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # checked below
            tau = predict(law, t=t, dq=dq, q=q, tau_load=tau_load)
        if not np.all(np.isfinite(tau)):
            raise ExportError(
                f"law '{law.name}': its torque is not finite at speeds up to "
                f"{np.max(np.abs(dq)):.3g} rad/s, so it cannot be projected."
            )
        joint_records.append(
            FrictionRecord(log="projection", joint="", t=t, dq=dq, q=q, tau_load=tau_load, tau=tau)
        )
    return joint_records


def compute_misfit(law: FrictionLaw, record: FrictionRecord) -> Misfit:
    """Return the error of a law on a record."""
    tau_predicted = predict(law, t=record.t, dq=record.dq, q=record.q, tau_load=record.tau_load)
    difference = tau_predicted - record.tau
    largest_torque = float(np.max(np.abs(record.tau)))
    relative = 0.0
    if largest_torque:
        relative = float(np.max(np.abs(difference))) / largest_torque
    return Misfit(rmse=rmse(difference), relative=relative)


def _find_poles(law: FrictionLaw) -> list[float]:
    values = {
        coefficient.symbol: law.values[coefficient.name] for coefficient in law.form.coefficients
    }
    angles = [wave.args[0] for wave in law.form.output.atoms(sympy.sin, sympy.cos)]
    slopes = (sympy.diff(angle, Q).subs(values) for angle in angles)
    return sorted({abs(float(slope)) for slope in slopes if slope.is_number and slope != 0})


def _build_family(poles: list[float]) -> tuple[LawForm, SearchSpace]:
    """Return the form of `project_law` with ripples of `poles` [1/rad], and its search space."""
    level = 1 + (RATIO.symbol - 1) * sympy.exp(-((DQ / V_S.symbol) ** 2))
    torque = SIGMA_2.symbol * DQ + TAU_0.symbol
    bristles = []
    for i, (coefficient, deflection) in enumerate(zip(_FORCES, DEFLECTIONS, strict=True), start=1):
        length = sympy.Float(deflection)
        bristle = Relaxation(
            name=f"z{i}", unit="rad", drive=DQ, rate=absolute(DQ) / (length * level)
        )
        bristles.append(bristle)
        elongation = bristle.state + TIME.symbol * bristle.derivative
        torque += coefficient.symbol * elongation / length
    ripples = []
    for i, pole in enumerate(poles, start=1):
        angle = sympy.Float(pole) * Q
        for name, wave in (("a", sympy.cos(angle)), ("b", sympy.sin(angle))):
            ripple = Coefficient(name=f"{name}_{i}", unit="N.m", description="ripple")
            ripples.append(ripple)
            torque += ripple.symbol * wave
    linear = (*_FORCES, SIGMA_2, TAU_0, *ripples)
    space = SearchSpace(
        bounds=(
            (RATIO.name, STATIC_RATIO_BOUNDS),
            (V_S.name, VELOCITY_BOUNDS),
            (TIME.name, TIME_BOUNDS),
        ),
        linear=tuple(coefficient.name for coefficient in linear),
        non_negative=len(_FORCES) + 1,
    )
    coefficients = (*linear, RATIO, V_S, TIME)
    return LawForm(coefficients=coefficients, memory=tuple(bristles), output=torque), space


_MJCF_HEAD = """\
<!-- Friction of joints as passive actuators of MuJoCo (4.0 or later). Put
       <include file="FILE.xml"/>
     into the model of the robot, whose joints are named as here and which has no other friction
     (frictionloss, damping, friction actuators). MuJoCo relaxes a bristle exactly over a step in
     which the velocity is held, and applies its torque explicitly: take steps of about 1 ms. -->
<mujoco>
  <custom>
"""


@dataclass(frozen=True, kw_only=True)
class JointProjection:
    """Export of one joint."""

    joint: str
    missing: str | None = None  # term without a counterpart; None: exact
    fitted: Misfit | None = None  # on the fitted motion
    unseen: Misfit | None = None  # on another motion
    unit: str = "N.m"

    def __str__(self) -> str:
        if self.fitted is None or self.unseen is None:
            return f"{self.joint}: exact"
        fitted = self.fitted
        unseen = self.unseen
        return (
            f"{self.joint}: projected, since {self.missing}; RMSE {fitted.rmse:.3g} {self.unit} "
            f"where fitted and {unseen.rmse:.3g} {self.unit} on another motion, at most "
            f"{100.0 * fitted.relative:.3g} and {100.0 * unseen.relative:.3g} % of the largest "
            "torque"
        )


@dataclass(frozen=True, kw_only=True)
class Projection:
    """Export of a friction model."""

    joints: tuple[JointProjection, ...]

    @property
    def exact(self) -> bool:
        """Whether the MJCF equals the model except for round-off."""
        return all(joint.missing is None for joint in self.joints)

    def lines(self) -> list[str]:
        """Return a line per joint, which `hesr export` prints."""
        return [str(joint) for joint in self.joints]


def export_mjcf_law(
    model: FrictionModel, path: Path, *, project: bool = False, progress: Progress = silent
) -> Projection:
    """Write a friction model as passive dcmotors on the joints of the same names in an MJCF."""
    if path.suffix.lower() != ".xml":
        raise ExportError(f"{path}: the name of an MJCF ends in .xml.")
    require_exportable(model, "an MJCF of one actuator per joint", coupled=False)
    with written_whole(path) as temporary:
        joint_parts = []
        joint_projections = []
        for j in report_progress(range(len(model.joints)), progress):
            friction, joint_projection = _export_joint(model, j, project)
            joint_parts.append(friction)
            joint_projections.append(joint_projection)
        projection = Projection(joints=tuple(joint_projections))
        text = "".join(_compose_mjcf(model, joint_parts, projection))
        temporary.write_text(text, encoding="utf-8")
    return projection


def _export_joint(
    model: FrictionModel, j: int, project: bool
) -> tuple[JointFriction, JointProjection]:
    law = model.laws[j]
    joint = model.joints[j]
    try:
        return find_parts(law), JointProjection(joint=joint)
    except NoCounterpartError as error:
        is_prismatic = model.slides[j]
        missing_term = error.format_for_joint(is_prismatic=is_prismatic)
        refusal = (
            f"law '{model.law}' of joint '{joint}' is not expressible in MJCF: {missing_term};"
        )
        trained_range = None
        if model.trained:
            trained_range = model.trained[j]
        try:
            if project:
                nearest_law, fitted_misfit, test_misfit = project_law(
                    law, trained_range, model.sample_time
                )
            else:
                # Refuse what a projection would also refuse.
                simulate_records(law, trained_range, model.sample_time)
        except HesrError as refusal_error:
            raise ExportError(
                f"{refusal} nor can it be projected: {refusal_error}"
            ) from refusal_error
        if not project:
            raise ExportError(
                f"{refusal} The option 'project' writes the nearest bristles and their errors."
            ) from error
        projection = JointProjection(
            joint=joint,
            missing=missing_term,
            fitted=fitted_misfit,
            unseen=test_misfit,
            unit=unit_of_joint("N.m", is_prismatic=is_prismatic),
        )
        return find_parts(nearest_law), projection


def _compose_mjcf(
    model: FrictionModel, joint_parts: list[JointFriction], projection: Projection
) -> Iterator[str]:
    yield _MJCF_HEAD
    texts = {
        "law": f"{model.law} of {model.robot}, made at {model.sample_time:g} s, by HESR "
        f"{version('hesr')}",
        "provenance": json.dumps(dict(model.provenance), sort_keys=True),
        "error": "; ".join(projection.lines()),
    }
    for name, text in texts.items():
        name = quoteattr(f"{model.robot}_friction_{name}")
        yield f"    <text name={name} data={quoteattr(text)}/>\n"
    yield "  </custom>\n  <actuator>\n"
    for joint, friction in zip(model.joints, joint_parts, strict=True):
        for number, attributes in enumerate(_list_actuators(friction), start=1):
            name = quoteattr(f"{joint}_{model.law}{number}")
            yield (
                f"    <dcmotor name={name} joint={quoteattr(joint)}"
                f' input="none" resistance="1" motorconst="0 0" gear="1"\n'
                f"      {attributes}/>\n"
            )
    yield "  </actuator>\n</mujoco>\n"


def _list_actuators(friction: JointFriction) -> Iterator[str]:
    """Yield the attributes of each actuator of a joint; the first has all viscous friction."""
    actuator_count = max(len(friction.bristles), len(friction.waves), 1)
    for k in range(actuator_count):
        lugre = (0.0,) * 5
        viscous = 0.0
        cogging = (0.0,) * 3
        if k < len(friction.bristles):
            lugre = astuple(friction.bristles[k])
        if k == 0:
            viscous = friction.viscous
        if k < len(friction.waves):
            cogging = astuple(friction.waves[k])
        yield (
            f'lugre="{_format_numbers(lugre)}" damping="{_format_numbers([viscous])}" '
            f'cogging="{_format_numbers(cogging)}"'
        )


def _format_numbers(numbers: Iterable[float]) -> str:
    return " ".join(f"{number:.17g}" for number in numbers)
