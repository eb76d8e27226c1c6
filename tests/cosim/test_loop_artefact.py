"""The closed loop as files, run by their script without HESR, with MuJoCo and with the plant."""

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest
from closed_loop import GAINS, Bench
from containing import Containing, OneSentence
from packaging.requirements import Requirement
from small_results import STUDY
from small_twin import GAINS as SMALL_GAINS
from small_twin import MOTIONS

import hesr
from cosim.loop.closed_loop import Scheme
from cosim.loop.loops import assemble
from cosim.loop.run import replace_arm, write_loops
from cosim.study.study import Study
from cosim.systems.simulation import Master, System
from cosim.workflow.export import answer
from fmu_src.arm.plant import Plant
from fmu_src.arm.truth import true_friction
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from hesr_model.errors import ArgumentError, ArtifactError, HesrError
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder
from hesr_model.support.result_folder import LIST

UF850 = models_folder() / "uf850"

FILES = {"closed_loop.toml", "closed_loop.ssp", "plant_loop.toml", "plant_loop.ssp", "simulate.py"}
ALIKE = 0.02  # relative difference of the RMSE with both plants
QUIET = {"q_noise": (0.0, 0.0, 0.0), "tau_meas_noise": (0.0, 0.0, 0.0)}


def needed(names: set[str]) -> Iterator[str]:
    """Names of packages and of all that they require."""
    waiting, seen = [*names], set()
    while waiting:
        if (name := waiting.pop()) in seen:
            continue
        seen.add(name)
        yield name
        for text in distribution(name).requires or ():
            one = Requirement(text)
            if one.marker is None or one.marker.evaluate({"extra": ""}):
                waiting.append(one.name)


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Site folder with FMPy and NumPy only."""
    site = tmp_path_factory.mktemp("site")
    for name in needed({"fmpy", "numpy"}):
        for file in distribution(name).files or ():
            top = file.parts[0]
            if top not in ("..", "/") and not (site / top).exists():
                (site / top).symlink_to(Path(str(distribution(name).locate_file(top))))
    return site


def start_script(
    folder: Path, site: Path, *arguments: str, preamble: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run simulate.py with the packages of a site folder alone, and a temporary folder that must
    be empty again."""
    start = f"import sys, runpy; sys.path.insert(0, {str(site)!r}); import importlib.util as u; "
    start += "assert not any(map(u.find_spec, ('hesr', 'hesr_model', 'mujoco', 'matplotlib'))); "
    start += "sys.argv = sys.argv[1:]\n" + preamble
    start += "\nrunpy.run_path(sys.argv[0], run_name='__main__')"
    command = [sys.executable, "-I", "-S", "-c", start, "simulate.py", *arguments]
    with tempfile.TemporaryDirectory() as temporary:
        said = subprocess.run(
            command,
            cwd=folder,
            env={**os.environ, "TMPDIR": temporary},
            capture_output=True,
            text=True,
            check=False,
        )
        assert not list(Path(temporary).iterdir())
    return said


def script(folder: Path, site: Path, *arguments: str) -> np.ndarray:
    """Run simulate.py; return its table."""
    said = start_script(folder, site, *arguments)
    assert said.returncode == 0, said.stderr
    table = np.loadtxt(folder / "tracking.csv", delimiter=",", skiprows=1)
    desired, q = np.split(table[:, 1:], 2, axis=1)
    rmse = 1e3 * np.sqrt(np.mean((desired - q) ** 2, axis=0))
    printed = re.fullmatch(r"RMSE \[mrad\]: (\S+) (\S+) (\S+)\n", said.stdout)
    assert printed is not None
    np.testing.assert_allclose([float(x) for x in printed.groups()], rmse, atol=6e-4)
    return table


