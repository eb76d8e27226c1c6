"""documentation/index.html of FMUs: data sheets of friction, pages of drives and plants."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import count
from pathlib import PurePosixPath
from typing import Any

import numpy as np
import sympy

from fmu_src.export.description import Description
from fmu_src.export.interface import Interface
from fmu_src.friction.friction_component import DISCRETISATION, is_exposed
from fmu_src.friction.reference import SETTINGS, Error, reference_motion
from fmu_src.pages import datasheet
from fmu_src.pages.block_page import variable_groups
from fmu_src.pages.datasheet import ModelAudit, figure, spell_interval
from fmu_src.pages.html import render_template
from fmu_src.pages.mathml import equations, symbol
from hesr_model.equations.functions import sgn
from hesr_model.equations.program import STEEP, Jumps
from hesr_model.errors import ArtifactError, HesrError
from hesr_model.fitting.estimator import estimator
from hesr_model.fitting.uncertainty import MAX_COEFFICIENTS
from hesr_model.friction.band import find_rest_speed
from hesr_model.friction.inputs import INPUT_UNITS, INPUTS, TAU_LOAD
from hesr_model.friction.law import FrictionLaw, form_lines
from hesr_model.friction.law import equations as equations_with_numbers
from hesr_model.friction.model import MIXED, FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.robots.description import statements
from hesr_model.support.arrays import Array
from hesr_model.support.text import join_with_and
from hesr_model.units import unit_of_joints

_CRAWL_SPEED = 1e-9
_CRAWL_DURATION = 1e12
"""Speed [rad/s] and duration [s] of the crawling motion that reveals the torque held at rest."""
_MIN_HOLDING_TORQUE = 0.01  # [N.m]; less counts as zero


def drive_html(
    model: FrictionModel, interface: Interface, about: Description, template: str = "drive.html.j2"
) -> str:
    """Return the page as one self-contained file."""
    joints, refused = law_entries(model)
    pairs = zip(model.joints, model.laws, strict=True)
    return render_template(
        template,
        about=about,
        model=model,
        exchange=interface.model_exchange,
        titles=list(dict.fromkeys(title(law) for law in model.laws)),
        substep=interface.variables[interface.places["substep"]].start,
        discretisation=model.laws[0].discretisation,
        loaded=[name for name, law in pairs if TAU_LOAD in law.form.inputs],
        joints=joints,
        refused=refused,
        groups=variable_groups(interface),
        arrays=[array.name for array in interface.arrays],
    )


def law_entries(model: FrictionModel) -> tuple[list[dict[str, Any]], str]:
    """Return a page's entry for each joint's law, and the reason for a missing audit or ""."""
    audits, refused = datasheet.audit_laws(model)
    verdicts = [datasheet.verdict(a, is_trained=bool(model.trained)) for a in audits]
    verdicts = verdicts or [""] * len(model.laws)
    rows = zip(model.joints, model.laws, model.slides, verdicts, strict=True)
    joints: list[dict[str, Any]] = [
        {
            "name": name,
            "equations": equations(law),
            "rest": _describe_standstill(law, slides=slides),
            "verdict": verdict,
        }
        for name, law, slides, verdict in rows
    ]
    return joints, refused


def holding_torque(law: FrictionLaw) -> float:
    """Return the largest torque [N.m] that a law holds at rest, without load.

    It is half the change of torque between steady crawling in both directions, and 0 for a law that
    forgets at rest.
    """
    return float(_predict_sliding(law, np.array([_CRAWL_SPEED]))[0])


def stopping_torque(law: FrictionLaw) -> float:
    """Return the least friction torque [N.m] over all speeds, below which no motion lasts."""
    return float(np.min(_predict_sliding(law, np.geomspace(_CRAWL_SPEED, 1.0, 200))))


def _predict_sliding(law: FrictionLaw, speeds: Array) -> Array:
    """Return the friction torque in steady sliding at speeds [rad/s], without offset."""
    exact_law = replace(law, discretisation="exact")
    # The first row has no previous step.
    signed_speeds = np.concatenate([[0.0], speeds, -speeds])
    t = _CRAWL_DURATION * np.arange(len(signed_speeds))
    tau = predict(exact_law, t=t, dq=signed_speeds)[1:]
    return np.asarray(0.5 * (tau[: len(speeds)] - tau[len(speeds) :]))


def _describe_standstill(law: FrictionLaw, *, slides: bool) -> str:
    effort = "torque"
    unit = "N.m"
    if slides:
        effort = "force"
        unit = "N"
    with np.errstate(all="ignore"):  # non-finite values hold nothing
        holding = holding_torque(law)
        stopping = stopping_torque(law)
    if holding > _MIN_HOLDING_TORQUE:
        return (
            f"At rest this law holds up to {figure(holding, 3)} {unit} without load; a {effort} "
            f"below {figure(max(stopping, 0.0), 3)} {unit} lets no motion last."
        )
    return (
        "At rest this law holds nothing: it forgets where it came to rest, and the joint creeps "
        f"under any {effort}."
    )


_INTERVAL = 1.96  # standard errors of a two-sided 95 % interval
_UNITS = {**INPUT_UNITS, "tau": "N.m", "dtau_ddq": "N.m.s/rad"}
_RANGES = (*INPUT_UNITS, "tau")


def to_html(
    model: FrictionModel,
    interface: Interface,
    about: Description,
    *,
    live: str = "",
    properties: str = "",
    audit: ModelAudit | None = None,
) -> str:
    """Return the page, with the HTML of an interactive section and of the properties, if any.

    It needs only `model.png` next to its folder. The audit is computed by default.
    """
    units = {name: unit_of_joints(unit, model.sliding) for name, unit in _UNITS.items()}
    used_symbols: set[sympy.Symbol] = set()
    for law in model.laws:
        used_symbols |= set(law.form.inputs)
    titles = list(dict.fromkeys(title(law) for law in model.laws))
    start = interface.variables[interface.places["discretisation"]].start
    training_rmse = {}
    if model.training_rmse:
        label = f"RMSE on the training logs [{units['tau']}]"
        training_rmse[label] = [f"{error:.3g}" for error in model.training_rmse]
    return render_template(
        "index.html.j2",
        about=about,
        model=model,
        live=live,
        properties=properties,
        groups=variable_groups(interface),
        titles=titles,
        unused=[f"{symbol.name}[i]" for symbol in INPUTS if symbol not in used_symbols],
        discretisation=DISCRETISATION.items[int(start) - 1][0],
        joints=list(map(_joint, count(1), model.joints, model.laws)),
        events=bool(interface.indicators),
        steep=STEEP,
        training=training(model.provenance),
        units=units,
        trained_rows=_trained_rows(model.trained, units),
        training_rmse=training_rmse,
        band_rows=_band_rows(model, units),
        **_collect_audit(model, audit),
    )


def title(law: FrictionLaw, otherwise: str | None = None) -> str:
    """Return the registry's title of a law, else its own name, else the default."""
    try:
        return estimator(law.name).title
    except ArtifactError:
        if otherwise is None:
            return law.name
        return otherwise


