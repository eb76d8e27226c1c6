"""Systems inconsistent with their FMUs: a message for each mistake."""

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest
from fakes import description, variable

from cosim.systems.system import SystemSpec
from cosim.systems.wiring import Wiring
from fmu_src.run.variables import Variables
from hesr_model.errors import ConfigError

SI = {"kg": 0, "m": 0, "s": 0, "A": 0, "K": 0, "mol": 0, "cd": 0, "rad": 0, "factor": 1.0,
      "offset": 0.0}  # fmt: skip
UNITS = {
    "N.m": SimpleNamespace(**SI | {"kg": 1, "m": 2, "s": -2}),
    "Nm": SimpleNamespace(**SI | {"kg": 1, "m": 2, "s": -2}),
    "rad": SimpleNamespace(**SI | {"rad": 1}),
    "deg": SimpleNamespace(**SI | {"rad": 1, "factor": 0.017453292519943295}),
}
MODE = SimpleNamespace(
    unit=None,
    items=[SimpleNamespace(name="slow", value="1"), SimpleNamespace(name="fast", value="2")],
)

ARM = description(
    *(variable(f"dq_cmd[{i}]", "input", unit="rad/s") for i in (1, 2)),
    *(variable(f"q[{i}]", "output", unit="rad") for i in (1, 2)),
    *(variable(f"tau[{i}]", "output", unit="Nm") for i in (1, 2)),
    variable("error", "output", type="Integer"),
    units=UNITS,
)
CONTROLLER = description(
    *(variable(f"q[{i}]", "input", unit="rad") for i in (1, 2)),
    variable("tau", "input", unit="N.m"),
    variable("angle", "input", unit="deg"),
    variable("plain", "input"),
    *(variable(f"dq_cmd[{i}]", "output", unit="rad/s") for i in (1, 2)),
    variable("Kp", "parameter", unit="1/s"),
    variable("mode", "parameter", type="Enumeration", declaredType=MODE),
    variable("count", "parameter", type="Integer"),
    variable("on", "parameter", type="Boolean"),
    variable("file", "parameter", type="String"),
    feedthrough={f"dq_cmd[{i}]": [f"q[{i}]"] for i in (1, 2)},
    units=UNITS,
    exchange=True,
)
SILENT = description(
    variable("u", "input"), variable("y", "output"), feedthrough={"y": None}, exchange=True
)

CONNECTIONS = {"arm.dq_cmd": "controller.dq_cmd", "controller.q": "arm.q"}
CASES = {"arm": ARM, "controller": CONTROLLER, "silent": SILENT, "echo": SILENT}


def wire(connections=CONNECTIONS, start=None, names=("arm", "controller"), **more) -> Wiring:
    spec = SystemSpec.model_validate(
        {
            "step": 0.1,
            "stop": 1.0,
            "components": [
                {"name": n, "fmu": f"{n}.fmu", "start": (start or {}).get(n, {})} for n in names
            ],
            "connections": connections,
        }
        | more
    )
    slaves = {n: Variables(Path(f"{n}.fmu"), CASES[n]) for n in names}
    return Wiring(spec, slaves, Path("loop.toml"))


def test_vectors_are_connected_element_by_element():
    wiring = wire()
    assert wiring.sources == {
        (into, f"{what}[{i}]"): (out, f"{what}[{i}]")
        for into, out, what in (("arm", "controller", "dq_cmd"), ("controller", "arm", "q"))
        for i in (1, 2)
    }


def test_values_are_ordered_by_dependency():
    order = wire().order
    for i in (1, 2):
        chain = [("arm", f"q[{i}]"), ("controller", f"q[{i}]"), ("controller", f"dq_cmd[{i}]"),
                 ("arm", f"dq_cmd[{i}]")]  # fmt: skip
        assert [element for element in order if element in chain] == chain


@pytest.mark.parametrize(
    ("connection", "said"),
    [
        (
            {"amr.dq_cmd": "controller.dq_cmd"},
            "connection 'amr.dq_cmd' = 'controller.dq_cmd': there is no component 'amr'; did you "
            "mean 'arm'?",
        ),
        ({"controller.q": "gear.q"}, "there is no component 'gear'; there are arm, controller."),
        (
            {"arm.dq_cdm": "controller.dq_cmd"},
            "arm.fmu: there is no variable 'dq_cdm'; did you mean 'dq_cmd', 'dq_cmd[1]' or "
            "'dq_cmd[2]'?",
        ),
        (
            {"controller.q[3]": "arm.q[1]"},
            "controller.fmu: there is no variable 'q[3]'; did you mean 'q[1]' or 'q[2]'?",
        ),
        ({"controller.tau": "arm.tau"}, "'controller.tau' has 1 element, 'arm.tau' has 2."),
        (
            {"controller.Kp": "arm.q[1]"},
            "causality of 'controller.Kp' is parameter",
        ),
        (
            {"controller.plain": "arm.dq_cmd[1]"},
            "causality of 'arm.dq_cmd[1]' is input",
        ),
        ({"controller.tau": "arm.q[1]"}, "N.m, the output in rad"),
        ({"controller.angle": "arm.q[1]"}, "deg, the output in rad"),
        (
            {"controller.q[2]": "arm.q[2]"},
            "connection 'controller.q[2]' = 'arm.q[2]': 'controller.q[2]' is connected already, to "
            "'arm.q[2]'.",
        ),
    ],
)
def test_impossible_connections_are_refused(connection, said):
    with pytest.raises(ConfigError) as error:
        wire(CONNECTIONS | connection)
    assert str(error.value).startswith("loop.toml: connection '")
    assert said in str(error.value)


