"""FMUs of motors coupled to several joints: connectors are joints, the coupling is internal."""

import ctypes
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.check.run import check
from fmu_src.export.package import write_fmu
from fmu_src.friction.friction_component import friction_equations
from fmu_src.friction.friction_fmu import export_bare, export_fmu
from fmu_src.friction.reference import reference_files
from fmu_src.friction.replay import replay
from fmu_src.run.fmu import FmuInstance
from hesr.extras.drive.drive_fmu import build_motors as motors_of
from hesr.extras.drive.drive_fmu import content as drive
from hesr.extras.mjcf.mjcf_file import export_mjcf_law
from hesr.extras.modelica.modelica_package import export_modelica
from hesr.extras.one_file.c_header import export_c
from hesr_model.errors import ExportError
from hesr_model.friction.band import Band
from hesr_model.friction.model import FrictionModel, compute_band
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.transmission import Coupling, Transmission

C = np.array([[1.0, 0.0, 0.0], [0.25, 1.0, 0.0], [0.0, -0.8, 1.0]])
OK = 0


@pytest.fixture(scope="module")
def model(make_law, make_model) -> FrictionModel:
    laws = [make_law(name) for name in ("viscous", "lugre", "elements")]
    return make_model(*laws, coupling=Coupling(tuple(map(tuple, C.tolist()))))


@pytest.fixture(scope="module")
def fmu(model, tmp_path_factory) -> Path:
    return export_bare(model, tmp_path_factory.mktemp("coupled") / "F.fmu")


def test_the_fmu_matches_the_model(fmu, model, make_motion) -> None:
    t, dq, q, load = make_motion(3)
    expected = model.predict(t=t, dq=dq, q=q, tau_load=load)
    found = replay(fmu, t, dq, q, load)
    assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max()


@pytest.fixture(scope="module")
def banded(model) -> FrictionModel:
    band = Band(
        floor=0.7, slow=1.3, slow_speed=0.02, rest=0.4, fast=0.5, load=0.05, tail=0.7, envelope=1.0
    )
    return replace(model, laws=tuple(replace(law, band=band) for law in model.laws))


