"""Systems inside one FMU: results of the runtime's coupling, parameters, inputs, refusals."""

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from couplings import error, refreshed
from fmpy.model_description import read_model_description

from cosim.systems.system import SystemSpec
from fmu_src.check.run import check
from fmu_src.run.fmu import FmuInstance
from hesr.extras.ssp.container import write_container
from hesr.extras.ssp.contents import SystemContents, read_contents
from hesr_model.errors import ConfigError, ExportError, SimulationError

Write = Callable[..., Path]

STEPS = 2000
ENUMERATION = """<TypeDefinitions><SimpleType name="Kind"><Enumeration>
<Item name="fourier" value="1"/><Item name="sine" value="2"/>
</Enumeration></SimpleType></TypeDefinitions>"""


@pytest.fixture(scope="session")
def containers(
    opened: SystemContents, closed: SystemContents, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("containers")
    return {
        c.spec.name: write_container(c, folder / f"{c.spec.name}.fmu") for c in (opened, closed)
    }


def names(contents: SystemContents) -> list[str]:
    return [".".join(element) for element in contents.wiring.observed]


def run(
    fmu: FmuInstance, contents: SystemContents, steps: int = STEPS, **start: float
) -> np.ndarray:
    outputs, step = fmu.buffer(names(contents)), contents.spec.step
    fmu.initialise(start={name.replace("__", "."): value for name, value in start.items()})
    rows = [outputs.read().copy()]
    for k in range(steps):
        fmu.step(k * step, step)
        rows.append(outputs.read().copy())
    return np.array(rows)


def test_ten_seconds_match_the_reference_coupling(
    either: SystemContents, containers: dict[str, Path]
) -> None:
    expected = refreshed(either, either.wiring.observed, STEPS)
    with FmuInstance(containers[either.spec.name]) as fmu:
        found = run(fmu, either)
    assert error(found, expected) <= (1e-12 if either.spec.name == "open" else 1e-9)
    assert np.abs(np.diff(found, axis=0)).max() > 1e-3


def test_the_arm_tracks_its_motion(closed: SystemContents, containers: dict[str, Path]) -> None:
    """The coupling costs no accuracy: 7 mrad, as with FMUs stepped in order."""
    with FmuInstance(containers["closed"]) as fmu:
        rows = run(fmu, closed)
    error = rows[:, :3] - rows[:, 3:6]
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.008


def test_one_long_step_equals_many_short_ones(
    closed: SystemContents, containers: dict[str, Path]
) -> None:
    with FmuInstance(containers["closed"]) as fmu:
        expected = run(fmu, closed, 200)[-1]
        fmu.reset()
        fmu.initialise()
        fmu.step(0.0, 1.0)
        np.testing.assert_array_equal(fmu.get(names(closed)), expected)


def test_a_reset_and_a_second_instance_start_afresh(
    opened: SystemContents, containers: dict[str, Path]
) -> None:
    with FmuInstance(containers["open"]) as fmu, FmuInstance(containers["open"]) as other:
        expected = run(fmu, opened, 100)
        np.testing.assert_array_equal(run(other, opened, 100), expected)
        fmu.reset()
        np.testing.assert_array_equal(run(fmu, opened, 100), expected)


def test_start_values_are_kept_and_can_be_changed(
    opened: SystemContents, containers: dict[str, Path]
) -> None:
    about = read_model_description(containers["open"])
    variables = {v.name: v for v in about.modelVariables}
    for component, start in opened.wiring.start.items():
        for name, value in start.items():
            assert float(variables[f"{component}.{name}"].start) == float(value)
    alpha = variables["friction.joint[1].alpha"]
    assert (alpha.causality, alpha.variability, alpha.unit) == ("parameter", "tunable", "1/s")
    changed = {"period": 8.0}
    spec = opened.spec
    components = tuple(
        c.model_copy(update={"start": {**c.start, **changed}}) if c.name == "trajectory" else c
        for c in spec.components
    )
    other = read_contents(spec.model_copy(update={"components": components}), opened.path)
    with FmuInstance(containers["open"]) as fmu:
        found = run(fmu, opened, 200, trajectory__period=8.0)
    np.testing.assert_array_equal(found, refreshed(other, other.wiring.observed, 200))


def test_inputs_outputs_and_parameters_are_exposed(
    closed: SystemContents, containers: dict[str, Path]
) -> None:
    about = read_model_description(containers["closed"])
    shown = {causality: {v.name for v in about.modelVariables if v.causality == causality}
             for causality in ("input", "output", "parameter", "local")}  # fmt: skip
    assert shown["output"] == set(names(closed))
    # The unconnected inputs: velocity and acceleration of the gravity torque.
    assert shown["input"] == {f"gravity.{n}[{i}]" for n in ("dq", "ddq") for i in (1, 2, 3)}
    assert {"controller.tau_d[1]", "arm.tau_meas[3]", "friction.tau[2]"} <= shown["local"]
    assert about.coSimulation.modelIdentifier == "closed"
    assert about.defaultExperiment.stepSize == "0.005"


def test_enumerations_become_integers_with_their_names(
    opened: SystemContents, tmp_path: Path
) -> None:
    """An FMU with an Enumeration, as other tools write it."""
    given = opened.spec.components[0].fmu
    changed = tmp_path / "trajectory.fmu"
    with zipfile.ZipFile(given) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            data = old.read(name).decode("latin-1")
            if name == "modelDescription.xml":
                data = re.sub(
                    r"<TypeDefinitions>.*</TypeDefinitions>", ENUMERATION, data, flags=re.S
                )
                data = re.sub(
                    r'<Integer declaredType="Motion"[^>]*>',
                    '<Enumeration declaredType="Kind" start="2" />',
                    data,
                )
                assert 'declaredType="Kind"' in data
            new.writestr(name, data.encode("latin-1"))
    first, second = opened.spec.components
    components = (first.model_copy(update={"fmu": changed}), second)
    contents = read_contents(opened.spec.model_copy(update={"components": components}), opened.path)
    path = write_container(contents, tmp_path / "open.fmu")
    variables = {v.name: v for v in read_model_description(path).modelVariables}
    kind = variables["trajectory.kind"]
    assert (kind.type, kind.start) == ("Integer", "1")
    assert kind.description.endswith(": 1 = fourier, 2 = sine")
    with FmuInstance(path) as fmu:
        found = run(fmu, opened, 100)
    np.testing.assert_array_equal(found, refreshed(opened, opened.wiring.observed, 100))


def test_outputs_declare_their_dependencies(
    opened: SystemContents, closed: SystemContents, containers: dict[str, Path]
) -> None:
    """The command depends on the gravity torque and so on its inputs; positions do not."""
    about = read_model_description(containers["closed"])
    needed = {u.variable.name: {v.name for v in u.dependencies} for u in about.outputs}
    assert needed["arm.q_true[1]"] == needed["trajectory.q[1]"] == set()
    free = {f"gravity.{n}[{i}]" for n in ("dq", "ddq") for i in (1, 2, 3)}
    assert needed["controller.dq_cmd[1]"] == free
    initial = {u.variable.name: {v.name for v in u.dependencies} for u in about.initialUnknowns}
    assert "arm.q0[1]" in initial["arm.q_true[1]"]
    assert "trajectory.offset[2]" in initial["controller.dq_cmd[2]"]


def test_the_export_is_reproducible(
    opened: SystemContents, containers: dict[str, Path], tmp_path: Path
) -> None:
    again = write_container(read_contents(opened.spec, opened.path), tmp_path / "open.fmu")
    assert again.read_bytes() == containers["open"].read_bytes()


@pytest.mark.ci
def test_checks_find_no_problem(containers: dict[str, Path]) -> None:
    """Properties of FMPy's runtime are noted, not reported as problems."""
    for path in containers.values():
        own = [n for n in zipfile.ZipFile(path).namelist() if n.startswith("binaries/")]
        assert own
        found = check(path)
        assert found.problems == ()
        assert [text for text in found.skipped if "FMPy" in text] == [
            f"paths in {name}: container_fmu{Path(name).suffix} of FMPy as it is distributed, "
            "built elsewhere."
            for name in own
            if "container_fmu" in name
        ]


def test_steps_between_multiples_hold_the_last_values(
    opened: SystemContents, containers: dict[str, Path]
) -> None:
    step = opened.spec.step
    with FmuInstance(containers["open"]) as fmu:
        expected = run(fmu, opened, 40)
        fmu.reset()
        fmu.initialise()
        time = 0.0
        for part in (0.2 * step, 1e-14, 0.5 * step, 2**0.5 * step, 3.0 * step) * 6:
            fmu.step(time, part)
            time += part
            np.testing.assert_array_equal(fmu.get(names(opened)), expected[int(time / step + 1e-6)])


def test_fmpy_simulates_it_from_another_folder(
    opened: SystemContents, containers: dict[str, Path], tmp_path: Path
) -> None:
    moved = tmp_path / "a folder" / "Moved.fmu"
    moved.parent.mkdir()
    moved.write_bytes(containers["open"].read_bytes())
    result = fmpy.simulate_fmu(moved, stop_time=1.0, output_interval=0.005, output=names(opened))
    expected = refreshed(opened, opened.wiring.observed, 200)
    assert len(result) == len(expected)
    found = np.column_stack([result[name] for name in names(opened)])
    assert error(found, expected) <= 1e-12


def test_an_inner_failure_is_reported(lag_fmu: Path, tmp_path: Path) -> None:
    spec = SystemSpec.model_validate(
        {
            "name": "one",
            "step": 0.1,
            "stop": 1.0,
            "components": [{"name": "a", "fmu": lag_fmu, "start": {"u": 1.0, "refused": 0.25}}],
        }
    )
    path = write_container(read_contents(spec, Path("one.toml")), tmp_path / "one.fmu")
    with FmuInstance(path) as fmu:
        fmu.initialise()
        fmu.step(0.0, 0.1)
        fmu.step(0.1, 0.1)
        with pytest.raises(SimulationError, match=r"^one\.fmu \('one'\) at t = 0\.2 s: "):
            fmu.step(0.2, 0.1)


def test_a_component_step_is_refused(lags: Write, tmp_path: Path) -> None:
    path = lags()
    with pytest.raises(
        ConfigError,
        match=r"lags\.toml: component 'b' has a step of 0\.2 s; it must equal the container's, "
        r"0\.1 s\.$",
    ):
        write_container(read_contents(SystemSpec.read(path), path), tmp_path / "lags.fmu")
    assert not (tmp_path / "lags.fmu").exists()


def test_a_platform_shared_by_all_components_is_required(
    opened: SystemContents, tmp_path: Path
) -> None:
    source, bare = opened.spec.components[0].fmu, tmp_path / "bare.fmu"
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(bare, "w") as new:
        for name in old.namelist():
            if not name.startswith(("binaries/", "sources/")):
                new.writestr(name, old.read(name))
    first, second = opened.spec.components
    components = (first.model_copy(update={"fmu": bare}), second)
    contents = read_contents(opened.spec.model_copy(update={"components": components}), opened.path)
    with pytest.raises(
        ConfigError,
        match=r"^open\.toml: no platform of a container \(linux64, win64\) has binaries of all "
        r"components\.$",
    ):
        write_container(contents, tmp_path / "open.fmu")


def test_a_runtime_is_required(
    opened: SystemContents, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with FMPy versions that have no runtime."""
    from fmpy import container_fmu

    monkeypatch.setattr(container_fmu, "__file__", str(tmp_path / "__init__.py"))
    with pytest.raises(ExportError, match=r"has no container runtime; install FMPy 0\.3\.32 or"):
        write_container(opened, tmp_path / "open.fmu")
