"""documentation/index.html of a friction FMU."""

from pathlib import Path

import jinja2

from fmu_src.description import Description
from fmu_src.friction import DISCRETISATION, exposed
from fmu_src.interface import Interface
from hesr_model.friction.functions import INPUTS
from hesr_model.friction.law import FrictionLaw, FrictionModel


def to_html(model: FrictionModel, table: Interface, about: Description) -> str:
    """Return the page: equations, coefficients, units, step convention, how to connect."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        trim_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    used = {symbol for law in model.laws for symbol in law.form.inputs}
    start = table.variables[table.references["discretisation"]].start
    return environment.get_template("index.html.j2").render(
        about=about,
        model=model,
        unused=[f"{symbol.name}[i]" for symbol in INPUTS if symbol not in used],
        discretisation=DISCRETISATION.items[int(start) - 1][0],
        joints=[
            {"name": name, "equations": _equations(law), "rows": _rows(law, joint)}
            for joint, (name, law) in enumerate(zip(model.joints, model.laws, strict=True), start=1)
        ],
    )


def _equations(law: FrictionLaw) -> list[str]:
    relaxations = [
        f"{r.derivative} = {r.drive} - ({r.rate})*{r.state}" for r in law.form.relaxations
    ]
    return [*relaxations, f"tau = {law.form.output}"]


def _rows(law: FrictionLaw, joint: int) -> list[dict[str, str]]:
    prefix = f"joint[{joint}]." if exposed(law) else ""
    return [
        {
            "name": f"{prefix}{c.name}",
            "value": f"{law.values[c.name]:.17g}",
            "unit": c.unit,
            "text": c.description,
        }
        for c in law.form.coefficients
    ]
