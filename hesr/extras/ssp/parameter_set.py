"""Coefficients of a friction model as a parameter set of SSP 1.0, with their covariance.

The covariance of each joint is in an annotation of the set, which other tools ignore:

    <hesr:Joint number="1" names="joint[1].F_c joint[1].sigma_2">
      <hesr:Row>0.012 -0.003</hesr:Row>
      <hesr:Row>-0.003 0.04</hesr:Row>
    </hesr:Joint>

with one row per name.
"""

from importlib.metadata import version as installed
from pathlib import Path
from xml.etree import ElementTree as ET

from fmu_src.export.description import si_exponents
from fmu_src.friction.friction_component import is_exposed, place, scales
from fmu_src.friction.validity import require_numbers
from fmu_src.pages.friction_page import model_title
from hesr.extras.ssp.contents import UNIT_DEFAULTS, build_parameter_set
from hesr_model.errors import ExportError
from hesr_model.friction.model import FrictionModel
from hesr_model.support.files import written_whole
from hesr_model.support.xml_files import to_bytes

ANNOTATION = "hesr.covariance"
COVARIANCE = "urn:hesr:covariance:1"


def export_ssv(model: FrictionModel, path: Path) -> Path:
    """Write coefficients and covariance of a friction model as .ssv, and return the path.

    The names are those of its FMU. Laws without exposed coefficients have their scales instead.
    """
    if path.suffix != ".ssv":
        raise ExportError(f"{path}: a parameter set of SSP must end in .ssv.")
    require_numbers(model)
    root_attributes = {
        "xmlns:hesr": COVARIANCE,
        "version": "1.0",
        "name": f"{model_title(model)} of {model.robot}",
        "generationTool": f"HESR {installed('hesr')}",
    }
    coefficients = _list_coefficients(model)
    values = (
        (name, "Real", {"value": repr(float(value)), "unit": unit})
        for name, value, unit in coefficients
    )
    units = {
        unit: tuple((UNIT_DEFAULTS | si_exponents(unit)).values()) for *_, unit in coefficients
    }
    root = build_parameter_set(values, units, root_attributes)
    joint_elements = _build_covariances(model)
    if joint_elements:
        annotations = ET.SubElement(root, "ssv:Annotations")
        annotation = ET.SubElement(annotations, "ssc:Annotation", type=ANNOTATION)
        ET.SubElement(annotation, "hesr:Covariance").extend(joint_elements)
    with written_whole(path) as temporary:
        temporary.write_bytes(to_bytes(root))
    return path


def _list_coefficients(model: FrictionModel) -> list[tuple[str, float, str]]:
    coefficients = []
    for number, law in enumerate(model.laws, start=1):
        if is_exposed(law):
            names_and_coefficients = zip(
                place(law, number).parameters, law.form.coefficients, strict=True
            )
            coefficients += [
                (name, law.values[coefficient.name], coefficient.unit)
                for name, coefficient in names_and_coefficients
            ]
    if any(is_exposed(law) for law in model.laws):
        return coefficients
    return [(variable.name, variable.start, variable.unit or "1") for variable in scales(model)]


def _build_covariances(model: FrictionModel) -> list[ET.Element]:
    joint_elements = []
    for number, law in enumerate(model.laws, start=1):
        if law.covariance is None or not is_exposed(law):
            continue
        names = dict(zip(law.values, place(law, number).parameters, strict=True))
        joint_element = ET.Element(
            "hesr:Joint",
            number=str(number),
            names=" ".join(names[name] for name in law.covariance.names),
        )
        for row in law.covariance.matrix:
            ET.SubElement(joint_element, "hesr:Row").text = " ".join(repr(float(x)) for x in row)
        joint_elements.append(joint_element)
    return joint_elements
