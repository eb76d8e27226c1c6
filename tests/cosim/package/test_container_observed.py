"""Observed signals that cannot be outputs of a container keep their kind."""

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.model_description import read_model_description

from cosim.systems.simulation import System
from cosim.systems.system import SystemSpec
from fmu_src.check.run import check
from fmu_src.run.fmu import FmuInstance
from hesr.extras.ssp.container import write_container
from hesr.extras.ssp.contents import SystemContents, read_contents

Write = Callable[..., Path]


def test_all_observable_variables_are_exposed(lags: Write, tmp_path: Path) -> None:
    """A connected input, a free one, a parameter, a state and its derivative match our own runs."""
    observed = ["a.y", "b.u", "a.u", "a.T", "a.x", "a.der(x)"]
    system = lags(('["a.y", "b.y"]', str(observed).replace("'", '"')), ("step = 0.2\n", ""))
    spec = SystemSpec.read(system)
    contents = read_contents(spec, system)
    path = write_container(contents, tmp_path / "lags.fmu")
    assert check(path).problems == ()
    about = read_model_description(path)
    assert about.variableNamingConvention == "flat"
    causality = {v.name: v.causality for v in about.modelVariables if v.name in observed}
    kept = {"a.u": "input", "a.T": "parameter"}
    assert causality == dict.fromkeys(observed, "output") | kept
    found = fmpy.simulate_fmu(path, stop_time=1.0, output_interval=0.1, output=observed)
    # The runtime passes on new values within the step, as Gauss-Seidel does.
    expected = System(spec, system).run()
    for name in observed:
        np.testing.assert_allclose(found[name], expected.signals[name], rtol=1e-12)


@pytest.mark.ci
def test_an_observed_tunable_parameter_is_exposed(opened: SystemContents, tmp_path: Path) -> None:
    spec = opened.spec.model_copy(
        update={"observe": (*opened.spec.observe, "friction.joint[1].alpha")}
    )
    path = write_container(read_contents(spec, opened.path), tmp_path / "open.fmu")
    assert check(path).problems == ()
    about = {v.name: v for v in read_model_description(path).modelVariables}
    alpha = about["friction.joint[1].alpha"]
    assert (alpha.causality, alpha.variability) == ("parameter", "tunable")
    with FmuInstance(path) as fmu:
        fmu.initialise()
        assert fmu.get(["friction.joint[1].alpha"])[0] == float(alpha.start)


def test_calculated_parameters_are_local(opened: SystemContents, tmp_path: Path) -> None:
    """A calculated parameter cannot be an output; the FMU's parameter is turned into one."""
    given, changed = opened.spec.components[1].fmu, tmp_path / "friction.fmu"
    with zipfile.ZipFile(given) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                text = data.decode()
                head, variable, rest = text.partition('<ScalarVariable name="joint[1].alpha"')
                rest = rest.replace('"parameter"', '"calculatedParameter"', 1)
                rest = rest.replace('"exact"', '"calculated"', 1)
                rest = re.sub(r' start="[^"]*"', "", rest, count=1)
                data = (head + variable + rest).encode()
            new.writestr(name, data)
    first, second = opened.spec.components
    update = {
        "components": (first, second.model_copy(update={"fmu": changed})),
        "observe": (*opened.spec.observe, "friction.joint[1].alpha"),
    }
    contents = read_contents(opened.spec.model_copy(update=update), opened.path)
    variable = contents.variables["friction"]["joint[1].alpha"]
    assert (variable.causality, variable.start) == ("calculatedParameter", None)
    path = write_container(contents, tmp_path / "open.fmu")
    about = {v.name: v for v in read_model_description(path).modelVariables}
    assert about["friction.joint[1].alpha"].causality == "local"
