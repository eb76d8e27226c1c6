"""FMUs of FMI 3.0 in systems: same names and same results."""

from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from interop.drive import driven
from small_fmus import lag

from cosim.systems.simulation import Master
from cosim.systems.system import ComponentSpec, SystemSpec
from fmu_src.blocks.controller import velocity
from fmu_src.export.description3 import to_xml3
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.trust import is_trusted
from fmu_src.run.variables import model_description
from hesr_model.errors import SimulationError
from hesr_model.friction.model import FrictionModel


@pytest.fixture(scope="module")
def lag3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return lag(tmp_path_factory.mktemp("lag3"), fmi=3)


@pytest.fixture(scope="module")
def friction3(table1: FrictionModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_bare(table1, tmp_path_factory.mktemp("friction3") / "F.fmu", fmi=3)


@pytest.fixture(params=["own", "foreign"])
def fmu(request: pytest.FixtureRequest, friction3: Path, tmp_path: Path) -> Path:
    """The same friction FMU in this process and in a separate one."""
    if request.param == "own":
        return friction3
    foreign = tmp_path / "F.fmu"
    foreign.write_bytes(friction3.read_bytes())
    with ZipFile(foreign, "a") as archive:
        archive.comment = b"of a stranger"
    assert not is_trusted(foreign)
    return foreign


def test_elements_of_arrays_are_set_and_read_individually(fmu: Path, friction_fmu: Path) -> None:
    """Elements not set keep their values, though FMI 3.0 sets arrays as a whole."""
    found = []
    for file in (fmu, friction_fmu):
        with FmuInstance(file) as friction:
            start = {"dq[2]": 0.3, "tau_load[3]": 4.0, "discretisation": 1, "joint[1].alpha": 250.0}
            friction.initialise(start=start)
            rows = []
            batch, some = friction.buffer(["dq[3]", "dq[1]"]), friction.buffer(["tau[2]", "tau[1]"])
            for k in range(50):
                batch.values[:] = (0.01 * k, -0.02 * k)
                batch.write()
                friction.step(0.005 * k, 0.005)
                rows.append([*some.read(), *friction.get(["tau[3]", "dq[2]", "h[2]"])])
            friction.reset()
            friction.initialise()
            rows.append([*some.read(), *friction.get(["tau[3]", "dq[2]", "h[2]"])])
            found.append(np.array(rows))
    np.testing.assert_array_equal(found[0], found[1])
    assert found[0][-2, 3] == 0.3
    assert found[0][-1, 3] == 0.0


def test_errors_read_as_those_of_fmi_2(fmu: Path) -> None:
    with FmuInstance(fmu) as friction:
        with pytest.raises(SimulationError, match="there is no variable 'dv\\[1\\]'; did you mean"):
            friction.get(["dv[1]"])
        friction.initialise()
        with pytest.raises(SimulationError, match="fmi3DoStep: the step is -1 s from time 0 s"):
            friction.step(0.0, -1.0)
    said = "fmi3SetInt32: discretisation is 7; expected"
    with FmuInstance(fmu) as friction, pytest.raises(SimulationError, match=said):
        friction.set({"discretisation": 7})
    with FmuInstance(fmu) as friction:
        friction.initialise()
        with pytest.raises(SimulationError, match="inputs have no derivatives in FMI 3"):
            friction.slopes(["dq[1]"])(np.array([1.0]))


def test_a_system_may_mix_both_versions(lag_fmu: Path, lag3: Path) -> None:
    """Bitwise equal to the system of FMI 2.0 FMUs."""
    results = []
    for first, second in ((lag_fmu, lag_fmu), (lag3, lag_fmu), (lag3, lag3)):
        parts = (
            ComponentSpec(name="a", fmu=first, start={"u": 2.0, "T": 0.3}),
            ComponentSpec(name="b", fmu=second, step=0.02),
        )
        spec = SystemSpec(
            name="lags",
            step=0.01,
            stop=0.5,
            components=parts,
            connections={"b.u": "a.y"},
            observe=("a.y", "b.y"),
        )
        with Master(spec) as master:
            results.append(master.run().require_success().signals)
    for other in results[1:]:
        for name, values in results[0].items():
            np.testing.assert_array_equal(other[name], values)


def test_partial_start_values_of_arrays_are_completed(friction3: Path) -> None:
    case = driven(friction3, start={"tau_load[2]": 3.0})
    assert case.arrays["tau_load"] == ("tau_load[1]", "tau_load[2]", "tau_load[3]")
    assert case.start == {"tau_load[1]": 0.0, "tau_load[2]": 3.0, "tau_load[3]": 0.0}
    assert set(case.inputs) == {f"{name}[{i}]" for name in ("dq", "q") for i in (1, 2, 3)} | {
        "tau_load[1]",
        "tau_load[3]",
    } - set(case.start)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<Dimension start="2"', '<Dimension start="-2"', "a dimension of 'q' is -2"),
        ('<Dimension start="2"', '<Dimension start="999999999"', "elements; at most 100000 can"),
        ('valueReference="5"', 'valueReference="-1"', "the value reference of 'time' is -1"),
        ('valueReference="5"', f'valueReference="{2**40}"', "the value reference of 'time' is 1"),
        ('start="0.0 0.0"', 'start="0.0 x"', "could not convert string to float: 'x'"),
    ],
)
def test_oversized_arrays_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    """Each of a billion elements would need a name."""
    block, fmu = velocity(2), tmp_path / "Odd.fmu"
    text = to_xml3(block.table, block.about, "{7f}").decode()
    assert old in text
    with ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", text.replace(old, new, 1))
    with pytest.raises(SimulationError, match=r"Odd\.fmu: not a readable FMU \(") as found:
        model_description(fmu)
    assert said in str(found.value)
