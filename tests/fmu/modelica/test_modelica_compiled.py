"""Third-party compilers read an exported package, and one simulates it: results are the law's.

Neither PyPI, npm, Maven Central nor Debian has the Modelica Standard Library (PyPI's
rtc-tools-standard-library has its units only). The bearings and the examples use a replacement
(library/Modelica.mo) with the names and equations of the few classes needed. Ten cases use the
real library if MODELICAPATH, as used by Modelica tools, names a folder that has it; CI skips them.
"""

import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from modelica_laws import ADDED, EVERY, LIBRARY, STOPS
from modelica_truth import (
    MODELICA,
    TIMES,
    equations,
    fmu_torque,
    integrated,
    python_torque,
    relative,
    simulate,
)

from fmu_src.friction.friction_fmu import export_bare
from hesr_model.equations.functions import sgn
from hesr_model.friction.inputs import TAU_LOAD

pytestmark = pytest.mark.ci


@pytest.fixture(params=EVERY)
def joint(request):
    """One-based number of a joint."""
    return EVERY.index(request.param) + 1


GATE = ("stribeck", "lugre_load_ripple", "rbfnn_h", *ADDED)
"""Laws of different forms; tests of the others run at night."""


def in_motion(*laws, gate=GATE):
    """Stops are stiff: nine digits take solvers minutes for half a second."""

    def mark(name):
        if name in STOPS:
            return pytest.mark.soak
        return () if name in gate else pytest.mark.nightly("laws")

    names = [pytest.param(name, marks=mark(name)) for name in laws]
    return pytest.mark.parametrize("joint", names, indirect=True)


BEARINGS, INERTIAS = EVERY[::2], ("stribeck", *EVERY[1::2])
"""Laws whose examples with a bearing or an inertia are simulated: they differ in the law only, and
each law is simulated alone."""


@pytest.fixture
def law(joint, laws):
    return laws.laws[joint - 1]


@pytest.fixture(scope="session")
def block(package, rumoca):
    """Compile a class of the package without any library."""
    session = rumoca.Session()
    return lambda name: session.load(str(package), model=f"Every.{name}")


def real_library():
    """Folder of the sources of the Modelica Standard Library, or None."""
    places = os.environ.get("MODELICAPATH", "").split(os.pathsep)
    found = [f for p in places if p for f in sorted(Path(p).glob("Modelica [4-9]*/package.mo"))]
    found += [f for p in places if p for f in Path(p).glob("Modelica/package.mo")]
    return str(found[-1].parent.parent) if found else None


@pytest.fixture(scope="session", params=["stand-in", "real"])
def library(request):
    """Folder of a Modelica Standard Library."""
    if request.param == "stand-in":
        return str(LIBRARY)
    real = real_library()
    if real is None:
        pytest.skip("MODELICAPATH names no folder with the Modelica Standard Library")
    return real


@pytest.fixture(scope="session")
def coupled(package, rumoca, library):
    """Compile a class of the package that uses the Modelica Standard Library."""
    session = rumoca.Session(roots=[library])
    return lambda name: session.load(str(package), model=f"Every.{name}")


@pytest.fixture(scope="session")
def simulated(rumoca):
    return partial(simulate, rumoca)


@pytest.fixture(scope="session")
def fmu(laws, load, tmp_path_factory):
    return load(export_bare(laws, tmp_path_factory.mktemp("every") / "Every.fmu"))


def test_blocks_compile_without_any_library(joint, law, block):
    model = block(f"Joint{joint}")
    found = model.structure()
    assert (found.is_balanced, found.is_matched, found.n_algebraic_loops) == (True, True, 0)
    assert model.inputs.names == ["dq", "q", "tau_load"]
    assert model.outputs.names == ["tau"]
    assert model.states.names == [m.name for m in law.form.memory]
    starts = zip((f"{m.name}_start" for m in law.form.memory), law.start, strict=True)
    values = {p.name: p.value for p in model.parameters}
    steady = {"steadyStart": 1.0} if law.form.memory else {}
    assert values == law.values | dict(starts) | steady  # bit for bit
    units = {p.name: p.unit for p in model.parameters}
    assert {c.name: c.unit for c in law.form.coefficients}.items() <= units.items()


@in_motion(*ADDED)
def test_modelica_fmu_and_python_agree(joint, law, package, rumoca, simulated, fmu):
    """For forms that no law of the registry has; contract/test_lowerings.py tests those."""
    text = package.read_text(encoding="utf-8") + MODELICA.format(block=f"Every.Joint{joint}")
    model = rumoca.Session().loads(text, model="Reference")
    expected = python_torque(law)
    assert relative(simulated(model, TIMES)["law.tau"], expected) <= 1e-9
    assert relative(fmu_torque(fmu, joint, law), expected) <= 1e-9


