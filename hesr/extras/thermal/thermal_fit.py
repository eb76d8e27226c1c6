"""Temperature dependence of friction, from measured temperatures or the heat of long logs.

Without measured temperatures R is 1, because temperatures are known up to a factor only.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy
from scipy.optimize import least_squares, minimize_scalar

from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.errors import FitError
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import coefficient_array
from hesr_model.friction.records import rmse
from hesr_model.friction.scales import split_torque
from hesr_model.friction.thermal import Thermal
from hesr_model.inference.covariance import blocks_of_time, covariance_of_fit
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array

MIN_SPREAD = 3.0  # smallest difference between the 5 and 95 % quantiles [K]
MIN_TIME = 300.0  # smallest length of the longest log without temperatures [s]
_TIME_CONSTANT_BOUNDS = (60.0, 14_400.0)  # bounds of the thermal time constant [s]
_UNKNOWNS = {
    "coulomb_scale": (-1.0, 1.0, 0.1),  # logarithm
    "viscous_scale": (-1.5, 1.5, 0.1),  # logarithm
    "coulomb": (-0.5, 0.5, 0.01),
    "viscous": (-0.5, 0.5, 0.01),
    "offset": (-np.inf, np.inf, 1.0),
    "time_constant": (*np.log(_TIME_CONSTANT_BOUNDS), 0.3),  # logarithm
}
"""Bounds and scale of each unknown; the last one is optional."""

_INTERVAL_ERRORS = 1.96  # half width of a 95 % interval in standard errors
_ROUND_COUNT = 2  # iterations of the fixed point of heat and friction


class Factored:
    """A law whose bounds and viscous friction have factors that vary by row."""

    def __init__(self, law: FrictionLaw) -> None:
        level, viscosity = sympy.symbols("level viscosity", real=True)
        law_parts = split_torque(law, level)
        output = law_parts.hysteresis + viscosity * law_parts.viscous + law_parts.unscaled
        self._law = law
        symbols = (quantity.symbol for quantity in law.form.coefficients)
        settling = law.form.component.settling
        inputs = (*INPUTS, level, viscosity)
        self._kernel = Kernel(
            law_parts.memory, tuple(symbols), inputs, (output,), settling, once=True
        )

    def compute_torque(self, record: FrictionRecord, level: Array, viscosity: Array) -> Array:
        """Return the torque (N,) [N.m] for factors (N,)."""
        law = self._law
        dt = np.diff(record.t, prepend=record.t[0])
        inputs = (record.dq, record.q, record.tau_load, level, viscosity)
        run = KernelRun(self._kernel, inputs, dt, euler=law.discretisation == "euler")
        return run.evaluate(coefficient_array(law), np.array(law.start))[:, 0]


@dataclass(frozen=True, kw_only=True)
class ThermalFit:
    """Temperature dependence of one joint; errors [1/K], RMSE [N.m] without and with it."""

    joint: str
    thermal: Thermal
    coulomb_error: float
    viscous_error: float
    rmse_fixed: float
    rmse: float


def fit_thermal(
    model: FrictionModel, records: Sequence[Sequence[FrictionRecord]]
) -> tuple[FrictionModel, tuple[ThermalFit, ...]]:
    """Fit the temperature dependence of a fitted model to logs [log][joint]."""
    if model.coupling is not None:
        raise FitError(
            f"friction model '{model.law}': a thermal model does not support coupled joints."
        )
    fits = []
    for j, law in enumerate(model.laws):
        joint_records = [log_records[j] for log_records in records]
        fits.append(_fit_joint(law, joint_records))
    return replace(model, thermal=tuple(fit.thermal for fit in fits)), tuple(fits)


def add_temperature(
    model: FrictionModel, records: Sequence[Sequence[FrictionRecord]]
) -> tuple[FrictionModel, list[str]]:
    """Return a law with its temperature dependence, and a sentence per joint."""
    thermal_model, fits = fit_thermal(model, records)
    return thermal_model, [_describe_fit(fit) for fit in fits]


def _describe_fit(fit: ThermalFit) -> str:
    # Without temperatures R is 1, so that the rise is in watts.
    unit = "K" if fit.thermal.measured else "W of friction"
    return (
        f"{fit.joint}: Coulomb friction falls by {100 * fit.thermal.coulomb:.2g} ± "
        f"{200 * fit.coulomb_error:.1g} % per {unit}, "
        f"viscous by {100 * fit.thermal.viscous:.2g} ± {200 * fit.viscous_error:.1g} %; time "
        f"constant {fit.thermal.time_constant:.3g} s; error {fit.rmse_fixed:.3g} -> {fit.rmse:.3g}"
    )


def _fit_joint(law: FrictionLaw, joint_records: Sequence[FrictionRecord]) -> ThermalFit:
    measured_temperatures = [
        record.temperature for record in joint_records if record.temperature is not None
    ]
    if measured_temperatures and len(measured_temperatures) < len(joint_records):
        log_name = next(record.log for record in joint_records if record.temperature is None)
        raise FitError(f"log {log_name}: temperatures are missing, but other logs have them.")
    problem = _Problem(law, joint_records)
    if measured_temperatures:
        return _fit_to_temperatures(problem, joint_records[0].joint, measured_temperatures)
    return _fit_to_heat(problem, joint_records)


def _fit_to_temperatures(
    problem: "_Problem", joint: str, measured_temperatures: Sequence[Array]
) -> ThermalFit:
    """Fit friction to temperatures (N,) [degC] of each log, then heating to friction."""
    temperatures = np.concatenate(measured_temperatures)
    lowest, highest = np.percentile(temperatures, (5.0, 95.0))
    if highest - lowest < MIN_SPREAD:
        raise FitError(
            f"joint '{joint}': its temperature varies by {highest - lowest:.2g} K over the logs; "
            f"at least {MIN_SPREAD:g} K are needed."
        )
    start = Thermal(coulomb=0.0, viscous=0.0, reference=round(float(np.mean(temperatures)), 1))
    joint_fit = problem.solve(start, lambda _: measured_temperatures)
    thermal = problem.fit_heating(joint_fit.thermal, measured_temperatures)
    return replace(joint_fit, thermal=thermal)


def _fit_to_heat(problem: "_Problem", joint_records: Sequence[FrictionRecord]) -> ThermalFit:
    """Fit friction and time constant to the heat of friction itself, from cold starts."""
    longest_duration = max(float(np.ptp(record.t)) for record in joint_records)
    if longest_duration < MIN_TIME:
        raise FitError(
            f"joint '{joint_records[0].joint}': the longest log takes {longest_duration:.3g} s; "
            f"without temperatures it must last {MIN_TIME:g} s from a cold start."
        )
    start = Thermal(
        coulomb=0.0,
        viscous=0.0,
        time_constant=longest_duration / 3.0,
        resistance=1.0,
        measured=False,
    )
    joint_fit = problem.solve(start, problem.compute_temperatures, searched=True)
    thermal = joint_fit.thermal
    effects = (
        (thermal.coulomb, joint_fit.coulomb_error),
        (thermal.viscous, joint_fit.viscous_error),
    )
    if all(abs(value) < _INTERVAL_ERRORS * error for value, error in effects):
        raise FitError(
            f"joint '{joint_fit.joint}': friction does not change as the joint warms up; use "
            "longer logs from a cold start."
        )
    return joint_fit


class _Problem:
    """Least squares of one joint: ln c_0, ln n_0, b_c, b_v, an offset; ln T_th if searched."""

    def __init__(self, law: FrictionLaw, joint_records: Sequence[FrictionRecord]) -> None:
        self._law = Factored(law)
        self._records = joint_records
        self._is_finite = [np.isfinite(record.tau) for record in joint_records]
        self._steps = [np.diff(record.t, prepend=record.t[0]) for record in joint_records]

    def solve(
        self,
        start: Thermal,
        temperatures: Callable[[Thermal], Sequence[Array]],
        *,
        searched: bool = False,
    ) -> ThermalFit:

        def build_thermal(x: Array) -> Thermal:
            time_constant = start.time_constant
            if searched:
                time_constant = float(np.exp(x[5]))
            return replace(
                start,
                coulomb_scale=float(np.exp(x[0])),
                viscous_scale=float(np.exp(x[1])),
                coulomb=float(x[2]),
                viscous=float(x[3]),
                time_constant=time_constant,
            )

        def compute_residual(thermal: Thermal, offset: float) -> Array:
            torques = self._compute_torques(thermal, temperatures(thermal))
            rows = zip(torques, self._records, self._is_finite, strict=True)
            return np.concatenate(
                [(tau + offset - record.tau)[is_finite] for tau, record, is_finite in rows]
            )

        names = tuple(_UNKNOWNS)
        if not searched:
            names = names[:-1]
        lower, upper, scale = np.array([_UNKNOWNS[name] for name in names]).T
        initial = np.zeros(len(names))
        if searched:
            initial[2:] = 1e-3, 1e-3, 0.0, np.log(start.time_constant)
        optimum = least_squares(
            lambda x: compute_residual(build_thermal(x), x[4]),
            initial,
            bounds=(lower, upper),
            x_scale=scale,
        )
        rows = [int(is_finite.sum()) for is_finite in self._is_finite]
        labels = blocks_of_time(np.repeat(np.arange(len(rows)), rows))
        errors = covariance_of_fit(names, optimum.jac, optimum.fun, labels).standard_errors
        thermal = build_thermal(optimum.x)
        all_temperatures = np.concatenate(list(temperatures(thermal)))
        coldest = float(np.min(all_temperatures))
        warmest = float(np.max(all_temperatures))
        return ThermalFit(
            joint=self._records[0].joint,
            thermal=replace(thermal, coldest=coldest, warmest=warmest),
            coulomb_error=float(errors[2]),
            viscous_error=float(errors[3]),
            rmse_fixed=rmse(compute_residual(start, 0.0)),
            rmse=rmse(optimum.fun),
        )

    def _compute_torques(self, thermal: Thermal, temperatures: Sequence[Array]) -> list[Array]:
        return [
            self._law.compute_torque(record, *thermal.factors(temperature))
            for record, temperature in zip(self._records, temperatures, strict=True)
        ]

    def compute_temperatures(self, thermal: Thermal) -> list[Array]:
        """Return the temperature of each record from its friction [degC]."""
        temperatures = [np.full_like(record.t, thermal.ambient) for record in self._records]
        for _ in range(_ROUND_COUNT):
            powers = self._compute_powers(thermal, temperatures)
            temperatures = [
                thermal.ambient + thermal.rise(power, dt)
                for power, dt in zip(powers, self._steps, strict=True)
            ]
        return temperatures

    def _compute_powers(self, thermal: Thermal, temperatures: Sequence[Array]) -> list[Array]:
        torques = self._compute_torques(thermal, temperatures)
        return [np.abs(tau * record.dq) for tau, record in zip(torques, self._records, strict=True)]

    def fit_heating(self, thermal: Thermal, temperatures: Sequence[Array]) -> Thermal:
        powers = self._compute_powers(thermal, temperatures)
        measured_temperatures = np.concatenate(list(temperatures))

        def solve_heating(time: float) -> tuple[Array, float]:
            # Unknowns: resistance, ambient, and the first temperature of each log.
            log_columns = []
            unit_thermal = replace(thermal, resistance=1.0, time_constant=time)
            is_log = np.eye(len(powers))
            for k, record in enumerate(self._records):
                rise = unit_thermal.rise(powers[k], self._steps[k])
                decay = np.exp(-(record.t - record.t[0]) / time)
                starts = np.outer(decay, is_log[k])
                log_columns.append(np.column_stack([rise, 1.0 - decay, starts]))
            columns = np.concatenate(log_columns)
            unknowns = np.linalg.lstsq(columns, measured_temperatures, rcond=None)[0]
            return unknowns, float(np.sum((columns @ unknowns - measured_temperatures) ** 2))

        optimum = minimize_scalar(
            lambda log_time: solve_heating(float(np.exp(log_time)))[1],
            bounds=np.log(_TIME_CONSTANT_BOUNDS),
            method="bounded",
        )
        time = float(np.exp(optimum.x))
        resistance, ambient = map(float, solve_heating(time)[0][:2])
        return replace(
            thermal, resistance=max(resistance, 0.0), time_constant=time, ambient=ambient
        )