@pytest.fixture(scope="module")
def loop(small_results: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hesr.export(small_results, tmp_path_factory.mktemp("to") / "loop", format="loop")


def test_results_and_exports_contain_both_loops(loop: Path, small_results: Path) -> None:
    assert {path.name for path in loop.iterdir()} == FILES | {"fmus", LIST}
    assert {path.name for path in small_results.iterdir()} >= FILES
    fmus = {"Arm", "Plant", "Trajectory", "InverseDynamics", "Controller", "Velocity", "parfam_h"}
    assert {path.stem for path in (loop / "fmus").iterdir()} == fmus


@pytest.mark.ci
@pytest.mark.parametrize(("name", "q"), [("closed_loop", "arm.q_true"), ("plant_loop", "arm.q")])
def test_the_script_gives_the_motion_of_hesr(name: str, q: str, loop: Path, bare: Path) -> None:
    """Bit for bit, and so does the SSP."""
    found = script(loop, bare, *(() if name == "closed_loop" else (f"{name}.toml",)))
    for suffix in (".toml", ".ssp"):
        run = System.read(loop / f"{name}{suffix}").run()
        whole = np.column_stack([run.t, run.vector("trajectory.q"), run.vector(q)])
        np.testing.assert_array_equal(found, whole)
    assert np.ptp(found[:, 4:], axis=0).min() > 0.01


def tracking_error(path: Path) -> np.ndarray:
    run = System.read(path).run()
    q = "arm.q_true" if "arm.q_true[1]" in run.signals else "arm.q"
    difference = run.vector("trajectory.q") - run.vector(q)
    return np.asarray(np.sqrt(np.mean(difference**2, axis=0)))


@pytest.mark.ci
def test_the_script_has_the_declared_coupling(loop: Path, bare: Path, tmp_path: Path) -> None:
    path = short_loop(loop, tmp_path, 'order = "gauss_seidel"', 'order = "jacobi"')
    found = script(loop, bare, str(path))
    run = System.read(path).run()
    whole = np.column_stack([run.t, run.vector("trajectory.q"), run.vector("arm.q_true")])
    np.testing.assert_array_equal(found, whole)
    other = System.read(short_loop(loop, tmp_path)).run()
    assert np.abs(other.vector("arm.q_true") - whole[:, 4:]).max() > 0.0


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('"gauss_seidel"', '"waveform"', "order = 'waveform' is not one of gauss_seidel, jacobi."),
        (
            '"arm"\n',
            '"arm"\nstep = 0.01\n',
            "'arm' has its own step; only 'hesr simulate' supports that.",
        ),
    ],
)
def test_the_script_refuses_couplings(
    old: str, new: str, sentence: str, loop: Path, bare: Path, tmp_path: Path
) -> None:
    path = short_loop(loop, tmp_path, old, new)
    said = start_script(loop, bare, str(path))
    assert (said.returncode, said.stdout, said.stderr) == (2, "", f"{path}: {sentence}\n")


@pytest.mark.ci
@pytest.mark.parametrize("name", ["closed_loop", "plant_loop"])
def test_jacobi_engines_need_a_longer_preview(name: str, loop: Path, tmp_path: Path) -> None:
    """As docs/import.md says: each value is a step late, and so is the motion."""
    text = (loop / f"{name}.toml").read_text(encoding="utf-8").replace('"fmus/', f'"{loop}/fmus/')
    jacobi, mended = tmp_path / "jacobi.toml", tmp_path / "mended.toml"
    late = text.replace('"gauss_seidel"', '"jacobi"')
    assert late != text
    jacobi.write_text(late, encoding="utf-8")
    preview, step = (
        float(re.search(rf'(?m)^"?{k}"? = (.*)$', text)[1]) for k in ("preview", "step")
    )
    longer = late.replace(f'"preview" = {preview}', f'"preview" = {preview + step}')
    assert longer != late
    mended.write_text(longer, encoding="utf-8")
    in_turn = tracking_error(loop / f"{name}.toml")
    delayed, ahead = (np.mean(tracking_error(path) / in_turn) for path in (jacobi, mended))
    assert delayed > 1.5
    assert ahead < 0.5 * delayed


def test_the_export_states_the_coupling(loop: Path) -> None:
    [_, line, _] = answer(loop, loop).summary().splitlines()[:3]
    assert line == OneSentence("Coupling: gauss_seidel", "2.5 to 6 times worse", "docs/import.md.")