@in_motion(*BEARINGS)
def test_examples_move_a_bearing_with_the_torque_of_the_law(joint, law, coupled, simulated):
    model = coupled(f"Examples.Joint{joint}Speed")
    amplitude, load = (value(model, name) for name in ("sine.amplitude", "load.k"))
    slope, torque = equations(law)
    rate = 2.0 * np.pi * 0.25
    times = np.linspace(0.0, 3.0, 301)  # with a reversal at 2 s

    def inputs(t):
        return amplitude * np.sin(rate * t), amplitude / rate * (1.0 - np.cos(rate * t)), load

    def moved(t, x):
        return slope(inputs(t), x)

    first = integrated(moved, np.array(law.start), 0.0, 2.0, times[times < 1.999])
    second = integrated(moved, first[-1], 2.0, 3.0, times[times > 2.001])
    found = simulated(model, times)
    for t, x in ((times[:200], first), (times[201:], second)):
        expected = np.array([torque(inputs(i), row) for i, row in zip(t, x, strict=False)])
        rows = np.isin(times, t[1:])
        assert relative(found["bearing.law.tau"][rows], expected[1:]) <= 1e-9
    assert np.allclose(found["bearing.lossPower"], found["bearing.law.tau"] * found["bearing.w"])


@in_motion(*INERTIAS)
def test_examples_drive_an_inertia_against_the_law(joint, law, coupled, simulated):
    if law.form.stops:
        pytest.skip("rumoca holds its end points to 1e-13, which the corner of a clip misses")
    if law.form.output.has(sgn):
        with pytest.raises(Exception, match=f"Joint{joint}Torque"):
            coupled(f"Examples.Joint{joint}Torque")
        return
    model = coupled(f"Examples.Joint{joint}Torque")
    amplitude, load, inertia = (
        value(model, name) for name in ("sine.amplitude", "load.k", "inertia.J")
    )
    slope, torque = equations(law)

    def moved(t, y):
        q, dq, x = y[0], y[1], y[2:]
        inputs = (dq, q, load)
        driving = amplitude * np.sin(2.0 * np.pi * 0.25 * t)
        return np.array([dq, (driving - torque(inputs, x)) / inertia, *slope(inputs, x)])

    times = np.linspace(0.0, 3.0, 301)
    rows = integrated(moved, np.array([0.0, 0.0, *law.start]), 0.0, 3.0, times[:-1])
    found = simulated(model, times)
    assert relative(found["inertia.w"], rows[:, 1]) <= 1e-8
    assert relative(found["inertia.phi"], rows[:, 0]) <= 1e-8


def value(model, name):
    """Value of a parameter; 0 where an example does not have it."""
    return next((p.value for p in model.parameters if p.name == name), 0.0)


TWO_INERTIAS = """
model Turning
  Modelica.Mechanics.Rotational.Components.Inertia shaft(J=0.5, w(start=2, fixed=true),
    phi(start=0, fixed=true));
  Modelica.Mechanics.Rotational.Components.Inertia housing(J=2, w(start=0, fixed=true),
    phi(start=0, fixed=true));
  Every.Joint{joint}Bearing bearing(useSupport=true);
equation
  connect(shaft.flange_b, bearing.flange_a);
  connect(bearing.support, housing.flange_a);
end Turning;
"""


def test_a_bearing_brakes_its_shaft_and_drags_its_housing(package, rumoca, simulated, library):
    text = package.read_text(encoding="utf-8")
    text += TWO_INERTIAS.format(joint=EVERY.index("dahl") + 1)
    model = rumoca.Session(roots=[library]).loads(text, model="Turning")
    found = simulated(model, np.linspace(0.0, 0.05, 51))
    shaft, housing = found["shaft.w"], found["housing.w"]
    assert np.abs(0.5 * shaft + 2.0 * housing - 1.0).max() <= 1e-9  # momentum
    assert np.allclose(found["bearing.w"], shaft - housing)
    energy = 0.5 * (0.5 * shaft**2 + 2.0 * housing**2)
    assert np.all(np.diff(energy) < 0.0)
    assert shaft[-1] - housing[-1] < 1.9


def test_rumoca_reports_no_problem(package, rumoca):
    assert rumoca.validate(str(package)) == []


@pytest.mark.parametrize(
    "names", [GATE, pytest.param(EVERY, marks=pytest.mark.nightly("laws"))], ids=["some", "all"]
)
def test_a_second_parser_reads_the_package(names, package, compilers):
    tree = compilers("pymoca.parser").parse(
        (LIBRARY / "Modelica.mo").read_text(encoding="utf-8"), bypass_cache=True
    )
    tree.extend(
        compilers("pymoca.parser").parse(package.read_text(encoding="utf-8"), bypass_cache=True)
    )
    reference = compilers("pymoca.ast").ComponentRef.from_string
    for joint in (EVERY.index(name) + 1 for name in names):
        example = (f"Joint{joint}Bearing", f"Examples.Joint{joint}Speed")[joint % 2]
        for name in (f"Joint{joint}", example):
            flat = compilers("pymoca.tree").flatten(tree, reference(f"Every.{name}"))
            assert flat.classes[f"Every.{name}"].equations


def test_the_compilers_reject_errors(package, rumoca, compilers):
    """Guards against compilers that accept everything."""
    broken = package.read_text(encoding="utf-8").replace(
        "    equation\n      tau = ", "    tau = ", 1
    )
    with pytest.raises(rumoca.RumocaError):
        rumoca.Session().loads(broken, model="Every.Joint1")
    parser = compilers("pymoca.parser")
    with pytest.raises(parser.ModelicaSyntaxError):
        parser.parse(broken, bypass_cache=True)


def test_a_law_with_load_uses_the_load_of_its_bearing(laws, coupled):
    for joint, law in enumerate(laws.laws, start=1):
        loaded = "load.y" in coupled(f"Examples.Joint{joint}Speed").outputs.names
        assert loaded == (TAU_LOAD in law.form.inputs)
