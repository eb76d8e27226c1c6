"""Property battery: whether a law behaves as friction does."""

from markupsafe import Markup

from cosim.report.markup import Pictures, Section, details, joined, paragraph, table
from cosim.report.results import Results
from cosim.report.tables.properties import properties
from cosim.report.tables.table import title
from fmu_src.pages.properties_sheet import section as sheet
from hesr_model.friction.registry import papers_law


def section(results: Results, pictures: Pictures) -> Section | None:
    """Show which law has which property, and the plots of the paper's law and of the best one."""
    del pictures
    if not results.properties:
        return None
    shown = [
        law for law in dict.fromkeys((papers_law(), results.best)) if law in results.properties
    ]
    return Section(
        key="properties",
        title="Property battery",
        html=joined(
            paragraph(
                "Thirteen experiments on the FMUs, the same for every law. No law has to pass "
                "all of them; which ones it fails is what its user has to know. A cell has a mark "
                "for each joint: ✓ as the field expects of friction, ✗ not, n/a where the question "
                "does not arise."
            ),
            table(properties(results.properties, full=True)),
            *(
                details(f"{title(law)}: figures, reasons and plots",
                        _sheet(results, law))
                for law in shown
            ),
            paragraph("Those of other laws stand in the documentation of their FMUs.", note=True),
        ),
    )  # fmt: skip


def _sheet(results: Results, law: str) -> Markup:
    html = sheet(results.properties[law], sliding=results.sliding).replace(
        'id="property-', f'id="{law}-property-'
    )
    return Markup(html.replace('href="#property-', f'href="#{law}-property-'))