def model_title(model: FrictionModel) -> str:
    """Return the titles of a model's laws, or its own name if the registry does not have it."""
    if model.law != MIXED and model.law not in {law.name for law in model.laws}:
        return model.law
    titles = list(dict.fromkeys(title(law) for law in model.laws))
    return join_with_and(titles)


def _explain_intervals(law: FrictionLaw) -> str:
    """Explain the intervals of the coefficients, or why they are missing."""
    if not law.values:
        return "The law has no coefficients."
    if law.standard_errors:
        text = "The 95 % intervals are 1.96 standard errors of linearised least squares."
        if len(law.standard_errors) < len(law.values):
            text += (
                " A dash marks a coefficient that is fixed or at a bound of its search; the other "
                "intervals are conditional on it."
            )
        return text
    if law.covariance is not None:
        return (
            "Single coefficients have no interval, because the data also chose the terms of the "
            "law. Their covariance is in resources/friction_model.json."
        )
    if len(law.values) > MAX_COEFFICIENTS:
        return (
            "Single coefficients have no interval: those of a network have no meaning of their own."
        )
    return "The uncertainty of the coefficients is unknown: the model has no covariance."


_SLOW_SHARE = 0.1  # of the trained speed


def _band_rows(model: FrictionModel, units: Mapping[str, str]) -> dict[str, list[str]]:
    """Return half-widths of the bands in motion, a cell per joint; none without bands."""
    bands = [law.band for law in model.laws if law.band is not None]
    if len(bands) < len(model.laws) or not model.trained:
        return {}
    rest_speeds = [find_rest_speed(law.form.steady_speed) for law in model.laws]
    speeds = [max(map(abs, trained_range.dq)) for trained_range in model.trained]
    loads = [max(map(abs, trained_range.tau_load)) for trained_range in model.trained]
    rows: dict[str, list[str]] = {}
    for label, share, load_share in (
        ("at a tenth of the trained speed", _SLOW_SHARE, 0.0),
        ("at the trained speed", 1.0, 0.0),
        ("the same under the largest trained load", 1.0, 1.0),
    ):
        widths = []
        for band, rest_speed, speed, load in zip(bands, rest_speeds, speeds, loads, strict=True):
            half_width = band.half_width(share * speed, load_share * load, rest_speed=rest_speed)
            widths.append(f"± {figure(half_width, 2)}")
        rows[f"95 % band, {label} [{units['tau']}]"] = widths
    return rows


