"""No validator has findings for the FMU of any law, including VDMCheck2 if available."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from registry_models import everyday

from fmu_src import export_fmu
from fmu_src.check.run import check
from hesr_model.fitting.estimator import registry
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.residual import FrictionRecord

pytestmark = pytest.mark.ci

VDMCHECK2 = Path(__file__).parents[3] / ".tools" / "vdmcheck2"
HAS_VDMCHECK2 = VDMCHECK2.is_dir() and shutil.which("java") is not None


def record():
    """A motion with reversals under load, and a torque that every law can fit."""
    t = 0.005 * np.arange(1600)
    dq = np.sin(2.0 * t) + 0.6 * np.sin(5.3 * t)
    q = -0.5 * np.cos(2.0 * t) - 0.6 / 5.3 * np.cos(5.3 * t)
    tau = 5.0 * np.tanh(50.0 * dq) + 3.0 * dq + np.random.default_rng(1).normal(0, 0.1, len(t))
    load = 20.0 * np.sin(t)
    return FrictionRecord(
        log="made", joint="axis", t=t, dq=dq, q=q, tau_load=load, tau=tau, gear_ratio=101.0
    )


@pytest.mark.parametrize("name", list(everyday()))
def test_fmus_of_all_laws_pass(name, tmp_path):
    law = registry()[name]().fit([record()], np.random.default_rng(0))
    model = FrictionModel(law=name, robot="bench", joints=("axis",), laws=(law,), sample_time=0.005)
    fmu = export_fmu(model, tmp_path / "F.fmu")
    report = check(fmu, vdmcheck=VDMCHECK2 if HAS_VDMCHECK2 else None)
    assert report.problems == ()
    if HAS_VDMCHECK2:
        assert report.skipped == ()
