"""Equations (Table I), hysteresis state (Fig. 2), ablation, plots and physics of laws."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

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
from hesr_model.audit.audit import ENCODER_NOISE, Audit
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
    entries = []
    for law_name in results.find_fitted(*results.recommended, papers_law()):
        joint_equations = [
            (short, typeset(friction_law, numbers=is_exposed(friction_law)))
            for short, friction_law in zip(
                results.joints, results.models[law_name].laws, strict=True
            )
        ]
        entries.append({"title": title(law_name), "joints": joint_equations})
    coefficients = {
        law_name: _coefficients(results, model)
        for law_name, model in results.models.items()
        if model.size and all(map(is_exposed, model.laws))
    }
    return {"laws": entries, "coefficients": coefficients}


def _coefficients(results: Results, model: FrictionModel) -> ResultTable:
    """Return the coefficients of a model by joint, with half widths of their intervals."""
    rows = []
    quantities = chain.from_iterable(law.form.coefficients for law in model.laws)
    for name, quantity in {quantity.name: quantity for quantity in quantities}.items():
        head = Markup("{} {}").format(Markup(symbol(name)), quantity.description)
        unit = "–" if quantity.unit == "1" else quantity.unit
        rows.append(make_row(head, unit, *(_coefficient_cell(law, name) for law in model.laws)))
    return ResultTable(
        caption=f"Coefficients of {title(model.law)}; ± 1.96 standard errors of linearised "
        "least squares, conditional on coefficients without one, which are at a bound",
        words=(1,),
        head=("coefficient", "unit", *results.joints),
        rows=rows,
    )


def _coefficient_cell(law: FrictionLaw, name: str) -> TableCell:
    error = law.standard_errors.get(name)
    notes = () if error is None else (f"± {_INTERVAL * error:.2g}",)
    return number(law.values.get(name), 4, notes=notes)


def hysteresis(results: Results) -> dict[str, Any] | None:
    """Draw the effect of alpha and beta at the values fitted to the first joint."""
    model = results.models.get(papers_law())
    if model is None:
        return None
    laws = {
        short: law
        for short, law in zip(results.joints, model.laws, strict=True)
        if _has_hysteresis_state(law)
    }
    if not laws:
        return None
    first_law = next(iter(laws.values()))
    if not {"alpha", "beta"} <= set(first_law.values):
        return None
    speed = model.trained[0].speed if model.trained else _SPEED
    styles = strokes(results.joints)
    fitted_loops = tuple(_loop(law, speed, short, styles) for short, law in laws.items())
    slopes = Panel(title="(a) β: slope at rest", y="tanh(β dq)", lines=_draw_slopes(first_law))
    widths = Panel(title="(b) α: width of the loop", y="h", lines=_draw_widths(first_law, speed))
    fitted = Panel(title="(c) as fitted", y="h", lines=fitted_loops)
    picture = sheets(
        (
            (f"dq [{results.unit('mrad/s', 0)}]", slopes),
            (f"dq [{results.unit('rad/s', 0)}]", widths),
            (f"dq [{results.unit('rad/s')}]", fitted),
        )
    )
    values = [
        f"{short} ({law.values['alpha']:.4g}, {law.values['beta']:.4g})"
        for short, law in laws.items()
    ]
    return {"values": "; ".join(values), "picture": picture, "frequency": f"{_FREQUENCY:g}"}


def _has_hysteresis_state(law: FrictionLaw) -> bool:
    """Return whether a law has the state h; without an effect of h the fit removes it."""
    return any(relaxation.name == "h" for relaxation in law.form.relaxations)


def _draw_slopes(law: FrictionLaw) -> tuple[Line, ...]:
    """Draw the shape at low speed for `_FACTORS` on beta."""
    beta = law.values["beta"]
    styles = strokes(list(_FACTORS.values()))
    # Four times the speed 1/beta shows the slope and its saturation: tanh(4) = 0.999.
    dq = np.linspace(-4.0 / beta, 4.0 / beta, 201)
    lines = []
    for factor, name in _FACTORS.items():
        y = np.tanh(factor * beta * dq)
        lines.append(Line(name=name, x=1e3 * dq, y=y, stroke=styles[name]))
    return tuple(lines)


def _draw_widths(law: FrictionLaw, speed: float) -> tuple[Line, ...]:
    """Draw loops of h for `_FACTORS` on alpha."""
    styles = strokes(list(_FACTORS.values()))
    lines = []
    for factor, name in _FACTORS.items():
        values = {**law.values, "alpha": factor * law.values["alpha"]}
        lines.append(_loop(replace(law, values=values), speed, name, styles))
    return tuple(lines)


def _loop(law: FrictionLaw, speed: float, name: str, styles: Mapping[str, Stroke]) -> Line:
    """Draw h over the velocity [rad/s] of a sine, in its second period, without the start."""
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
    tables = {}
    variants = [n for n in results.run.variants if n in laws and not n.endswith("_relaxed")]
    if variants:
        ladder = list(variants)
        full_law = results.run.variants[variants[-1]]
        if full_law in laws:
            ladder.append(full_law)
        tables["variants"] = ResultTable(
            caption=f"{test}: RMSE [{results.unit('N.m')}] of the variants, each with one part "
            "more than that above it",
            head=("variant", *results.joints),
            rows=[
                make_row(title(law_name), *map(number, laws[law_name].rmse)) for law_name in ladder
            ],
        )
    step_rows = []
    for step in _list_steps():
        if step.simpler in laws and step.fuller in laws:
            changes = _format_changes(laws[step.simpler].rmse, laws[step.fuller].rmse)
            head = f"{title(step.simpler)} → {title(step.fuller)}"
            step_rows.append(make_row(head, step.part, *changes))
    if step_rows:
        tables["steps"] = ResultTable(
            caption=f"{test}: change of the RMSE when one part is added; lower is better",
            words=(1,),
            head=("from, to", "adds", *results.joints),
            rows=step_rows,
        )
    return {"tables": tables} if tables else None


class _Step(NamedTuple):
    """Two laws of which the fuller one has one part more."""

    simpler: str
    fuller: str
    part: str


def _list_steps() -> Iterator[_Step]:
    """Yield the steps between all laws."""
    for name, law in registry().items():
        if law.adds is not None:
            simpler, part = law.adds
            yield _Step(simpler, name, part)
        yield _Step(name, name + MEASURED_START, "a measured start")


def _format_changes(before: Sequence[float], after: Sequence[float]) -> list[str]:
    changes = [100.0 * (b / a - 1.0) for a, b in zip(before, after, strict=True)]
    return list(map(_format_change, changes))


def _format_change(percent: float) -> str:
    if round(percent) == 0:
        return "0 %"  # without the sign of what rounding removes
    return f"{percent:+.0f} %".replace("-", "−")


def live(results: Results) -> dict[str, Any] | None:
    """Return the interactive plots of the recommended law, ParFam-H and the reference."""
    laws = dict.fromkeys((Path(results.fmu).stem, *results.find_fitted(papers_law(), REFERENCE)))
    lives = []
    for law_name in laws:
        data = _live_data(results.folder / "fmus" / f"{law_name}.fmu")
        if data is not None:
            section = Markup(live_section(data, key=f"live-{law_name}"))
            lives.append((law_name, title(law_name), section))
    if not lives:
        return None
    return {"lives": lives, "assets": Markup(live_assets())}


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
    audit_tables = []
    proven_count = 0
    passive_count = 0
    for law_name, model_audit in audits.items():
        table = audit_table(law_name, model_audit.audits, results.sliding)
        audit_tables.append((law_name, table))
        proven_count += all(proof.verdict == "proven" for proof in model_audit.certificates)
        passive_count += all(map(_is_passive, model_audit.audits))
    return {
        "noise": f"{1e6 * ENCODER_NOISE:.0f}",
        "energy": _tabulate_energy(results),
        "proofs": _tabulate_proofs(results),
        "proven": proven_count,
        "passive": passive_count,
        "audits": audit_tables,
    }


def _is_passive(joint_audit: Audit) -> bool:
    """Return whether no cycle generates more energy than round-off does."""
    return joint_audit.generated < _ROUNDING


def _tabulate_energy(results: Results) -> ResultTable:
    """Return generated energy and chatter by law and joint."""
    heads = []
    for quantity in ("energy", "chatter"):
        heads += [f"{quantity} {joint}" for joint in results.joints]
    rows = []
    for law_name, model_audit in results.audits.items():
        energy_cells = map(_energy_cell, model_audit.audits)
        chatter_cells = [fixed_cell(joint_audit.chatter, 2) for joint_audit in model_audit.audits]
        rows.append(make_row(title(law_name), *energy_cells, *chatter_cells))
    return ResultTable(
        caption="Maximum energy of a law over a closed cycle [J], and chatter of its torque at "
        f"rest [{results.unit('N.m')}]",
        head=("law", *heads),
        rows=rows,
    )


def _energy_cell(joint_audit: Audit) -> TableCell:
    if _is_passive(joint_audit):
        return TableCell(text="none", value=0.0)
    return number(joint_audit.generated, 2)


def _tabulate_proofs(results: Results) -> ResultTable:
    """Return the certificate of each law and joint."""
    rows = []
    for law_name, model_audit in results.audits.items():
        joint_proofs = zip(
            results.joints,
            model_audit.certificates,
            results.models[law_name].slides,
            strict=True,
        )
        for joint, certificate, slides in joint_proofs:
            sentence = describe_certificate(certificate, slides=slides)
            rows.append(make_row(title(law_name), joint, sentence))
    return ResultTable(
        caption="Passivity of each law and joint",
        head=("law", "joint", "certificate"),
        rows=rows,
        numeric=False,
    )


def properties(results: Results) -> dict[str, Any] | None:
    """Return the results of the checks, and plots of the recommended law."""
    if not results.properties:
        return None
    laws = results.recommended
    law_titles = join_law_titles(laws)
    properties = combine_results(law_titles, results.properties, laws)
    plugin = plugins.load("hesr.sheets").get("properties")  # of the extras
    sheet = None
    if properties and plugin:
        sheet = Markup(plugin.load()(properties, sliding=results.sliding))
    return {
        "properties": properties_table(results.properties, full=True),
        "law": law_titles,
        "sheet": sheet,
    }