def _joint(number: int, name: str, law: FrictionLaw) -> dict[str, Any]:
    """Return the template's data of a joint."""
    exposed = is_exposed(law)
    numbers: list[str] = []
    if exposed:  # equations of networks with numbers are not readable
        numbers = equations_with_numbers(law)
    switches = {}
    for z in Jumps(law.form.component).expressions:
        switches[str(z).replace("absolute(", "abs(")] = figure(_half_jump(law, z))
    return {
        "number": number,
        "name": name,
        "law": title(law),
        "equations": equations(law),
        "text": form_lines(law.form),
        "numbers": numbers,
        "rows": _rows(law, number),
        "exposed": exposed,
        "intervals": bool(law.standard_errors),
        "uncertainty": _explain_intervals(law),
        "states": [element.name for element in law.form.memory],
        "starts": [figure(value, 6) for value in law.start],
        "start_samples": law.start_samples,
        "switches": switches,
    }


def _half_jump(law: FrictionLaw, z: sympy.Expr) -> float:
    """Return half of the jump of the torque at z = 0, without load and memory; 0 for a bend."""
    output = law.form.output
    numbers = dict.fromkeys(output.free_symbols, 0.0)
    numbers |= {quantity.symbol: law.values[quantity.name] for quantity in law.form.coefficients}

    def evaluate_beside(sign: int) -> float:
        return float(output.xreplace({sgn(z): sympy.Integer(sign)}).subs(numbers))

    return abs(evaluate_beside(1) - evaluate_beside(-1)) / 2.0


def _rows(law: FrictionLaw, number: int) -> list[dict[str, str]]:
    """Return the table of a law's coefficients."""
    prefix = ""
    if is_exposed(law):
        prefix = f"joint[{number}]."
    rows = []
    for quantity in law.form.coefficients:
        value = law.values[quantity.name]
        interval = "–"
        if quantity.name in law.standard_errors:
            interval = f"± {figure(_INTERVAL * law.standard_errors[quantity.name], 2)}"
        unit = "–"
        if quantity.unit != "1":
            unit = quantity.unit
        row = {
            "symbol": symbol(quantity.name),
            "name": f"{prefix}{quantity.name}",
            "value": figure(value, 6),
            "exact": f"{value:.17g}",
            "interval": interval,
            "unit": unit,
            "text": quantity.description,
        }
        rows.append(row)
    return rows


