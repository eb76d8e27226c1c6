"""FMUs of another exporter: our report includes that of FMPy and adds findings."""

import re
from pathlib import Path

import pytest
from containing import Containing
from fmpy import read_model_description
from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable, Unknown
from fmpy.validation import validate_fmu
from fmu_files import RULES, changed, texts
from pythonfmu.builder import FmuBuilder

from fmu_src.check.run import check

pytestmark = pytest.mark.ci

SLAVE = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real


class Decay(Fmi2Slave):
    def __init__(self, **more):
        super().__init__(**more)
        self.u, self.k, self.x, self.n = 0.0, 2.0, 1.0, 0
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(
            Real("k", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable)
        )
        self.register_variable(Real("x", causality=Fmi2Causality.output))
        self.register_variable(Integer("n", causality=Fmi2Causality.output))

    def do_step(self, time, step):
        self.x -= step * self.k * self.x
        return True
"""


@pytest.fixture(scope="module")
def decay(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pythonfmu")
    (folder / "decay.py").write_text(SLAVE, encoding="utf-8")
    FmuBuilder.build_FMU(folder / "decay.py", dest=folder)
    return folder / "Decay.fmu"


def assert_covered(path: Path) -> None:
    """Every message of FMPy is in our report, in its words or in our words for the schema."""
    ours = texts(check(path))
    theirs = validate_fmu(str(path))
    assert theirs
    for text in theirs:
        first = re.sub(r"^ERROR \(line \d+, column \d+\): ", "", text.splitlines()[0])
        assert any(first.rstrip(".") in own for own in ours), text


def test_findings_of_fmpy_are_reported(decay):
    assert_covered(decay)


@pytest.mark.parametrize(
    "change",
    [
        lambda xml: xml.variable("dq[1]").set("causality", "nonsense"),
        lambda xml: xml.typed("tau[1]").set("unit", "furlong"),
        lambda xml: xml.typed("discretisation").set("declaredType", "T"),
        lambda xml: xml.drop(xml.find("ModelStructure/Outputs")),
        lambda xml: xml.variable("h[1]").set("name", "h 1"),
        lambda xml: xml.typed("dq[1]").attrib.pop("start"),
        lambda xml: xml.typed("der(h[1])").set("derivative", "99999"),
        lambda xml: xml.typed("dq[1]").set("displayUnit", "rpm"),
        lambda xml: xml.find("ModelStructure/Outputs/Unknown").set("index", "99999"),
    ],
)
def test_findings_of_fmpy_for_a_broken_fmu_are_reported(change, source_fmu, tmp_path):
    assert_covered(changed(source_fmu, tmp_path / "F.fmu", change))


def test_further_findings_are_reported(decay):
    found = check(decay)
    rules = texts(found, RULES)
    assert Containing("CoSimulation has needsExecutionTool='true'") in rules
    assert Containing("dependencies for 'x', 'n'") in rules
    (initial,) = (t for t in texts(found, "fmpy") if "InitialUnknowns" in t)
    assert initial.endswith("It lacks 'n', 'x'.")
    needs = "needs a Python interpreter"
    for library in ("linux64/Decay.so", "win64/Decay.dll"):
        assert Containing(f"binaries/{library}: ", needs) in texts(found, "binary")
    assert any(t.startswith('The variable "n"') for t in texts(found, "fmpy"))
    assert found.verdict == "2 errors, 2 warnings, 4 advice."


@pytest.fixture
def container(table1_fmu, tmp_path):
    """An FMU around that of Table I, built by FMPy."""
    cli = pytest.importorskip("fmpy.container_fmu.cli", reason="this FMPy builds no containers")
    inner = read_model_description(str(table1_fmu))
    config = pytest.importorskip("fmpy.container_fmu.config")
    part = config.Component(name="a", filename=table1_fmu, modelDescription=inner)
    dq = ModelVariable("dq", 0, "Real", causality="input", variability="continuous", start="0")
    tau = ModelVariable(
        "tau", 1, "Real", causality="output", variability="continuous", initial="calculated"
    )
    about = ModelDescription(
        fmiVersion="2.0",
        modelName="Container",
        variableNamingConvention="structured",
        modelVariables=[dq, tau],
        coSimulation=CoSimulation(modelIdentifier="container_fmu"),
    )
    of_tau = Unknown(variable=tau)
    about.guid, about.outputs, about.initialUnknowns = "{1}", [of_tau], [of_tau]
    inside = {v.name: v for v in inner.modelVariables}
    mapping = {dq: [(part, inside["dq[1]"])], tau: [(part, inside["tau[1]"])]}
    (tmp_path / "work").mkdir()
    cli.create_container_fmu(
        config.Configuration(False, about, [part], [], mapping),
        tmp_path / "work",
        tmp_path / "C.fmu",
    )
    return tmp_path / "C.fmu"


def test_a_container_of_fmpy_is_checked(container):
    found = check(container)
    loops = "for 'tau', so importers assume"
    assert texts(found, RULES) == [
        Containing(f"ModelStructure/{name}", loops) for name in ("Outputs", "InitialUnknowns")
    ]
    assert not texts(found, "archive") + texts(found, "fmpy")
    # Its library also serves FMI 3, whose function names are allowed.
    assert not any("fmi3" in text for text in texts(found, "binary"))
