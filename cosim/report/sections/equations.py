"""The laws as they were found (Table I)."""

from markupsafe import Markup

from cosim.report.markup import (
    Pictures,
    Section,
    details,
    heading,
    joined,
    paragraph,
    render,
    table,
)
from cosim.report.results import Results
from cosim.report.tables.table import ResultTable, TableCell, number, row_of, title
from fmu_src.friction.variable_names import exposed
from fmu_src.pages.mathml import equations, symbol
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.registry import papers_law

_INTERVAL = 1.96


def section(results: Results, pictures: Pictures) -> Section:
    """Typeset the paper's law and the best one in full, and the others folded away."""
    del pictures
    first = [law for law in dict.fromkeys((papers_law(), results.best)) if law in results.models]
    parts = [
        paragraph(
            Markup(
                "Numbers stand in the equations to four digits, as in Table I of the paper. "
                '<math><mover><mi>q</mi><mo class="dot">˙</mo></mover></math> is the velocity of '
                "the joint, <math><mi>q</mi></math> its position, <math><msub><mi>τ</mi><mi>load"
                "</mi></msub></math> its rigid-body torque; a dot is a derivative in time. The "
                "files in laws/ hold every digit."
            )
        )
    ]
    for law in first:
        parts += [heading(title(law)), _law(results, results.models[law])]
    others = [law for law in results.models if law not in first]
    parts += [details(title(law), _law(results, results.models[law])) for law in others]
    return Section(key="equations", title="Equations", html=joined(*parts))


def _law(results: Results, model: FrictionModel) -> Markup:
    shown = all(exposed(law) for law in model.laws)
    lines = [
        (short, equations(law, numbers=exposed(law)))
        for short, law in zip(results.joints, model.laws, strict=True)
    ]
    parts = [render("equations.html.j2", joints=lines)]
    if shown:
        parts.append(
            details("Coefficients with their 95 % intervals", table(_rows(results, model)))
        )
    else:
        parts.append(paragraph("A network: its weights stand in the file of the law.", note=True))
    return joined(*parts)


def _rows(results: Results, model: FrictionModel) -> ResultTable:
    coefficients = {c.name: c for law in model.laws for c in law.form.coefficients}
    return ResultTable(
        caption=f"Coefficients of {title(model.law)}; ± 1.96 standard errors of linearised "
        "least squares",
        words=(1,),
        head=("coefficient", "unit", *results.joints),
        rows=[
            row_of(
                Markup("{} {}").format(Markup(symbol(name)), c.description),
                "–" if c.unit == "1" else c.unit,
                *(
                    number(law.values[name], 4, notes=_notes(law.standard_errors.get(name)))
                    if name in law.values
                    else TableCell(text="–")
                    for law in model.laws
                ),
            )
            for name, c in coefficients.items()
        ],
    )


def _notes(error: float | None) -> tuple[str, ...]:
    return () if error is None else (f"± {_INTERVAL * error:.2g}",)
