"""Reference motion and results: within the training range, and reproduced by the FMU."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model, fmi2Real
from scipy.integrate import solve_ivp

from fmu_src import export_fmu
from fmu_src.friction.reference import (
    CONTINUOUS,
    SETTINGS,
    UNKNOWN_SPEED,
    reference_files,
    reference_motion,
    torques,
)
from fmu_src.run.reference_results import EXPERIMENTS, MANIFEST
from hesr_model.equations.functions import to_numpy_function
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import first_states
from hesr_model.friction.trained_range import TrainedRange

TRAINED = TrainedRange(
    sample_time=0.01, dq=(-0.8, 1.1), q=(-0.5, 1.5), tau_load=(5.0, 9.0), tau=(-9.0, 9.0)
)
NAME = "friction_x"


def table(files: Mapping[str, bytes], path: str) -> np.ndarray:
    lines = files[path].decode().splitlines()
    names = [name.strip('"') for name in lines[0].split(",")]
    assert all(part.startswith('"') for part in lines[0].split(","))
    rows = [tuple(map(float, line.split(","))) for line in lines[1:]]
    return np.array(rows, dtype=[(name, float) for name in names])


def options(files: Mapping[str, bytes], path: str) -> dict[str, float]:
    pairs = (line.split(", ") for line in files[path].decode().splitlines())
    return {name: float(value) for name, value in pairs}


def columns(rows: np.ndarray, name: str) -> np.ndarray:
    found = [n for n in rows.dtype.names if n.startswith(f"{name}[")]
    return np.column_stack([rows[n] for n in found])


def test_motion_stays_within_the_training_range(
    make_law: Callable[[str], FrictionLaw], make_model: Callable[..., FrictionModel]
) -> None:
    laws = make_law("lugre"), make_law("viscous")
    model = make_model(*laws, trained=(TRAINED, replace(TRAINED, dq=(0.1, 0.4))))
    motion = reference_motion(model, phase=0.3, lead_in=0.5)
    assert motion.t[1] == model.sample_time
    np.testing.assert_array_equal(motion.dq[0], 0.0)
    np.testing.assert_allclose(np.abs(motion.dq).max(axis=0), [0.8, 0.4], rtol=1e-3)
    assert np.all(np.abs(motion.dq) <= [0.8, 0.4])
    assert np.all((motion.tau_load >= 5.0) & (motion.tau_load <= 9.0))
    np.testing.assert_allclose(motion.q.min(axis=0) + motion.q.max(axis=0), 1.0)
    speed = np.gradient(motion.q, motion.t, axis=0)
    np.testing.assert_allclose(speed[1:-1], motion.dq[1:-1], atol=1e-4)
    assert not np.allclose(motion.dq[:, 0] / 0.8, motion.dq[:, 1] / 0.4)


def test_motion_has_defaults_without_a_training_range(table1: FrictionModel) -> None:
    motion = reference_motion(table1, frequency=0.25, periods=5.0)
    assert motion.dq.shape == (4000, 3)
    expected = UNKNOWN_SPEED * np.sin(2 * np.pi * 0.25 * motion.t)
    np.testing.assert_allclose(motion.dq, np.column_stack([expected] * 3), atol=1e-12)
    assert not motion.tau_load.any()
    assert reference_motion(table1, rows=70).t.shape == (70,)


@pytest.mark.parametrize("discretisation", ["exact", "euler"])
@pytest.mark.parametrize("name", ["lugre", "gaussians", "elements"])
def test_the_fmu_reproduces_the_reference_in_co_simulation(
    name: str,
    discretisation: str,
    make_law: Callable[[str], FrictionLaw],
    make_model: Callable[..., FrictionModel],
    tmp_path: Path,
) -> None:
    # Without a training range the speed is too high for Euler at the sample time.
    trained = (TRAINED,) if discretisation == "exact" else ()
    law = replace(make_law(name), discretisation=discretisation)
    model = make_model(law, trained=trained)
    files = reference_files(model, NAME)
    stem = f"extra/co_simulation/{NAME}"
    chosen = options(files, f"{stem}_ref.opt")
    expected = table(files, f"{stem}_ref.csv")
    result = fmpy.simulate_fmu(
        export_fmu(model, tmp_path / "F.fmu"),
        fmi_type="CoSimulation",
        start_time=chosen["StartTime"],
        stop_time=chosen["StopTime"],
        output_interval=chosen["StepSize"],
        input=table(files, f"{stem}_in.csv"),
        output=["tau[1]"],
    )
    np.testing.assert_allclose(result["time"], expected["time"], atol=1e-12)
    largest = np.abs(expected["tau[1]"]).max()
    np.testing.assert_allclose(
        result["tau[1]"], expected["tau[1]"], rtol=0.0, atol=chosen["RelTol"] * largest
    )
    assert largest > 0.1


def test_the_fmu_reproduces_the_reference_of_all_joints(
    table1: FrictionModel, table1_fmu: Path
) -> None:
    files = reference_files(table1, NAME)
    stem = f"extra/co_simulation/{NAME}"
    expected = table(files, f"{stem}_ref.csv")
    result = fmpy.simulate_fmu(
        table1_fmu,
        fmi_type="CoSimulation",
        stop_time=expected["time"][-1],
        output_interval=table1.sample_time,
        input=table(files, f"{stem}_in.csv"),
        output=list(expected.dtype.names[1:]),
    )
    largest = np.abs(columns(expected, "tau")).max(axis=0)
    difference = np.abs(columns(result, "tau") - columns(expected, "tau")).max(axis=0)
    assert np.all(difference <= 1e-12 * largest)


def integrated(law: FrictionLaw, rows: np.ndarray) -> np.ndarray:
    """The torque of one joint by a third-party integrator."""
    symbols = tuple(c.symbol for c in law.form.coefficients)
    parts = tuple(e for r in law.form.relaxations for e in (r.drive, r.rate))
    states = tuple(s for r in law.form.relaxations for s in (r.state, r.derivative))
    drives = to_numpy_function((*symbols, *INPUTS), parts)
    output = to_numpy_function((*symbols, *INPUTS, *states), (law.form.output,))
    values = tuple(law.values.values())

    def inputs(t: float) -> list[float]:
        return [np.interp(t, rows["time"], rows[f"{u}[1]"]) for u in INPUTS]

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        found = drives(*values, *inputs(t))
        return np.array([float(found[2 * i] - found[2 * i + 1] * z) for i, z in enumerate(x)])

    t = rows["time"]
    first = first_states(law, *inputs(t[0]))
    x = solve_ivp(
        slope, (t[0], t[-1]), first, "LSODA", t, rtol=1e-10, atol=1e-12, max_step=t[1] / 20
    ).y.T
    pairs = [np.ravel([x[k], slope(t[k], x[k])], order="F") for k in range(len(t))]
    return np.array([output(*values, *inputs(t[k]), *pairs[k])[0] for k in range(len(t))])


@pytest.mark.parametrize(
    "name",
    ["lugre", *(pytest.param(n, marks=pytest.mark.ci) for n in ("parfam_tanh", "elements"))],
)
def test_the_reference_of_model_exchange_is_the_integrated_law(
    name: str, make_law: Callable[[str], FrictionLaw], make_model: Callable[..., FrictionModel]
) -> None:
    model = make_model(make_law(name), trained=(TRAINED,))
    files = reference_files(model, NAME)
    stem = f"extra/model_exchange/{NAME}"
    rows, expected = table(files, f"{stem}_in.csv"), table(files, f"{stem}_ref.csv")["tau[1]"]
    chosen = options(files, f"{stem}_ref.opt")
    assert chosen["StepSize"] == 0.0
    np.testing.assert_allclose(
        integrated(model.laws[0], rows),
        expected,
        rtol=0.0,
        atol=chosen["RelTol"] * np.abs(expected).max(),
    )
    assert np.all(rows["dq[1]"] != 0.0)


def solved(fmu: Path, rows: np.ndarray, outputs: Sequence[str], substeps: int) -> np.ndarray:
    """Results of the FMU in model exchange with a Runge-Kutta solver that follows the inputs."""
    about = fmpy.read_model_description(fmu)
    vr = {v.name: v.valueReference for v in about.modelVariables}
    names = rows.dtype.names[1:]
    u = np.column_stack([rows[name] for name in names])
    t, inputs, wanted = rows["time"], [vr[n] for n in names], [vr[n] for n in outputs]
    with TemporaryDirectory() as folder:
        model = FMU2Model(
            guid=about.guid,
            modelIdentifier=about.modelExchange.modelIdentifier,
            unzipDirectory=fmpy.extract(fmu, folder),
            instanceName="one",
        )
        model.instantiate()
        model.setupExperiment(startTime=0.0)
        model.enterInitializationMode()
        model.setReal(inputs, u[0])
        model.exitInitializationMode()
        model.newDiscreteStates()
        model.enterContinuousTimeMode()
        count = about.numberOfContinuousStates
        state, derivative = ((fmi2Real * count)() for _ in range(2))
        model.getContinuousStates(state, count)
        x, found = np.array(state), [model.getReal(wanted)]

        def slope(k: int, share: float, at: np.ndarray) -> np.ndarray:
            model.setTime(t[k] + share * (t[k + 1] - t[k]))
            model.setReal(inputs, u[k] + share * (u[k + 1] - u[k]))
            state[:] = at.tolist()
            model.setContinuousStates(state, count)
            model.getDerivatives(derivative, count)
            return np.array(derivative)

        for k in range(len(t) - 1):
            h, part = (t[k + 1] - t[k]) / substeps, 1.0 / substeps
            for j in range(substeps):
                a = slope(k, j * part, x)
                b = slope(k, (j + 0.5) * part, x + 0.5 * h * a)
                c = slope(k, (j + 0.5) * part, x + 0.5 * h * b)
                d = slope(k, (j + 1) * part, x + h * c)
                x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
                slope(k, (j + 1) * part, x)
                if model.completedIntegratorStep()[0]:
                    model.enterEventMode()
                    model.newDiscreteStates()
                    model.enterContinuousTimeMode()
            found.append(model.getReal(wanted))
        model.terminate()
        model.freeInstance()
    return np.array(found)


def test_the_fmu_reproduces_the_reference_in_model_exchange(
    make_law: Callable[[str], FrictionLaw],
    make_model: Callable[..., FrictionModel],
    tmp_path: Path,
) -> None:
    model = make_model(*map(make_law, ("lugre", "parfam_tanh", "viscous", "elements")))
    files = reference_files(model, NAME)
    stem = f"extra/model_exchange/{NAME}"
    expected = table(files, f"{stem}_ref.csv")
    found = solved(
        export_fmu(model, tmp_path / "F.fmu"),
        table(files, f"{stem}_in.csv"),
        expected.dtype.names[1:],
        60,
    )
    largest = np.abs(columns(expected, "tau")).max(axis=0)
    # A sign change within a step is detected at its end.
    assert np.all(np.abs(found - columns(expected, "tau")).max(axis=0) <= 3e-5 * largest)


def test_files_follow_the_rules_of_the_cross_check(table1: FrictionModel) -> None:
    files = reference_files(table1, NAME)
    assert set(files) == {
        "extra/README.txt",
        *(
            f"extra/{kind}/{NAME}{end}"
            for kind in ("co_simulation", "model_exchange")
            for end in ("_in.csv", "_ref.csv", "_ref.opt")
        ),
        f"extra/co_simulation/{NAME}_shown.csv",
        MANIFEST,
        EXPERIMENTS,
    }
    inputs = table(files, f"extra/co_simulation/{NAME}_in.csv")
    assert len(inputs) <= 200
    assert inputs.dtype.names == (
        "time",
        *(f"{u}[{i}]" for u in ("dq", "q", "tau_load") for i in (1, 2, 3)),
    )
    assert columns(inputs, "dq")[0].tolist() == [0.0] * 3
    for path, content in files.items():
        assert b"-0," not in content, path
        assert content.isascii()
    assert files == reference_files(table1, NAME)


def test_euler_gets_a_shorter_step_if_needed(
    make_law: Callable[[str], FrictionLaw], make_model: Callable[..., FrictionModel]
) -> None:
    stiff = replace(make_law("lugre"), discretisation="euler")
    model = make_model(stiff, trained=(TRAINED,), sample_time=0.02)
    chosen = options(reference_files(model, NAME), f"extra/co_simulation/{NAME}_ref.opt")
    assert chosen["StepSize"] in {0.02 / 2**k for k in range(1, 10)}


def test_a_non_finite_torque_is_noted(
    make_law: Callable[[str], FrictionLaw], make_model: Callable[..., FrictionModel]
) -> None:
    law = make_law("parfam_exp")
    law = replace(law, values={**law.values, "theta1_dq": 1e6})
    files = reference_files(make_model(law, trained=(replace(TRAINED, dq=(-9.0, 9.0)),)), NAME)
    assert list(files) == ["extra/README.txt"]
    assert b"not finite" in files["extra/README.txt"]


def test_the_settings_differ_as_expected(table1: FrictionModel) -> None:
    motion = reference_motion(table1, rows=500)
    found = {way: torques(table1, motion, way) for way in (*SETTINGS, CONTINUOUS)}
    exact = replace(table1, laws=tuple(replace(law, discretisation="exact") for law in table1.laws))
    # Held inputs are those of the previous row, except for the state that they drive.
    assert np.abs(found["hold"] - found["direct"]).max() > 1.0
    fine = torques(exact, motion, CONTINUOUS)
    np.testing.assert_array_equal(found[CONTINUOUS], fine)
    distance = {way: np.abs(torques(exact, motion, way) - fine).mean() for way in SETTINGS}
    assert distance["linear"] < distance["direct"]
    assert distance["linear"] < distance["hold"]
    np.testing.assert_allclose(
        torques(exact, motion, CONTINUOUS, substeps=40), fine, rtol=0.0, atol=0.05
    )
