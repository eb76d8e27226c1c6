"""FMUs with a low pass of dq: fed with the raw velocity they give the predictions of scores."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from adaptive_models import lugre, model, stops

from cosim.study.scores import make_causal, transpose_records
from cosim.workflow.export import export
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.friction.predictions import predict_fmu
from fmu_src.friction.replay import replay
from hesr_model.errors import ExportError
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import measured_velocity
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot

LAWS = (lugre(), stops(), lugre())


@pytest.mark.parametrize("logged", [True, False], ids=["velocity", "position"])
def test_causal_predictions_are_those_of_the_fmu_with_its_low_pass(
    arm_log: Log, arm_model: Robot, tmp_path: Path, logged: bool
) -> None:
    """A law per joint, a log that starts in motion, and one with a gap."""
    cutoff = arm_model.description.log.filter_cutoff
    log = arm_log if logged else replace(arm_log, dq=None)
    rows = np.r_[150:900, 1100:1800]
    rows = rows[rows < len(log.t)]
    parts = (log.rows(np.arange(len(log.t) // 3)), *log.rows(rows).parts())
    assert len(parts) == 3
    plain = replace(model(*LAWS), joints=arm_model.description.joints)
    shipped = export_bare(plain, tmp_path / "Plain.fmu")
    filtered = export(plain, tmp_path / "Filtered.fmu", low_pass=cutoff)
    body = identify([arm_log], arm_model)
    for part in parts:
        records = friction_records(part, arm_model, body)
        scored = predict_fmu(shipped, make_causal(transpose_records([records])))
        inputs = (np.column_stack([getattr(r, u) for r in records]) for u in ("q", "tau_load"))
        alone = replay(filtered, part.t, measured_velocity(part), *inputs)
        found = np.column_stack([torque for (torque,) in scored])
        size = np.abs(alone).max()
        np.testing.assert_allclose(found, alone, rtol=0.0, atol=1e-9 * size)
        without = np.column_stack(
            [t for (t,) in predict_fmu(shipped, transpose_records([records]))]
        )
        assert np.abs(without - alone).max() > 0.01 * size


def test_a_step_of_the_velocity_arrives_with_the_time_constant() -> None:
    """The low pass by itself: 1 - exp(-2 pi f t), from the first sample on."""
    plain = model(*LAWS).behind_low_pass(15.0)
    [speed, *_] = plain.laws[0].form.memory
    t = np.array([0.0, 0.004, 0.014, 0.05])
    from hesr_model.equations.low_pass import low_pass_signals

    found = low_pass_signals(t, np.array([[2.0], [3.0], [3.0], [3.0]]), 15.0)[:, 0]
    np.testing.assert_allclose(found, 3.0 - np.exp(-2.0 * np.pi * 15.0 * t), atol=1e-14)
    assert speed.name == "dq_filtered"


@pytest.mark.parametrize("cutoff", [0.0, -3.0, float("inf"), float("nan")])
def test_an_impossible_cutoff_is_refused(tmp_path: Path, cutoff: float) -> None:
    with pytest.raises(ExportError, match=r"low pass is .* Hz"):
        export(model(*LAWS), tmp_path / "Out.fmu", low_pass=cutoff)
    assert not (tmp_path / "Out.fmu").exists()
