"""Equations (Table I), hysteresis state (Fig. 2), ablation, plots and physics of laws."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from cosim.report.figures.chart import Line, Panel
from cosim.report.figures.plots import sheets
from cosim.report.figures.style import Stroke, strokes
from cosim.report.results import Results
from cosim.report.tables.laws import audit as audit_table
from cosim.report.tables.laws import properties as properties_table
from cosim.report.tables.table import (
    ResultTable,
    TableCell,
    fixed_cell,
    join_law_titles,
    make_row,
    number,
    title,
)
from cosim.study.scores import MEASURED_START, REFERENCE
from fmu_src.friction.friction_component import is_exposed
from fmu_src.pages.datasheet import describe_certificate
from fmu_src.pages.live import live_assets, live_section, read_live_data
from fmu_src.pages.mathml import equations as typeset
from fmu_src.pages.mathml import symbol
from fmu_src.run.archive import Archive
from hesr_model.audit.audit import ENCODER_NOISE
from hesr_model.audit.properties import combine_results
from hesr_model.errors import ArtifactError
from hesr_model.fitting.estimator import papers_law, registry
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.support import plugins

_INTERVAL = 1.96  # half width of a 95 % interval in standard errors
_FREQUENCY = 0.25  # frequency of the paper's sine [Hz]
_ROWS = 801  # number of points of a period
_FACTORS = {0.25: "a quarter", 1.0: "as fitted", 4.0: "four times"}  # factors on alpha and beta
_SPEED = 1.2  # peak velocity [rad/s] if no trained range is known
_PAGE = "documentation/index.html"
_DATA = re.compile(r'<script type="application/json">(.*?)</script>', re.DOTALL)


def equations(results: Results) -> dict[str, Any]:
    """Typeset the recommended law and ParFam-H; return the coefficients of all."""
    entries = [
        {
            "title": title(law_name),
            "joints": [
                (short, typeset(friction_law, numbers=is_exposed(friction_law)))
                for short, friction_law in zip(
                    results.joints, results.models[law_name].laws, strict=True
                )
            ],
        }
        for law_name in results.find_fitted(*results.recommended, papers_law())
    ]
    coefficients = {
        law_name: _coefficients(results, model)
        for law_name, model in results.models.items()
        if model.size and all(map(is_exposed, model.laws))
    }
    return {"laws": entries, "coefficients": coefficients}


def _coefficients(results: Results, model: FrictionModel) -> ResultTable:
    coefficients = {
        quantity.name: quantity for law in model.laws for quantity in law.form.coefficients
    }

    def cell(law: FrictionLaw, name: str) -> TableCell:
        error = law.standard_errors.get(name)
        notes = () if error is None else (f"± {_INTERVAL * error:.2g}",)
        return number(law.values.get(name), 4, notes=notes)

    return ResultTable(
        caption=f"Coefficients of {title(model.law)}; ± 1.96 standard errors of linearised "
        "least squares, conditional on coefficients without one, which are at a bound",
        words=(1,),
        head=("coefficient", "unit", *results.joints),
        rows=[
            make_row(
                Markup("{} {}").format(Markup(symbol(name)), quantity.description),
                "–" if quantity.unit == "1" else quantity.unit,
                *(cell(law, name) for law in model.laws),
            )
            for name, quantity in coefficients.items()
        ],
    )


def hysteresis(results: Results) -> dict[str, Any] | None:
    """Draw the effect of alpha and beta at the values fitted to the first joint."""
    model = results.models.get(papers_law())
    if model is None:
        return None
    named_laws = zip(results.joints, model.laws, strict=True)
    # Without an effect of h, a law has no such state.
    pairs = [(n, law) for n, law in named_laws if any(r.name == "h" for r in law.form.relaxations)]
    if not pairs or not {"alpha", "beta"} <= set(pairs[0][1].values):
        return None
    first_law = pairs[0][1]
    alpha = first_law.values["alpha"]
    beta = first_law.values["beta"]
    speed = model.trained[0].speed if model.trained else _SPEED
    small_speeds = np.linspace(-4.0 / beta, 4.0 / beta, 201)
    styles = strokes(list(_FACTORS.values()))
    slopes = tuple(
        Line(
            name=name,
            x=1e3 * small_speeds,
            y=np.tanh(factor * beta * small_speeds),
            stroke=styles[name],
        )
        for factor, name in _FACTORS.items()
    )
    widths = tuple(
        _loop(
            replace(first_law, values={**first_law.values, "alpha": factor * alpha}),
            speed,
            name,
            styles,
        )
        for factor, name in _FACTORS.items()
    )
    styles = strokes(results.joints)
    fitted_loops = tuple(_loop(law, speed, short, styles) for short, law in pairs)
    slow_label, speed_label = (f"dq [{results.unit(unit, 0)}]" for unit in ("mrad/s", "rad/s"))
    picture = sheets(
        (
            (slow_label, Panel(title="(a) β: slope at rest", y="tanh(β dq)", lines=slopes)),
            (speed_label, Panel(title="(b) α: width of the loop", y="h", lines=widths)),
            (
                f"dq [{results.unit('rad/s')}]",
                Panel(title="(c) as fitted", y="h", lines=fitted_loops),
            ),
        )
    )
    return {
        "values": "; ".join(
            f"{short} ({law.values['alpha']:.4g}, {law.values['beta']:.4g})" for short, law in pairs
        ),
        "picture": picture,
        "frequency": f"{_FREQUENCY:g}",
    }


def _loop(law: FrictionLaw, speed: float, name: str, styles: Mapping[str, Stroke]) -> Line:
    relaxation = next(r for r in law.form.relaxations if r.name == "h")
    state_law = replace(
        law, form=replace(law.form, output=relaxation.state), discretisation="exact"
    )
    t = np.linspace(0.0, 2.0 / _FREQUENCY, 2 * _ROWS - 1)
    dq = speed * np.sin(2.0 * np.pi * _FREQUENCY * t)
    return Line(
        name=name, x=dq[-_ROWS:], y=predict(state_law, t=t, dq=dq)[-_ROWS:], stroke=styles[name]
    )


def ablation(results: Results) -> dict[str, Any] | None:
    """Return the change of the error with each added part."""
    test = results.tests[0]
    laws = results.comparisons[test].laws
    steps = [(a, b, part) for a, b, part in _steps() if a in laws and b in laws]
    variants = [n for n in results.run.variants if n in laws and not n.endswith("_relaxed")]
    tables = {}
    if variants:
        full_law = results.run.variants[variants[-1]]
        ladder = [*variants, *([full_law] if full_law in laws else [])]
        tables["variants"] = ResultTable(
            caption=f"{test}: RMSE [{results.unit('N.m')}] of the variants, each with one part "
            "more than that above it",
            head=("variant", *results.joints),
            rows=[
                make_row(title(law_name), *map(number, laws[law_name].rmse)) for law_name in ladder
            ],
        )
    if steps:
        tables["steps"] = ResultTable(
            caption=f"{test}: change of the RMSE when one part is added; lower is better",
            words=(1,),
            head=("from, to", "adds", *results.joints),
            rows=[
                make_row(f"{title(a)} → {title(b)}", part, *_changes(laws[a].rmse, laws[b].rmse))
                for a, b, part in steps
            ],
        )
    return {"tables": tables} if tables else None


def _steps() -> Iterator[tuple[str, str, str]]:
    for name, law in registry().items():
        if law.adds is not None:
            yield law.adds[0], name, law.adds[1]
        yield name, name + MEASURED_START, "a measured start"


def _changes(before: Sequence[float], after: Sequence[float]) -> list[str]:
    changes = [100.0 * (b / a - 1.0) for a, b in zip(before, after, strict=True)]
    return [f"{c:+.0f} %".replace("-", "−") if round(c) else "0 %" for c in changes]


def live(results: Results) -> dict[str, Any] | None:
    """Return the interactive plots of the recommended law, ParFam-H and the reference."""
    laws = dict.fromkeys((Path(results.fmu).stem, *results.find_fitted(papers_law(), REFERENCE)))
    data_by_law = {
        law_name: _live_data(results.folder / "fmus" / f"{law_name}.fmu") for law_name in laws
    }
    lives = [
        (law_name, title(law_name), Markup(live_section(data, key=f"live-{law_name}")))
        for law_name, data in data_by_law.items()
        if data is not None
    ]
    return {"lives": lives, "assets": Markup(live_assets())} if lives else None


def _live_data(fmu: Path) -> dict[str, Any] | None:
    try:
        with Archive(fmu) as archive:
            match = _DATA.search(archive.read(_PAGE).decode("utf-8"))
        return read_live_data(match[1], fmu) if match else None
    except (ArtifactError, UnicodeDecodeError):
        return None


_ROUNDING = 1e-6  # energy of round-off [J]


def audit(results: Results) -> dict[str, Any] | None:
    """Return the figures of the audit of every law."""
    audits = results.audits
    if not audits:
        return None
    energy = ResultTable(
        caption="Maximum energy of a law over a closed cycle [J], and chatter of its torque at "
        f"rest [{results.unit('N.m')}]",
        head=(
            "law",
            *(f"{quantity} {j}" for quantity in ("energy", "chatter") for j in results.joints),
        ),
        rows=[
            make_row(
                title(law_name),
                *(
                    TableCell(text="none", value=0.0)
                    if joint_audit.generated < _ROUNDING
                    else number(joint_audit.generated, 2)
                    for joint_audit in model_audit.audits
                ),
                *(fixed_cell(joint_audit.chatter, 2) for joint_audit in model_audit.audits),
            )
            for law_name, model_audit in audits.items()
        ],
    )
    proofs = ResultTable(
        caption="Passivity of each law and joint",
        head=("law", "joint", "certificate"),
        rows=[
            make_row(title(law_name), joint, describe_certificate(certificate, slides=slides))
            for law_name, model_audit in audits.items()
            for joint, certificate, slides in zip(
                results.joints,
                model_audit.certificates,
                results.models[law_name].slides,
                strict=True,
            )
        ],
        numeric=False,
    )
    return {
        "noise": f"{1e6 * ENCODER_NOISE:.0f}",
        "energy": energy,
        "proofs": proofs,
        "proven": sum(
            all(certificate.verdict == "proven" for certificate in model_audit.certificates)
            for model_audit in audits.values()
        ),
        "passive": sum(
            all(joint_audit.generated < _ROUNDING for joint_audit in model_audit.audits)
            for model_audit in audits.values()
        ),
        "audits": [
            (law_name, audit_table(law_name, model_audit.audits, results.sliding))
            for law_name, model_audit in audits.items()
        ],
    }


def properties(results: Results) -> dict[str, Any] | None:
    """Return the results of the checks, and plots of the recommended law."""
    if not results.properties:
        return None
    laws = results.recommended
    properties = combine_results(join_law_titles(laws), results.properties, laws)
    sheet = plugins.load("hesr.sheets").get("properties")  # of the extras
    return {
        "properties": properties_table(results.properties, full=True),
        "law": join_law_titles(laws),
        "sheet": properties and sheet and Markup(sheet.load()(properties, sliding=results.sliding)),
    }
