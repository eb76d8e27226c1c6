"""A single slave: access by name, errors with variable and time, always freed."""

import math
import re
import shutil
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from containing import Containing
from pythonfmu.builder import FmuBuilder

from cosim.systems.system import ComponentSpec, SystemSpec
from fmu_src.run.fmu import FmuInstance
from hesr.extras.ssp.contents import read_contents
from hesr_model.errors import ConfigError, SimulationError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Folder of extracted FMUs."""
    place = tmp_path / "extracted"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


def without(fmu, copy, prefix):
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(copy, "w") as new:
        for name in old.namelist():
            if not name.startswith(prefix):
                new.writestr(name, old.read(name))
    return copy


def test_values_are_set_and_read_by_name(friction_fmu):
    with FmuInstance(friction_fmu) as friction:
        friction.initialise(start={"dq[1]": 0.2, "discretisation": 1, "h_start[2]": 0.5})
        assert friction.get(["h[2]", "dq[1]"]).tolist() == [0.5, 0.2]
        friction.set({"dq[2]": 0.3, "dq[1]": 0.1})
        friction.step(0.0, 0.005)
        assert friction.time == 0.005
        assert friction.get(["dq[1]", "dq[2]"]).tolist() == [0.1, 0.3]


def test_batches_use_one_buffer(friction_fmu):
    with FmuInstance(friction_fmu) as friction:
        friction.initialise()
        assert friction.time == 0.0
        inputs, outputs = friction.buffer(["dq[1]", "dq[2]"]), friction.buffer(["tau[1]", "tau[2]"])
        inputs.values[:] = 0.3, -0.3
        inputs.write()
        friction.step(0.0, 0.005)
        values = outputs.read()
        assert values is outputs.values
        np.testing.assert_array_equal(values, friction.get(["tau[1]", "tau[2]"]))


def test_outputs_are_readable_during_initialisation(friction_fmu):
    with FmuInstance(friction_fmu) as friction:
        friction.enter_initialisation(time=2.0)
        friction.set({"dq[1]": 0.4})
        before = friction.get(["tau[1]"])
        friction.exit_initialisation()
        assert friction.get(["tau[1]"]) == before


def test_reset_restores_the_start(friction_fmu):
    with FmuInstance(friction_fmu) as friction:
        friction.initialise(start={"dq[1]": 0.4})
        friction.step(0.0, 0.005)
        friction.reset()
        friction.initialise()
        assert friction.get(["dq[1]", "h[1]"]).tolist() == [0.0, 0.0]


def test_errors_name_the_fmu_the_time_and_the_variable(friction_fmu):
    with FmuInstance(friction_fmu, name="gear") as friction:
        friction.initialise()
        friction.step(0.0, 0.25e-1)
        with pytest.raises(SimulationError) as error:
            friction.set({"dq[2]": math.nan})
    assert str(error.value) == (
        "Friction.fmu ('gear') at t = 0.025 s: fmi2SetReal: dq[2] is nan; a finite number is "
        "needed."
    )
    assert friction.messages == ["fmi2SetReal: dq[2] is nan; a finite number is needed."]


def test_failed_steps_name_their_start_time(friction_fmu):
    with FmuInstance(friction_fmu) as friction:
        friction.initialise(time=1.5)
        with pytest.raises(SimulationError, match=r"at t = 1\.5 s: h\[1\]: Euler needs rate \* st"):
            friction.step(1.5, 1.0)


def test_unknown_variables_are_refused(friction_fmu):
    with FmuInstance(friction_fmu) as friction:
        with pytest.raises(SimulationError) as caught:
            friction.get(["tau[9]"])
        assert str(caught.value).endswith(
            "there is no variable 'tau[9]'; did you mean 'tau[1]', 'tau[2]' or 'tau[3]'?"
        )
        with pytest.raises(SimulationError, match="'discretisation' is not a Real"):
            friction.buffer(["discretisation"])


def test_nothing_is_left_behind(friction_fmu, folder):
    with FmuInstance(friction_fmu) as friction:
        friction.initialise()
        friction.step(0.0, 0.005)
        assert list(folder.iterdir())
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), SimulationError("it is off."), ValueError()]
)
def test_nothing_is_left_behind_after_an_error(friction_fmu, folder, error):
    def use():
        with FmuInstance(friction_fmu) as friction:
            friction.initialise()
            raise error

    with pytest.raises(type(error)):
        use()
    assert not list(folder.iterdir())


def test_slaves_that_fail_to_terminate_are_freed(friction_fmu, folder):
    with FmuInstance(friction_fmu) as friction:
        friction.initialise()
        friction._instance.slave.terminate()
    assert friction.messages == [Containing("allowed in this state")]
    assert not list(folder.iterdir())


def test_files_other_than_fmus_are_refused(tmp_path, folder):
    path = tmp_path / "X.fmu"
    path.write_text("not an archive")
    for fmu, said in ((path, "not a readable FMU"), (tmp_path / "missing.fmu", "no such file")):
        with pytest.raises(SimulationError, match=said), FmuInstance(fmu):
            pass
    assert not list(folder.iterdir())


def test_an_fmu_for_model_exchange_only_is_refused(friction_fmu, tmp_path, folder):
    """The master has no solver for it."""
    fmu = tmp_path / "X.fmu"
    with zipfile.ZipFile(friction_fmu) as old, zipfile.ZipFile(fmu, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                data = re.sub(rb"<CoSimulation.*?</CoSimulation>", b"", data, flags=re.S)
            new.writestr(name, data)
    said = f"{fmu}: not an FMU of FMI"
    with pytest.raises(SimulationError, match=re.escape(said)), FmuInstance(fmu):
        pass
    component = ComponentSpec(name="friction", fmu=fmu)
    spec = SystemSpec(name="alone", step=0.01, stop=0.1, components=(component,), connections={})
    with pytest.raises(ConfigError) as caught:
        read_contents(spec, tmp_path / "alone.toml")
    where = f"{tmp_path / 'alone.toml'}: component 'friction'"
    assert f"{where}: {fmu} is not an FMI" in str(caught.value)


def test_fmus_for_other_platforms_are_refused(friction_fmu, tmp_path, folder):
    fmu = without(friction_fmu, tmp_path / "X.fmu", "binaries/")
    with pytest.raises(SimulationError, match="no binary for this platform"):
        FmuInstance(fmu).__enter__()
    assert not list(folder.iterdir())


def test_binaries_of_another_description_are_refused(friction_fmu, tmp_path, folder):
    fmu = without(friction_fmu, tmp_path / "X.fmu", "modelDescription")
    with zipfile.ZipFile(friction_fmu) as old, zipfile.ZipFile(fmu, "a") as new:
        text = old.read("modelDescription.xml").decode()
        guid = text.split('guid="')[1].split('"')[0]
        new.writestr("modelDescription.xml", text.replace(guid, "{other}"))
    with pytest.raises(SimulationError, match="the GUID"):
        FmuInstance(fmu).__enter__()
    assert not list(folder.iterdir())


def test_broken_binaries_are_refused(friction_fmu, tmp_path, folder):
    fmu = without(friction_fmu, tmp_path / "X.fmu", "binaries/")
    with zipfile.ZipFile(friction_fmu) as old, zipfile.ZipFile(fmu, "a") as new:
        name = next(n for n in old.namelist() if n.startswith("binaries/"))
        new.writestr(name, b"nothing")
    with pytest.raises(SimulationError, match="its binary cannot be loaded") as caught:
        FmuInstance(fmu).__enter__()
    assert str(folder) not in str(caught.value)
    assert not list(folder.iterdir())


FAILING = """
from pythonfmu import Fmi2Slave