def training(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the provenance of the model, with file names but without folders."""
    files = []
    for record in provenance.get("files") or ():
        if isinstance(record, Mapping):
            path = PurePosixPath(str(record.get("name", "")).replace("\\", "/"))
            files.append({"name": path.name, "sha256": str(record.get("sha256", ""))})
    remarks = list(statements(provenance))
    remarks += [str(provenance[key]) for key in ("source", "note") if provenance.get(key)]
    versions = provenance.get("versions") or {}
    return {
        "remarks": remarks,
        "files": files,
        "seed": provenance.get("seed"),
        "versions": ", ".join(f"{name} {number}" for name, number in versions.items()),
    }


def _trained_rows(
    trained_ranges: Sequence[TrainedRange], units: Mapping[str, str]
) -> dict[str, list[str]]:
    if not trained_ranges:
        return {}
    rows = {}
    for name in _RANGES:
        intervals = [getattr(trained_range, name) for trained_range in trained_ranges]
        rows[f"{name} [{units[name]}]"] = list(map(spell_interval, intervals))
    sample_times = [trained_range.sample_time for trained_range in trained_ranges]
    rows["sample time [s]"] = list(map(figure, sample_times))
    return rows


def _collect_audit(model: FrictionModel, audit: ModelAudit | None) -> dict[str, Any]:
    template_values: dict[str, Any] = dict.fromkeys(("rates", "certified", "verdicts", "costs"), ())
    template_values |= {"audit": {}, "refused": "", "costs_refused": ""}
    motion = reference_motion(model)
    slides = model.slides
    is_trained = bool(model.trained)
    try:
        trained_ranges = datasheet.ranges(model, motion)
        template_values["rates"] = list(map(_rate_rows, model.laws, trained_ranges))
        if audit is None:
            proofs = datasheet.certificates(model, trained_ranges)
        else:
            proofs = audit.certificates
        pairs = zip(proofs, slides, strict=True)
        template_values["certified"] = [
            datasheet.describe_certificate(c, slides=s) for c, s in pairs
        ]
        audits = datasheet.audits(model, trained_ranges) if audit is None else audit.audits
        template_values["audit"] = datasheet.audit_rows(audits, model.sliding)
        rows = zip(audits, slides, strict=True)
        template_values["verdicts"] = [
            datasheet.verdict(a, is_trained=is_trained, slides=s) for a, s in rows
        ]
    except HesrError as error:
        template_values["refused"] = str(error)
    try:
        costs = datasheet.costs(model, motion)
        template_values["costs"] = {truth: _cost_rows(rows) for truth, rows in costs.items()}
    except HesrError as error:
        template_values["costs_refused"] = str(error)
    return template_values


def _cost_rows(costs: Mapping[str, Sequence[Error]]) -> dict[str, list[tuple[str, str]]]:
    """Return a row per convention, with the errors of each joint over all rows and at reversals."""
    rows = {}
    for setting, joint_errors in costs.items():
        cells = [(_torque(error.rmse), _torque(error.rmse_reversal)) for error in joint_errors]
        rows[f"{setting}: {SETTINGS[setting]}"] = cells
    return rows


def _torque(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.2f}"


def _rate_rows(law: FrictionLaw, trained_range: TrainedRange) -> list[dict[str, str]]:
    rows = []
    for name, rate in datasheet.find_fastest_rates(law, trained_range).items():
        row = {"name": name, "rate": figure(rate, 3), "rk4": "any", "euler": "any"}
        if rate > 0.0:
            row["rk4"] = f"{1e3 * datasheet.RK4 / rate:.3g} ms"
            row["euler"] = f"{1e3 * datasheet.EULER / rate:.3g} ms"
        rows.append(row)
    return rows