@pytest.fixture(scope="module")
def banded_fmu(banded, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("banded")
    return export_fmu(banded, folder / "F.fmu", power=True, band=True)


def test_the_band_of_the_fmu_matches_the_model(banded, banded_fmu, make_motion) -> None:
    t, dq, q, load = make_motion(3)
    torque = banded.predict(t=t, dq=dq, q=q, tau_load=load)
    expected = compute_band(banded, t=t, dq=dq, q=q, tau_load=load, torque=torque)
    for name, end in zip(("tau_lower", "tau_upper"), expected, strict=True):
        found = replay(banded_fmu, t, dq, q, load, output=name)
        assert np.abs(found - end).max() <= 1e-9 * np.abs(end).max()
    assert np.abs(replay(banded_fmu, t, dq, q, load) - torque).max() <= 1e-11 * np.abs(torque).max()


def test_checkers_find_no_problem_in_a_coupled_band(banded_fmu) -> None:
    assert check(banded_fmu).problems == ()


def test_joint_power_equals_motor_power(model, make_motion) -> None:
    t, dq, q, load = make_motion(3)
    alone = FrictionModel(
        law="alone", robot="r", joints=model.joints, laws=model.laws, sample_time=0.005
    )
    at_motors = alone.predict(t=t, dq=dq @ C.T, q=q @ C.T, tau_load=load @ np.linalg.inv(C))
    power = np.sum(model.predict(t=t, dq=dq, q=q, tau_load=load) * dq, axis=1)
    np.testing.assert_allclose(power, np.sum(at_motors * (dq @ C.T), axis=1), atol=1e-9)


@pytest.mark.parametrize("name", ["tau", "tau_lower", "tau_upper"])
def test_derivatives_and_slopes_include_the_coupling(name, fmu, banded_fmu, load) -> None:
    binary = load(fmu if name == "tau" else banded_fmu)
    point = {f"dq[{i}]": 0.3 * i for i in (1, 2, 3)} | {f"q[{i}]": 0.2 for i in (1, 2, 3)}
    point |= {f"tau_load[{i}]": 5.0 + i for i in (1, 2, 3)}
    torques = [f"{name}[{i}]" for i in (1, 2, 3)]

    def instance(values):
        c = binary.instantiate(kind=1)
        assert binary("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == OK
        assert binary("EnterInitializationMode", c) == OK
        assert binary.set_all(c, values) == OK
        return c

    c = instance(point)
    for known, value in point.items():
        result = (ctypes.c_double * 3)()
        status = binary(
            "GetDirectionalDerivative",
            *(c, binary.references(torques), 3, binary.references([known]), 1),
            (ctypes.c_double * 1)(1.0),
            result,
        )
        assert status == OK
        sides = [
            np.array(binary.get(instance(point | {known: value + h}), *torques))
            for h in (1e-5, -1e-5)
        ]
        np.testing.assert_allclose(list(result), (sides[0] - sides[1]) / 2e-5, rtol=1e-5, atol=1e-4)


def test_a_joint_depends_on_the_motors_that_move_it(model) -> None:
    table = {v.name: v for v in friction_equations(model)[0].variables}
    inputs = {name for name in table["tau[3]"].dependencies if name.startswith("dq[")}
    assert inputs == {"dq[2]", "dq[3]"}
    first = {name for name in table["tau[1]"].dependencies if name.startswith("dq[")}
    assert first == {"dq[1]", "dq[2]"}
    states = {n for n in table["tau[1]"].dependencies if n.startswith("z[")}
    assert states == {"z[2]"}


def test_a_band_depends_on_the_motors_that_move_its_joint(banded) -> None:
    table = {v.name: v for v in friction_equations(banded, band=True)[0].variables}
    found = set(table["tau_upper[1]"].dependencies)
    assert {"dq[1]", "dq[2]", "band_floor[1]", "band_floor[2]"} <= found
    assert "band_floor[3]" not in found


def test_a_drive_depends_on_the_links_of_all_its_joints(model, tmp_path) -> None:
    stiffness, ratio = (2e3, 3e3, 4e3), (50.0, 80.0, 40.0)
    path = write_fmu(
        drive(model, motors_of(3, inertia=(1e-3,) * 3, stiffness=stiffness, ratio=ratio)),
        tmp_path / "D.fmu",
    )
    q_link, q_start = np.array([0.01, -0.02, 0.03]), np.array([1.0, 2.0, -1.5])
    joints = range(1, 4)
    with FmuInstance(path) as component:
        component.enter_initialisation(
            start={f"q_start[{i}]": q for i, q in zip(joints, q_start, strict=True)}
        )
        component.set({f"q_link[{i}]": q for i, q in zip(joints, q_link, strict=True)})
        component.exit_initialisation()
        found = component.get([f"tau_link[{i}]" for i in joints])
        component.step(0.0, 1e-3)
        later = component.get([f"tau_link[{i}]" for i in joints])
        angles = component.get([f"q[{i}]" for i in joints])
    for torque, motors in ((found, q_start), (later, angles)):
        wound = np.array(stiffness) * (motors / np.array(ratio) - C @ q_link)
        np.testing.assert_allclose(torque, wound @ C, rtol=1e-9)


def test_rotors_of_the_rigid_body_move_with_the_motors(
    arm: RobotDescription, tmp_path: Path
) -> None:
    matrix = tuple(map(tuple, (50.0 * C).tolist()))
    robot = Robot(RobotDescription(**{**dict(arm), "transmission": Transmission(matrix=matrix)}))
    fmu = write_fmu(inverse_dynamics(robot, robot.nominal_parameters), tmp_path / "Body.fmu")
    q, dq, ddq = np.random.default_rng(3).uniform(-1, 1, (3, 1, 3))
    names = [f"{name}[{i}]" for name in ("q", "dq", "ddq") for i in range(1, 4)]
    with FmuInstance(fmu) as component:
        values = dict(zip(names, np.hstack([q, dq, ddq])[0].tolist(), strict=True))
        component.initialise(start=values)
        found = component.get([f"tau[{i}]" for i in range(1, 4)])
    expected = robot.torque(robot.nominal_parameters, q, dq, ddq)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_the_reference_results_are_those_of_joints(model, fmu) -> None:
    files = reference_files(model, "F")
    rows = np.genfromtxt(
        files["extra/co_simulation/F_in.csv"].decode().splitlines()[1:], delimiter=","
    )
    given = np.genfromtxt(
        files["extra/co_simulation/F_ref.csv"].decode().splitlines()[1:], delimiter=","
    )[:, 1:]
    held = np.concatenate([rows[:1], rows[:-1]])
    expected = model.predict(t=rows[:, 0], dq=held[:, 1:4], q=held[:, 4:7], tau_load=held[:, 7:])
    np.testing.assert_allclose(given, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("export", "name"),
    [(export_modelica, "Law.mo"), (export_mjcf_law, "law.xml"), (export_c, "law.h")],
)
def test_forms_with_a_law_per_joint_are_refused(model, export, name, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="turn with several joints, which"):
        export(model, tmp_path / name)
    assert not list(tmp_path.iterdir())