def test_spellings_of_a_unit_are_equivalent():
    wire(CONNECTIONS | {"controller.tau": "arm.tau[1]", "controller.plain": "arm.q[1]"})


def test_inputs_without_a_value_are_refused():
    with pytest.raises(ConfigError) as error:
        wire({"arm.dq_cmd": "controller.dq_cmd", "controller.q[1]": "arm.q[1]"})
    assert "loop.toml: input 'controller.q[2]' is not connected" in str(error.value)
    with pytest.raises(ConfigError, match=r"input 'arm.dq_cmd\[1\]' is not connected"):
        wire({"controller.q": "arm.q"})
    wire({"controller.q": "arm.q"}, {"arm": {"dq_cmd": [0.0, 0.1]}})


def test_algebraic_loops_are_refused():
    loop = {"silent.u": "echo.y", "echo.u": "silent.y"}
    with pytest.raises(ConfigError) as error:
        wire(loop, names=("silent", "echo"))
    said = str(error.value)
    assert said.startswith("loop.toml: algebraic loop through direct feedthrough: ")
    assert "('silent' does not say what its outputs depend on: every input counts)" in said
    cycle = said.split("feedthrough: ")[1].split(" (")[0].split(" -> ")
    assert cycle[0] == cycle[-1]
    # Each value feeds the next one.
    arrows = set(pairwise(cycle))
    assert arrows == {
        ("silent.u", "silent.y"), ("silent.y", "echo.u"), ("echo.u", "echo.y"),
        ("echo.y", "silent.u"),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("start", "said"),
    [
        ({"moed": 1.0}, "controller.fmu: there is no variable 'moed'; did you mean 'mode'?"),
        ({"q": [1.0, 2.0, 3.0]}, "controller.fmu: 'q' has 2 elements; 3 values are given."),
        ({"Kp": [1.0, 2.0]}, "controller.fmu: 'Kp' has 1 element; 2 values are given."),
        ({"mode": "quick"}, "'mode' cannot be 'quick'; it must be one of slow, fast."),
        ({"Kp": "slow"}, "'Kp' cannot be 'slow'; it has no choices."),
        ({"count": 1.5}, "'count' is of type Integer; it cannot be 1.5; it must be an integer"),
        ({"Kp": True}, "'Kp' is of type Real; it cannot be True."),
        ({"on": 2}, "'on' is of type Boolean; it cannot be 2; it must be true or false."),
        ({"file": 2}, "'file' is of type String; it cannot be 2."),
    ],
)
def test_invalid_start_values_are_refused(start, said):
    with pytest.raises(ConfigError) as error:
        wire(start={"controller": start})
    assert str(error.value).startswith("loop.toml: start values of 'controller': ")
    assert said in str(error.value)
    with pytest.raises(ConfigError, match="start values of 'controller': "):
        wire().merge_start_values({"controller": start})


def test_start_values_of_a_run_override_those_of_the_system():
    wiring = wire(
        start={"controller": {"q": 3, "Kp": 1.0, "mode": "fast", "on": True, "file": "x"}}
    )
    own = {"q[1]": 3, "q[2]": 3, "Kp": 1.0, "mode": 2, "on": True, "file": "x"}
    assert wiring.start == {"arm": {}, "controller": own}
    assert wiring.merge_start_values({"controller": {"q": [4.0, 5.0]}}) == {
        "arm": {},
        "controller": own | {"q[1]": 4.0, "q[2]": 5.0},
    }
    with pytest.raises(ConfigError, match=r"loop.toml: start values: there is no component 'arn'"):
        wiring.merge_start_values({"arn": {}})


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"observe": ["arm.Q"]}, "observed 'arm.Q': arm.fmu: there is no variable 'Q'"),
        ({"limits": {"am.q": [0, 1]}}, "limits of 'am.q': there is no component 'am'; did you"),
        (
            {"limits": {"arm.q": [[0, 1], [0, 1], [0, 1]]}},
            "limits of 'arm.q': 3 pairs for 2 elements.",
        ),
    ],
)
def test_unknown_signals_are_refused(keys, said):
    with pytest.raises(ConfigError) as error:
        wire(**keys)
    assert str(error.value).startswith(f"loop.toml: {said}")


def test_limits_apply_to_all_elements_or_to_each():
    one, each = (wire(limits={"arm.q": b}).limited for b in ([0, 1], [[0, 1], [2, 3]]))
    assert one == [(("arm", "q[1]"), (0, 1)), (("arm", "q[2]"), (0, 1))]
    assert each == [(("arm", "q[1]"), (0, 1)), (("arm", "q[2]"), (2, 3))]
