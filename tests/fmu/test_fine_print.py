"""modelDescription.xml agrees with the standard and with the binary."""

import ctypes
import zipfile
from xml.etree import ElementTree as ET

import pytest

from fmu_src.friction.friction_fmu import export_bare

OK, DISCARD, ERROR = 0, 2, 3

COMMON = {
    "modelIdentifier": "friction_by_hand",
    "needsExecutionTool": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canNotUseMemoryManagementFunctions": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "true",
}
EXCHANGE = COMMON | {"completedIntegratorStepNotNeeded": "false"}
SLAVE = COMMON | {
    "canHandleVariableCommunicationStepSize": "true",
    "canInterpolateInputs": "true",
    "maxOutputDerivativeOrder": "0",
    "canRunAsynchronuously": "false",
}


@pytest.fixture(scope="module")
def fmu_file(every_law, make_model, tmp_path_factory):
    """An FMU with all laws."""
    return export_bare(make_model(*every_law.values()), tmp_path_factory.mktemp("f") / "F.fmu")


@pytest.fixture(scope="module")
def root(fmu_file):
    with zipfile.ZipFile(fmu_file) as archive:
        return ET.fromstring(archive.read("modelDescription.xml"))


@pytest.fixture(scope="module")
def fmu(fmu_file, load):
    return load(fmu_file)


def scalars(root):
    return root.findall("ModelVariables/ScalarVariable")


def test_parts_occur_once_in_the_order_of_the_schema(root):
    assert [part.tag for part in root] == [
        "ModelExchange", "CoSimulation", "UnitDefinitions", "TypeDefinitions", "LogCategories",
        "DefaultExperiment", "ModelVariables", "ModelStructure",
    ]  # fmt: skip
    structure = [part.tag for part in root.find("ModelStructure")]
    assert structure == ["Outputs", "Derivatives", "InitialUnknowns"]


def test_capability_flags_are_right(root):
    assert root.find("ModelExchange").attrib == EXCHANGE
    assert root.find("CoSimulation").attrib == SLAVE


def test_value_references_number_the_variables(root):
    found = [int(v.get("valueReference")) for v in scalars(root)]
    assert found == list(range(len(found)))


def test_variables_have_valid_attributes(root):
    """Causality, variability and initial form a combination of the standard."""
    kinds = {
        (v.get("causality"), v.get("variability"), v.get("initial"), v[0].get("start") is not None)
        for v in scalars(root)
    }
    assert kinds == {
        ("input", "continuous", None, True),
        ("output", "continuous", "calculated", False),
        ("output", "discrete", "calculated", False),
        ("local", "continuous", "calculated", False),
        ("parameter", "fixed", "exact", True),
        ("parameter", "tunable", "exact", True),
    }


def test_unknowns_are_complete(root):
    variables = scalars(root)
    listed = {
        part.tag: [int(unknown.get("index")) for unknown in part]
        for part in root.find("ModelStructure")
    }
    outputs = [i for i, v in enumerate(variables, 1) if v.get("causality") == "output"]
    derivatives = [i for i, v in enumerate(variables, 1) if v[0].get("derivative")]
    states = [int(variables[i - 1][0].get("derivative")) for i in derivatives]
    assert listed["Outputs"] == outputs
    assert listed["Derivatives"] == derivatives
    # In the order of the variables; states are calculated from the first inputs.
    assert listed["InitialUnknowns"] == sorted({*outputs, *derivatives, *states})
    assert {variables[i - 1].get("initial") for i in states} == {"calculated"}
    for part in root.find("ModelStructure"):
        for unknown in part:
            on = [int(i) for i in unknown.get("dependencies").split()]
            assert on == sorted(set(on))
            kinds = {variables[i - 1].get("causality") for i in on}
            assert kinds <= {"input", "local", "parameter"}
            assert part.tag == "InitialUnknowns" or "parameter" not in kinds


def test_declared_dependencies_match_the_binary(root, fmu):
    """Directional derivatives of undeclared dependencies are zero."""
    variables = [v.get("name") for v in scalars(root)]
    knowns = [
        v.get("name")
        for v in scalars(root)
        if (v.get("initial") == "exact" and v.get("variability") != "fixed")
        or v.get("causality") == "input"
    ]
    c = fmu.ready(kind=0)
    moving = {v: 0.2 for v in knowns if v.startswith("dq[")}
    moving |= {v: 3.0 for v in knowns if v.startswith("tau_load[")}
    fmu.set_all(c, moving)
    assert fmu("NewDiscreteStates", c, ctypes.create_string_buffer(64)) == OK
    states = {
        variables[int(v[0].get("derivative")) - 1] for v in scalars(root) if v[0].get("derivative")
    }
    for unknown in root.find("ModelStructure/InitialUnknowns"):
        name = variables[int(unknown.get("index")) - 1]
        if name.startswith("dtau_ddq") or name in states:  # states are knowns after that
            continue
        on = {variables[int(i) - 1] for i in unknown.get("dependencies").split()}
        others = [v for v in knowns if v not in on]
        ones = (ctypes.c_double * len(others))(*[1.0] * len(others))
        result = (ctypes.c_double * 1)(7.0)
        arguments = (fmu.references([name]), 1, fmu.references(others), len(others), ones, result)
        assert fmu("GetDirectionalDerivative", c, *arguments) == OK
        assert result[0] == 0.0


