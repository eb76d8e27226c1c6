"""Coefficients and their covariance as an SSP parameter set, by the schema of the standard."""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from lxml import etree

from cosim.workflow.export import export
from fmu_src import model_file
from hesr.extras.ssp.parameter_set import COVARIANCE, export_ssv
from hesr_model.errors import ExportError
from hesr_model.friction.model import FrictionModel
from hesr_model.inference.covariance import Covariance

SCHEMA = Path(fmpy.__file__).parent / "ssp" / "schema" / "SystemStructureParameterValues.xsd"
SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"


@pytest.fixture
def model() -> FrictionModel:
    """The paper's values, with the first two coefficients of joint 2 uncertain."""
    plain = FrictionModel.read(model_file("uf850-table1"))
    names = tuple(plain.laws[1].values)[:2]
    known = Covariance(
        names=names,
        within=np.array([[4.0, -1.0], [-1.0, 0.3]]),
        between=2.0,
        degrees=50.0,
        carried=np.zeros((2, 2)),
    )
    first, second, *more = plain.laws
    return replace(plain, laws=(first, replace(second, covariance=known), *more))


def test_values_and_covariance_are_written(model: FrictionModel, tmp_path: Path) -> None:
    path = export(model, tmp_path / "law.ssv", format="ssv")
    etree.XMLSchema(etree.parse(SCHEMA)).assertValid(etree.parse(path))
    root = ET.parse(path).getroot()
    values = {p.get("name"): float(p[0].get("value")) for p in root.findall(f".//{SSV}Parameter")}
    assert values == {
        f"joint[{i}].{name}": value
        for i, law in enumerate(model.laws, start=1)
        for name, value in law.values.items()
    }
    [joint] = root.findall(f".//{{{COVARIANCE}}}Joint")
    own = model.laws[1].covariance
    assert own is not None
    assert joint.get("names") == " ".join(f"joint[2].{name}" for name in own.names)
    rows = [[float(x) for x in row.text.split()] for row in joint]
    assert rows == own.matrix.tolist()


def test_the_suffix_is_ssv(model: FrictionModel, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="parameter set of SSP must end"):
        export_ssv(model, tmp_path / "law.xml")
