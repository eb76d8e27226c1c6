"""Display of results in a notebook and a shell, and as tables of other libraries."""

import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from cosim.study.scores import compare, transpose_records
from fmu_src.friction.predictions import predict_model
from hesr_model.errors import ConfigError
from hesr_model.friction.model import _MAX_SHOWN_COEFFICIENTS, FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.robots.robot import Robot
from hesr_model.support.extras import install_command
from hesr_model.support.frames import html_table


@pytest.fixture
def body(arm_log: Log, arm_model: Robot) -> RigidBody:
    return identify([arm_log], arm_model)


def cells(page: str) -> list[list[str]]:
    root = ElementTree.fromstring(page)
    return [["".join(cell.itertext()) for cell in row] for row in root.iter("tr")]


def test_a_table_escapes_its_cells() -> None:
    page = html_table("a<b", ("x & y",), [("<script>",), (0.123456,), (7,)])
    assert "<script>" not in page
    assert cells(page) == [["x & y"], ["<script>"], ["0.1235"], ["7"]]
    assert ElementTree.fromstring(page).findtext("caption") == "a<b"


def test_a_log_shows_the_motion_of_each_joint(arm_log: Log) -> None:
    head, *rows = cells(arm_log._repr_html_())
    assert head == ["joint", "travel of q", "largest |tau|", "largest |dq|"]
    travel = np.ptp(arm_log.q, axis=0)
    assert [row[:2] for row in rows] == [[f"joint{k + 1}", f"{travel[k]:.4g}"] for k in range(3)]
    assert repr(arm_log) == "Log('run', 3 joints, 2000 rows, 9.995 s at 200 Hz)"


def test_a_body_shows_its_base_parameters(body: RigidBody) -> None:
    _, *rows = cells(body._repr_html_())
    assert [row[0] for row in rows] == [body.names[k] for k in body.base]
    assert float(rows[0][1]) == pytest.approx(body.parameters[body.base[0]], rel=1e-3)
    assert len(repr(body)) < 120


def test_models_show_their_equations_and_are_short_in_a_shell(
    table1: FrictionModel, registry_models: dict[str, FrictionModel]
) -> None:
    for model in (table1, *registry_models.values()):
        assert len(repr(model)) < 200
        assert all(len(repr(law)) < 80 for law in model.laws)
        _, *rows = cells(model._repr_html_())
        assert [row[0] for row in rows] == list(model.joints)
    assert "tau = " in registry_models["lugre"]._repr_html_()
    network = max(registry_models.values(), key=lambda model: len(model.laws[0].values))
    assert len(network.laws[0].values) > _MAX_SHOWN_COEFFICIENTS
    assert "tau = " not in network._repr_html_()


def test_a_comparison_shows_errors_by_law(registry_models: dict[str, FrictionModel]) -> None:
    model = registry_models["lugre"]
    t = 0.01 * np.arange(500)
    records = [
        FrictionRecord(
            log="a",
            joint=joint,
            t=t,
            dq=np.cos(t),
            q=np.sin(t),
            tau_load=0.0 * t,
            tau=3.0 * np.tanh(50.0 * np.cos(t)),
        )
        for joint in model.joints
    ]
    scores = compare(
        transpose_records([records]), {"lugre": predict_model(model, transpose_records([records]))}
    )
    _, spread, row = cells(scores._repr_html_())
    assert row == ["lugre", *(f"{error:.4g}" for error in scores.laws["lugre"].rmse)]
    assert spread[1:] == [f"{s:.4g}" for s in scores.tau_std]
    pytest.importorskip("pandas", reason="needs hesr[tables]")
    frame = scores.to_pandas()
    for k, joint in enumerate(model.joints):
        assert frame.loc[("lugre", joint), "rmse"] == scores.laws["lugre"].rmse[k]


def test_a_log_as_a_data_frame(arm_log: Log, tmp_path: Path) -> None:
    pytest.importorskip("pandas", reason="needs hesr[tables]")
    frame = arm_log.to_pandas()
    names = [f"{signal}{k}" for signal in ("q", "dq", "tau") for k in (1, 2, 3)]
    assert list(frame.columns) == names
    np.testing.assert_array_equal(frame.index, arm_log.t)
    np.testing.assert_array_equal(frame["tau2"], arm_log.tau[:, 1])


def test_a_log_as_a_data_set(arm_log: Log) -> None:
    pytest.importorskip("xarray", reason="needs hesr[tables]")
    found = arm_log.to_xarray()
    np.testing.assert_array_equal(found.dq.sel(joint="joint3"), arm_log.dq[:, 2])
    assert found.tau.attrs["units"] == "N.m"
    np.testing.assert_array_equal(found.t, arm_log.t)


@pytest.mark.parametrize(("library", "call"), [("pandas", "to_pandas"), ("xarray", "to_xarray")])
def test_a_missing_library_is_named(
    arm_log: Log, monkeypatch: pytest.MonkeyPatch, library: str, call: str
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ConfigError) as caught:
        getattr(arm_log, call)()
    assert str(caught.value) == f"{library} is not installed; {install_command('tables')}."