def test_integration_is_an_integer_parameter(root):
    """An Integer: Maestro 3.1.1 loads no FMU with an Enumeration, libcosim cannot set one."""
    assert "Enumeration" not in {v[0].tag for v in scalars(root)}
    choice, start = (v for v in scalars(root) if v[0].tag == "Integer")
    assert choice.attrib["name"] == "discretisation"
    assert start.attrib["name"] == "start_mode"
    assert choice.get("description").endswith(": 1 = exact, 2 = euler")
    assert (choice.get("causality"), choice.get("variability")) == ("parameter", "fixed")
    limits = {"min": "1", "max": "2"}
    assert choice[0].attrib == {"declaredType": "Discretisation", "start": "1"} | limits
    kind = root.findall("TypeDefinitions/SimpleType")[0]
    assert kind.get("name") == "Discretisation"
    assert "= exact for inputs held over" in kind.get("description")
    assert (kind[0].tag, kind[0].attrib) == ("Integer", limits)


def test_numbers_of_indicators_and_states_are_right(root, fmu):
    for function, n in (
        ("GetEventIndicators", int(root.get("numberOfEventIndicators"))),
        ("GetContinuousStates", len(root.find("ModelStructure/Derivatives"))),
    ):
        assert n > 3
        for size in (n - 1, n, n + 1):
            c = fmu.continuous()
            values = (ctypes.c_double * size)()
            assert fmu(function, c, values, size) == (OK if size == n else ERROR)


def test_nominal_values_are_given(root, fmu):
    variables = scalars(root)
    derivatives = root.find("ModelStructure/Derivatives")
    places = [int(u.get("index")) - 1 for u in derivatives]
    states = [variables[int(variables[i][0].get("derivative")) - 1] for i in places]
    declared = [float(v[0].get("nominal", "1")) for v in states]
    assert fmu.numbers("GetNominalsOfContinuousStates", fmu.ready(kind=0), len(states)) == declared
    # Bristles of LuGre deflect by far less than 1 rad.
    assert 0.0 < min(declared) < 0.02
    assert all(v[0].get("nominal") is None for v in variables if v not in states)


def test_log_categories_are_declared(root, fmu):
    names = [category.get("name") for category in root.find("LogCategories")]
    assert names == ["logEvents", "logStatusDiscard", "logStatusError", "logAll"]
    c = fmu.instantiate()
    array = (ctypes.c_char_p * 4)(*(name.encode() for name in names))
    assert fmu("SetDebugLogging", c, 1, 4, array) == OK


def test_memory_is_not_allocated_by_the_host(fmu_file, load):
    taken = []
    kind = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)
    fmu, allocate = load(fmu_file), kind(lambda n, size: taken.append((n, size)))
    fmu.host.allocateMemory = ctypes.cast(allocate, ctypes.c_void_p)
    fmu.host.freeMemory = ctypes.cast(allocate, ctypes.c_void_p)
    c, state = fmu.ready(), ctypes.c_void_p()
    assert fmu("GetFMUstate", c, ctypes.byref(state)) == OK
    assert fmu("FreeFMUstate", c, ctypes.byref(state)) == OK
    fmu("FreeInstance", c)
    assert taken == []


def test_outputs_have_no_time_derivatives(fmu):
    fmu.messages.clear()
    one = ((ctypes.c_int * 1)(1), (ctypes.c_double * 1)())
    c = fmu.ready()
    assert fmu("GetRealOutputDerivatives", c, fmu.references(["tau[1]"]), 1, *one) == ERROR
    assert len(fmu.messages) == 1


def test_steps_of_any_length_follow_input_derivatives(fmu):
    """A state without relaxation in time, x' = 60 dq - 60 abs(dq) x, depends only on the path."""
    number = next(i for i, v in enumerate(fmu.about.modelVariables) if v.name.startswith("x1["))
    name = fmu.about.modelVariables[number].name
    dq = name.replace("x1", "dq")
    ends = []
    for steps in ((0.01,), (0.002, 0.0005, 0.0075), (0.005, 0.005)):
        c, time = fmu.ready(), 0.0
        fmu.set_all(c, {dq: 0.1})
        for step in steps:
            one = (ctypes.c_int * 1)(1)
            slope = (ctypes.c_double * 1)(2.0)
            assert fmu("SetRealInputDerivatives", c, fmu.references([dq]), 1, one, slope) == OK
            assert fmu.step(c, time, step) == OK
            time += step
        assert fmu.get(c, dq) == [pytest.approx(0.12)]
        ends += fmu.get(c, name)
    assert ends == pytest.approx([ends[0]] * 3, rel=1e-12, abs=0.0)
