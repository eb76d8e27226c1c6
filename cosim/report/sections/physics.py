"""Physics of laws: passivity audit and physics checks."""

from typing import Any

from markupsafe import Markup

from cosim.report.results import Results
from cosim.report.tables import table
from cosim.report.tables.laws import audit as audit_table
from cosim.report.tables.properties import properties as properties_table
from fmu_src.pages.datasheet import certified
from fmu_src.pages.datasheet import properties_section as sheet
from hesr_model.audit.cycles import ENCODER
from hesr_model.audit.properties import combined

_ROUNDING = 1e-6  # energy of round-off [J]


def audit(results: Results) -> dict[str, Any] | None:
    """Return the figures of the audit of every law."""
    if not (found := results.audits):
        return None
    energy = table.ResultTable(
        caption="Maximum energy of a law over a closed cycle [J], and chatter of its torque at "
        f"rest [{results.unit('N.m')}]",
        head=(
            "law",
            *(f"energy {short}" for short in results.joints),
            *(f"chatter {short}" for short in results.joints),
        ),
        rows=[
            table.row_of(
                table.title(law),
                *(
                    table.TableCell(text="none", value=0.0)
                    if a.generated < _ROUNDING
                    else table.number(a.generated, 2)
                    for a in of_law.audits
                ),
                *(table.fixed(a.chatter, 2) for a in of_law.audits),
            )
            for law, of_law in found.items()
        ],
    )
    proofs = table.ResultTable(
        caption="Passivity of each law and joint",
        head=("law", "joint", "certificate"),
        rows=[
            table.row_of(table.title(law), joint, certified(c, slides=slides))
            for law, of_law in found.items()
            for joint, c, slides in zip(
                results.joints, of_law.certificates, results.models[law].slides, strict=True
            )
        ],
        numeric=False,
    )
    return {
        "noise": f"{1e6 * ENCODER:.0f}",
        "energy": energy,
        "proofs": proofs,
        "proven": sum(
            all(c.verdict == "proven" for c in of_law.certificates) for of_law in found.values()
        ),
        "passive": sum(all(a.generated < _ROUNDING for a in of.audits) for of in found.values()),
        "audits": [
            (law, audit_table(law, of.audits, results.sliding)) for law, of in found.items()
        ],
    }


def properties(results: Results) -> dict[str, Any] | None:
    """Return the results of the checks, and plots of the recommended law."""
    if not results.properties:
        return None
    laws = results.recommended
    of_law = combined(table.on_joints(laws), results.properties, laws)
    return {
        "properties": properties_table(results.properties, full=True),
        "law": table.on_joints(laws),
        "sheet": of_law and Markup(sheet(of_law, sliding=results.sliding)),
    }