# Prints the calls of FMUs that end them, in the order of the calls.
CALLS = """
import fmpy.fmi2 as fmi2
for name in ("terminate", "freeInstance", "doStep"):
    def call(slave, *values, name=name, original=getattr(fmi2.FMU2Slave, name)):
        if name != "doStep":
            print(name, slave.modelIdentifier)
        elif FAILS and slave.modelIdentifier == "controller":
            raise RuntimeError("the step fails")
        return original(slave, *values)
    setattr(fmi2.FMU2Slave, name, call)
"""


def short_loop(loop: Path, folder: Path, old: str = "", new: str = "") -> Path:
    """Copy the loop's file with one text replaced, and a shorter run."""
    text = (loop / "closed_loop.toml").read_text(encoding="utf-8")
    text = re.sub(r"(?m)^stop = .*$", "stop = 0.1", text).replace('"fmus/', f'"{loop}/fmus/')
    assert old in text
    path = folder / "short.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


@pytest.mark.ci
def test_the_script_ends_all_fmus(loop: Path, bare: Path, tmp_path: Path) -> None:
    """Also after an error, with an empty temporary folder."""
    path = str(short_loop(loop, tmp_path))
    spec = System.read(path).spec
    count = len(spec.components)
    said = start_script(loop, bare, path, preamble="FAILS = False" + CALLS)
    calls = [line.split()[0] for line in said.stdout.splitlines() if " " in line]
    assert said.returncode == 0, said.stderr
    assert calls == ["terminate"] * count + ["freeInstance"] * count + ["RMSE"]
    said = start_script(loop, bare, path, preamble="FAILS = True" + CALLS)
    assert "the step fails" in said.stderr
    assert said.returncode == 1
    assert [line.split()[0] for line in said.stdout.splitlines()] == ["freeInstance"] * count


CHOICES = "none, torque_error, servo_inversion"


@pytest.mark.ci
@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            '"servo_inversion"',
            '"servo"',
            f"controller.compensation = 'servo' is not one of {CHOICES}.",
        ),
        ('"servo_inversion"', "4", f"controller.compensation = 4 is not one of {CHOICES}."),
        ('"servo_inversion"', "2.5", f"controller.compensation = 2.5 is not one of {CHOICES}."),
        ('"preview"', '"prevew"', "there is no variable trajectory.prevew."),
        (
            '"Kv" = [',
            '"Kv" = [1.0, ',
            "controller.Kv = [1.0, 90.5, 150.8, 52.8] is not 3 number(s).",
        ),
        (
            '"rest_time" = 0.05',
            '"rest_time" = "short"',
            "trajectory.rest_time = 'short' is not 1 number(s).",
        ),
        ('"arm.q_true"]', '"arm.q_tru"]', "there is no variable arm.q_tru."),
    ],
)
def test_the_script_names_what_is_wrong(
    old: str, new: str, sentence: str, loop: Path, bare: Path, tmp_path: Path
) -> None:
    """In one sentence, with exit code 2, as does HESR."""
    path = short_loop(loop, tmp_path, old, new)
    said = start_script(loop, bare, str(path))
    assert (said.returncode, said.stdout, said.stderr) == (2, "", f"{path}: {sentence}\n")
    with pytest.raises(HesrError):
        System.read(path).run()


@pytest.mark.ci
def test_the_script_names_a_missing_file(loop: Path, bare: Path, tmp_path: Path) -> None:
    said = start_script(loop, bare, str(tmp_path / "none.toml"))
    sentence = f"{tmp_path / 'none.toml'}: there is no such file.\n"
    assert (said.returncode, said.stderr) == (2, sentence)


@pytest.mark.ci
def test_choices_have_numbers_too(loop: Path, bare: Path, tmp_path: Path) -> None:
    """Those of the FMU's page give the motion of their names."""
    tables = []
    for old, new in (("", ""), ('"servo_inversion"', "3")):
        said = start_script(loop, bare, str(short_loop(loop, tmp_path, old, new)))
        assert said.returncode == 0, said.stderr
        tables.append((loop / "tracking.csv").read_text(encoding="utf-8"))
    assert tables[0] == tables[1]


