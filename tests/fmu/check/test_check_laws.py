"""No validator has findings for the FMU of any law, including VDMCheck2 if available."""

import shutil
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import pytest
from registry_models import everyday

from fmu_src import export_fmu
from fmu_src.check.run import check
from hesr_model.friction.model import FrictionModel

pytestmark = pytest.mark.ci

VDMCHECK2 = Path(__file__).parents[3] / ".tools" / "vdmcheck2"
HAS_VDMCHECK2 = VDMCHECK2.is_dir() and shutil.which("java") is not None


@pytest.mark.parametrize("name", list(everyday()))
def test_fmus_of_all_laws_pass(name, registry_models, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # without VDMCheck2
    model = replace(registry_models[name], provenance={})  # which names a folder
    fmu = export_fmu(model, tmp_path / "F.fmu")
    assert check(fmu).problems == ()


@pytest.mark.skipif(not HAS_VDMCHECK2, reason="VDMCheck2 or Java is not there")
def test_vdmcheck2_passes_variables_of_all_laws(registry_models, tmp_path):
    """It only reads descriptions: laws of one discretisation are joints of one FMU."""

    def kind(model: FrictionModel) -> str:
        (law,) = model.laws
        return law.discretisation if law.form.relaxations else "exact"

    for found, models in groupby(sorted(registry_models.values(), key=kind), key=kind):
        laws = {model.law: model.laws[0] for model in models}
        model = FrictionModel(
            law="all", robot="bench", joints=(*laws,), laws=(*laws.values(),), sample_time=0.005
        )
        report = check(export_fmu(model, tmp_path / f"{found}.fmu"), vdmcheck=VDMCHECK2)
        assert (report.problems, report.skipped) == ((), ())
