"""documentation/index.html of a plant FMU."""

from fmu_src.export.description import Description
from fmu_src.export.interface import Interface
from fmu_src.pages.drive_page import law_entries
from fmu_src.pages.friction_page import title
from fmu_src.pages.html import rendered
from hesr_model.friction.model import FrictionModel


def to_html(model: FrictionModel, table: Interface, about: Description) -> str:
    """Return the page as one self-contained file."""
    joints, refused = law_entries(model)
    return rendered(
        "plant.html.j2",
        about=about,
        model=model,
        titles=list(dict.fromkeys(title(law) for law in model.laws)),
        substep=table.variables[table.places["substep"]].start,
        discretisation=model.laws[0].discretisation,
        joints=joints,
        refused=refused,
    )
