"""Contents of a plant FMU: a valid description, the same motion in FMI 2.0 and 3.0, refusals."""

import re
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu
from plant_robots import UF850, coupled, sprung, tree
from plant_runs import content_of, plant

import hesr
from fmu_src.check.run import check
from fmu_src.export.package import write_fmu
from fmu_src.friction.embedded_model import read_embedded_model
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import ExportError, SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.base_parameters import sample_regressor, unknown_columns
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot

VDMCHECK2 = Path(__file__).parents[3] / ".tools" / "vdmcheck2"
NIGHTLY = pytest.mark.nightly("laws")
LARGEST = 600e3  # bytes of a plant with three platforms


@pytest.fixture(scope="module")
def fmus(table1: FrictionModel, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The twin's robot, by the version of FMI."""
    folder, body = tmp_path_factory.mktemp("plant"), PlantBody.from_robot(Robot(UF850))
    return {
        fmi: export_plant(table1, folder / f"Arm{fmi}.fmu", plant_body=body, fmi=fmi)
        for fmi in (2, 3)
    }


@pytest.mark.parametrize("fmi", [2, 3])
def test_validators_find_no_problem(fmi: int, fmus: dict[int, Path]) -> None:
    has_vdmcheck = fmi == 2 and VDMCHECK2.is_dir() and shutil.which("java") is not None
    assert check(fmus[fmi], vdmcheck=VDMCHECK2 if has_vdmcheck else None).problems == ()
    assert validate_fmu(str(fmus[fmi])) == []


def test_both_versions_of_fmi_move_the_same(fmus: dict[int, Path]) -> None:
    t = 0.005 * np.arange(200)
    tau = np.array([20.0, -60.0, 15.0]) * np.cos(3.0 * t)[:, None]
    found = []
    for fmi, path in fmus.items():
        about = read_model_description(str(path))
        names = [v.name for v in about.modelVariables if v.name.startswith("q")]
        columns = [("tau", float, 3)] if fmi == 3 else [(f"tau[{i}]", float) for i in (1, 2, 3)]
        rows = np.zeros(len(t), dtype=[("time", float), *columns])
        rows["time"] = t
        if fmi == 3:
            rows["tau"] = tau
        else:
            for i in range(3):
                rows[f"tau[{i + 1}]"] = tau[:, i]
        output = ["q"] if fmi == 3 else [f"q[{i}]" for i in (1, 2, 3)]
        assert set(output) <= set(names)
        result = simulate_fmu(
            str(path),
            stop_time=0.9,
            step_size=0.005,
            output_interval=0.005,
            input=rows,
            output=output,
        )
        found.append(result["q"] if fmi == 3 else np.column_stack([result[n] for n in output]))
    assert np.ptp(found[0], axis=0).min() > 0.01
    np.testing.assert_array_equal(*found)


def test_a_page_explains_the_plant_and_holds_the_model(
    table1: FrictionModel, fmus: dict[int, Path]
) -> None:
    with zipfile.ZipFile(fmus[2]) as archive:
        page = archive.read("documentation/index.html").decode()
    assert "torque in, motion out" in page
    assert "joint3" in page
    assert read_embedded_model(fmus[2]) == table1


def followers(folder: Path) -> Path:
    return tree(folder, followers=True)


@pytest.mark.parametrize(
    "source",
    [
        sprung,
        *(pytest.param(one, marks=pytest.mark.nightly("laws")) for one in (followers, coupled)),
    ],
)
def test_plants_of_all_kinds_of_joints_are_valid(source, make_law, tmp_path: Path) -> None:
    robot = Robot(source(tmp_path))
    path = plant(robot, [make_law("lugre")] * robot.n, tmp_path)
    assert check(path).problems == ()
    about = {v.name: v for v in read_model_description(str(path)).modelVariables}
    named = {"sprung": ("spring[2].k", "spring[3].k", "spring[2].sin2")}.get(robot.name, ())
    assert [about[name].unit for name in named] == ["N.m/rad", "N/m", "N.m"][: len(named)]
    assert ("spring[2].sin2" in about) == bool(robot.springs)


@NIGHTLY
def test_a_plant_for_three_platforms_is_small(make_law, tmp_path: Path) -> None:
    robot = Robot(coupled(tmp_path))
    platforms = ("linux64", "win64", "aarch64-linux")
    whole = content_of(robot, [make_law("lugre")] * robot.n)
    path = write_fmu(whole, tmp_path / "Arm.fmu", platforms=platforms)
    assert path.stat().st_size < LARGEST


def test_derivatives_of_states_are_those_of_the_law(make_law, tmp_path: Path) -> None:
    """der(z) of LuGre is dq less the rate times z, also after a step."""
    robot, law = Robot(UF850), make_law("lugre")
    sigma_0, f_c, f_s, v_s = (law.values[n] for n in ("sigma_0", "F_c", "F_s", "v_s"))
    with FmuInstance(plant(robot, [law] * 3, tmp_path)) as arm:
        arm.initialise(start={"dq_start[1]": 0.2, "tau[1]": 9.0})
        for k in range(3):
            z, dq, slope = arm.get(["z[1]", "dq[1]", "der(z[1])"])
            level = f_c + (f_s - f_c) * np.exp(-((dq / v_s) ** 2))
            assert slope == pytest.approx(dq - sigma_0 * abs(dq) / level * z, rel=1e-9)
            arm.step(0.001 * k, 0.001)


def test_identified_springs_and_rotors_are_parameters(tmp_path: Path) -> None:
    robot = Robot(sprung(tmp_path))
    parameters = robot.nominal_parameters.copy()
    parameters[10 * robot.links :] = np.arange(1.0, 1.0 + len(parameters) - 10 * robot.links)
    body = PlantBody(robot=robot, parameters=parameters)
    np.testing.assert_array_equal(body.rotors, np.arange(1.0, 8.0))


def test_a_law_of_another_robot_is_refused(table1: FrictionModel, tmp_path: Path) -> None:
    body = PlantBody.from_robot(Robot(UF850))
    others = replace(table1, joints=("hip", "knee", "ankle"))
    sentence = "joints hip, knee, ankle, but robot"
    with pytest.raises(ExportError, match=re.escape(sentence)):
        export_plant(others, tmp_path / "A.fmu", plant_body=body)
    twisted = Robot(coupled(tmp_path))
    model = content_model(table1, twisted)
    with pytest.raises(ExportError, match="another transmission matrix than the friction"):
        export_plant(model, tmp_path / "A.fmu", plant_body=PlantBody.from_robot(twisted))


def content_model(table1: FrictionModel, robot: Robot) -> FrictionModel:
    laws = (table1.laws[0],) * robot.n
    return replace(table1, joints=robot.joints, laws=laws, trained=())


def test_a_robot_without_inertia_is_refused() -> None:
    robot = Robot(UF850)
    body = PlantBody(robot=robot, parameters=0.0 * robot.nominal_parameters)
    sentence = "'uf850' the eigenvalue 0 kg.m2"
    with pytest.raises(ExportError, match=re.escape(sentence)):
        body.require_inertia("the body")


def test_base_parameters_become_those_of_bodies(
    table1: FrictionModel, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A body of base parameters is exported with masses that exist, and the difference is said."""
    robot = Robot(UF850)
    rows = sample_regressor(robot)
    base = np.linalg.lstsq(rows, rows @ robot.nominal_parameters, rcond=None)[0]
    columns, none = unknown_columns(robot), np.zeros(robot.n)
    body = RigidBody(
        robot=robot.name,
        joints=robot.joints,
        names=robot.parameter_names,
        parameters=base,
        base=columns,
        standard_errors=np.zeros(len(columns)),
        condition=1.0,
        ridge=0.0,
        friction=none,
        rmse=none,
        rows=1,
        logs=("made",),
        method="stacked",
        weighting="wls",
    )
    options = {"robot": UF850, "rigid_body": body, "platform": ["linux64"]}
    hesr.export(table1, tmp_path / "Arm.fmu", format="plant", **options)
    [said] = caplog.messages
    assert re.search(
        r"up to \S+ N.m on joint\d, 0.\d % of",
        said,
    )
    with FmuInstance(tmp_path / "Arm.fmu") as arm:
        arm.initialise()
        assert all(m > 0.0 for m in arm.get([f"link[{k}].m" for k in (1, 2, 3)]))


@pytest.mark.parametrize(
    ("start", "sentence"),
    [
        ({"substep": 0.0}, "substep is 0; it must be positive."),
        ({"stop_damping[2]": -1.0}, "stop_damping[2] is -1; it must not be negative."),
        ({"q_max[1]": -9.0}, "q_max[1] is -9; it must not be below the lower limit."),
        (
            {"payload.m": -50.0, "payload.com[1]": 2.0},
            "positive definite at this posture",
        ),
    ],
)
def test_bad_start_values_are_refused(start, sentence: str, fmus: dict[int, Path]) -> None:
    with FmuInstance(fmus[2]) as arm, pytest.raises(SimulationError, match=re.escape(sentence)):
        arm.initialise(start=start)


def test_a_step_of_too_many_inner_steps_is_refused(fmus: dict[int, Path]) -> None:
    with FmuInstance(fmus[2]) as arm:
        arm.initialise(start={"substep": 1e-12})
        with pytest.raises(SimulationError, match="at most 1e\\+07 are made"):
            arm.step(0.0, 0.01)