class Failing(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        if "resources" in __file__:  # not while it is built
            raise ValueError("no licence")

    def do_step(self, current_time, step_size):
        return True
"""


def test_the_reason_of_a_failed_instantiation_is_given(tmp_path, folder):
    """PythonFMU gives it only while logging is on."""
    script = tmp_path / "unlicensed.py"
    script.write_text(FAILING, encoding="utf-8")
    fmu = Path(FmuBuilder.build_FMU(script, dest=tmp_path))
    with pytest.raises(SimulationError, match="no licence"):
        FmuInstance(fmu).__enter__()


def test_one_file_serves_many_components(friction_fmu, tmp_path):
    copy = Path(shutil.copy(friction_fmu, tmp_path / "Copy.fmu"))
    with (
        FmuInstance(friction_fmu) as one,
        FmuInstance(friction_fmu) as two,
        FmuInstance(copy) as three,
    ):
        for component, speed in ((one, 0.1), (two, 0.2), (three, 0.1)):
            component.initialise(start={"dq[1]": speed})
            component.step(0.0, 0.005)
        first, second, third = (c.get(["tau[1]"])[0] for c in (one, two, three))
    assert first == third != second


def test_fmus_may_allocate_memory_from_the_host(friction_fmu):
    with FmuInstance(friction_fmu) as friction:
        callbacks = friction._instance.slave.callbacks
        assert callbacks.allocateMemory
        assert callbacks.freeMemory


def test_messages_of_earlier_calls_are_not_given_as_reasons(friction_fmu):
    with FmuInstance(friction_fmu) as friction:
        friction._log(0, "all is well")
        friction._log(1, "almost")
        with pytest.raises(SimulationError, match=r"at t = 0 s: fmi2DoStep failed with status 3"):
            friction._instance.fail("fmi2DoStep", 3)
    assert friction.messages == ["all is well", "almost"]


def test_batches_may_use_memory_of_the_host(friction_fmu):
    values = np.zeros(4)
    with FmuInstance(friction_fmu) as friction:
        friction.initialise(start={"dq[1]": 0.1, "dq[2]": 0.2})
        friction.buffer(["dq[1]", "dq[2]"], values[1:3]).read()
    assert values.tolist() == [0.0, 0.1, 0.2, 0.0]
