"""Nearest friction from parts of MuJoCo: parallel bristles, viscous friction, ripple, offset.

    tau = sum_i F_i / x_i (z_i + T z_i') + sigma_2 v + tau_0 + sum_p a_p cos(p q) + b_p sin(p q)
    z_i' = v - |v| / (x_i s(v)) z_i,    s = 1 + (ratio - 1) exp(-(v / v_s)^2)

The deflections x_i are those of the Dahl basis; ratio, v_s and T are searched, the rest is least
squares with non-negative F_i and sigma_2, on the law along a Fourier motion at trained speeds.
"""

from dataclasses import dataclass

import numpy as np
import sympy
from threadpoolctl import threadpool_limits

from fmu_src.friction.reference import trained_speed
from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ExportError
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import SearchSpace, Separable
from hesr_model.friction.inputs import DQ, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.dahl import DEFLECTIONS
from hesr_model.laws.lugre import STATIC_RATIO_BOUNDS
from hesr_model.laws.stribeck import SIGMA_2, TAU_0, V_S, VELOCITY_BOUNDS
from hesr_model.motions.trajectories import Trajectory, random_fourier
from hesr_model.rigid_body.residual import FrictionRecord

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


def projected(
    law: FrictionLaw, trained: TrainedRange | None, sample_time: float
) -> tuple[FrictionLaw, Misfit, Misfit]:
    """Return the nearest law from parts of MuJoCo, and its errors on the fitted and another motion.

    Reproducible bit for bit on one machine; the step of the law is `sample_time` [s].
    """
    seen, unseen = records(law, trained, sample_time)
    form, space = _family(_poles(law))
    problem = Separable(form, space, JointRows.of([seen], coefficients=len(form.coefficients)))
    with threadpool_limits(1):
        point = problem.polish(problem.search(np.random.default_rng(0)))
        unknowns, _ = problem.solve(point)
    found = FrictionLaw(name="projected", form=form, values=problem.values(point, unknowns))
    return found, misfit(found, seen), misfit(found, unseen)


def records(
    law: FrictionLaw, trained: TrainedRange | None, sample_time: float
) -> tuple[FrictionRecord, FrictionRecord]:
    """Return records for the fit and the test of a projection."""
    peak, middle = np.array([trained_speed(trained)]), np.zeros(1)
    slow, fast = (
        random_fourier(seed=seed, harmonics=10, period=period, peak_velocity=peak, offset=middle)
        for seed, period in ((2, 40.0), (1, 20.0))
    )
    return _record(law, slow, trained, sample_time), _record(law, fast, trained, sample_time)


def misfit(law: FrictionLaw, record: FrictionRecord) -> Misfit:
    """Return the error of a law on a record."""
    torque = predict(law, t=record.t, dq=record.dq, q=record.q, tau_load=record.tau_load)
    difference = torque - record.tau
    largest = float(np.max(np.abs(record.tau)))
    return Misfit(
        rmse=rmse(difference),
        relative=float(np.max(np.abs(difference))) / largest if largest else 0.0,
    )


def _record(
    law: FrictionLaw, trajectory: Trajectory, trained: TrainedRange | None, sample_time: float
) -> FrictionRecord:
    rows = np.arange(round(trajectory.duration / sample_time), dtype=np.float64)
    t = sample_time * rows
    q, dq, _ = (column[:, 0] for column in trajectory.sample(t))
    if trained:
        q = q + trained.middle
    low, high = trained.tau_load if trained else (0.0, 0.0)
    swing = np.cos(2.0 * np.pi * _LOAD_FREQUENCY * t)
    load = 0.5 * (low + high) + 0.5 * (high - low) * swing
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # checked below
        tau = predict(law, t=t, dq=dq, q=q, tau_load=load)
    if not np.all(np.isfinite(tau)):
        raise ExportError(
            f"law '{law.name}': its torque is not finite at speeds up to {np.max(np.abs(dq)):.3g} "
            "rad/s, so it cannot be projected."
        )
    return FrictionRecord(log="projection", joint="", t=t, dq=dq, q=q, tau_load=load, tau=tau)


def _poles(law: FrictionLaw) -> list[float]:
    values = {c.symbol: law.values[c.name] for c in law.form.coefficients}
    angles = [wave.args[0] for wave in law.form.output.atoms(sympy.sin, sympy.cos)]
    slopes = (sympy.diff(angle, Q).subs(values) for angle in angles)
    return sorted({abs(float(slope)) for slope in slopes if slope.is_number and slope != 0})


def _family(poles: list[float]) -> tuple[LawForm, SearchSpace]:
    level = 1 + (RATIO.symbol - 1) * sympy.exp(-((DQ / V_S.symbol) ** 2))
    bristles = tuple(
        Relaxation(name=f"z{i}", unit="rad", drive=DQ, rate=absolute(DQ) / (sympy.Float(x) * level))
        for i, x in enumerate(DEFLECTIONS, start=1)
    )
    waves = [
        (Coefficient(name=f"{name}_{i}", unit="N.m", description="ripple"), wave(p * Q))
        for i, p in enumerate(map(sympy.Float, poles), start=1)
        for name, wave in (("a", sympy.cos), ("b", sympy.sin))
    ]
    torque = sum(
        f.symbol * (z.state + TIME.symbol * z.derivative) / sympy.Float(x)
        for f, z, x in zip(_FORCES, bristles, DEFLECTIONS, strict=True)
    )
    torque += SIGMA_2.symbol * DQ + TAU_0.symbol + sum(c.symbol * wave for c, wave in waves)
    linear = (*_FORCES, SIGMA_2, TAU_0, *(c for c, _ in waves))
    space = SearchSpace(
        bounds=(
            (RATIO.name, STATIC_RATIO_BOUNDS),
            (V_S.name, VELOCITY_BOUNDS),
            (TIME.name, TIME_BOUNDS),
        ),
        linear=tuple(c.name for c in linear),
        non_negative=len(_FORCES) + 1,
    )
    return LawForm(coefficients=(*linear, RATIO, V_S, TIME), memory=bristles, output=torque), space