@pytest.mark.ci
def test_both_plants_track_alike(bench: Bench, tmp_path: Path) -> None:
    """With the friction and the servo of MuJoCo's arm in the plant."""
    plant = bench.plant
    truth = true_friction(plant.model, plant.joints, sample_time=0.005)
    fmu = export_plant(
        truth,
        tmp_path / "Plant.fmu",
        plant_body=PlantBody.from_robot(bench.robot),
        kv=GAINS.Kv,
        ki=GAINS.Ki,
    )
    for scheme in (
        Scheme(compensation="none"),
        Scheme(compensation="torque_error"),
        Scheme(compensation="servo_inversion"),
        Scheme(compensation="servo_inversion", Kx=5.0),
    ):
        spec = bench.system(bench.loop(scheme))
        errors = []
        start = {"arm": QUIET}
        for system, more, q in (
            (spec, start, "arm.q_true"),
            (replace_arm(spec, fmu, GAINS), {}, "arm.q"),
        ):
            with Master(system) as master:
                run = master.run(start=more).require_success()
            difference = run.vector("trajectory.q") - run.vector(q)
            errors.append(np.sqrt(np.mean(difference**2, axis=0)))
        np.testing.assert_allclose(errors[1], errors[0], rtol=ALIKE)
        assert errors[0].min() > 1e-3


@pytest.fixture
def study(tmp_path: Path) -> Path:
    (tmp_path / "motions.toml").write_text(MOTIONS, encoding="utf-8")
    text = STUDY.format(uf850=models_folder() / "uf850").split("[variants.plain]")
    rest = text[1].partition("[twin]")
    path = tmp_path / "study.toml"
    path.write_text(f"{text[0]}{''.join(rest[1:])}{SMALL_GAINS}", encoding="utf-8")
    return path


@pytest.mark.ci
def test_a_study_is_run_for_its_loop(study: Path, tmp_path: Path) -> None:
    """Its quick run tracks the quick laws on one motion."""
    outcome = hesr.run(study, output=tmp_path / "out", quick=True).outcome
    assert outcome.loop is not None
    laws = {str(row.law) for row in outcome.loop.tracking}
    assert {"stribeck", "lugre", "parfam_h"} < laws
    assert all(row.rmse.shape == (1, 3) for row in outcome.loop.tracking)
    assert "Tracking" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    path = hesr.export(study, tmp_path / "loop", format="loop")
    for name in ("closed_loop.toml", "plant_loop.toml"):
        again, first = (System.read(at / name).run() for at in (path, tmp_path / "out"))
        np.testing.assert_array_equal(again.vector("trajectory.q"), first.vector("trajectory.q"))


def test_sources_without_a_loop_are_refused(study: Path, tmp_path: Path) -> None:
    sentence = f"{tmp_path}: has no closed_loop.toml; 'hesr run'"
    with pytest.raises(ArtifactError, match=re.escape(sentence)):
        hesr.export(tmp_path, tmp_path / "loop", format="loop")
    study.write_text(study.read_text(encoding="utf-8").partition("[tracking]")[0])
    sentence = f"{study}: has no [tracking]"
    with pytest.raises(ArgumentError, match=re.escape(sentence)):
        hesr.export(study, tmp_path / "loop", format="loop")
    with pytest.raises(ArgumentError, match="'platform' is for single FMUs"):
        hesr.export(study, tmp_path / "loop", format="loop", platform=["win64"])


def test_masses_without_a_plant_are_reported(
    small_results: Path, table1: FrictionModel, tmp_path: Path
) -> None:
    robot = Robot(RobotDescription.read(UF850 / "robot.toml"))
    found = RigidBody.read(small_results / "rigid_body.json")
    settings = Study.read(small_results.parent / "study.toml").tracking
    assert settings is not None
    law = {"parfam_h": small_results / "fmus" / "parfam_h.fmu"}
    fmus, plant = small_results / "fmus", Plant.read(UF850 / "plant.toml")
    loop = assemble(fmus, robot, tracking=settings, friction=law, plant=plant)
    nothing = replace(found, parameters=0.0 * found.parameters)
    [finding] = write_loops(loop, robot, nothing, {"table1": table1}, tmp_path)
    assert finding.sentence == Containing("generated plant", "'uf850' the eigenvalue 0 kg.m2")
    assert (tmp_path / "closed_loop.toml").is_file()
    assert not (tmp_path / "plant_loop.toml").exists()
