"""Parameters of several items take one item, or several in any iterable, with the same result."""

import inspect
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hesr
from cosim.workflow import arguments
from cosim.workflow.export import read_option
from cosim.workflow.export_formats import KINDS, load_exporters
from fmu_src.exporter import ExportOption, ExportRequest
from hesr_model.errors import ArgumentError
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log

READERS = {
    "Names": "list_names",
    "Paths": "list_paths",
    "Logs": "list_logs",
    "Laws": "list_laws",
    "NamedLaws": "list_laws",
    "PerJoint": "list_numbers",
    "Iterable[float]": "list_numbers",
}
"""Readers of parameters, by the annotation of several items."""


class FilePath(os.PathLike[str]):
    """A path object of another class than Path."""

    def __fspath__(self) -> str:
        return "some.json"


LOG = Log(
    name="run", t=np.arange(2.0), q=np.zeros((2, 1)), dq=np.zeros((2, 1)), tau=np.zeros((2, 1))
)

Function = Callable[..., Any]
PATHS: list[tuple[Any, Any]] = [
    ("some.json", Path("some.json")),
    (Path("some.json"), Path("some.json")),
    (FilePath(), Path("some.json")),
]
ITEMS: dict[str, list[tuple[Any, Any]]] = {
    "list_names": [("linux64", "linux64")],
    "list_paths": PATHS,
    "list_logs": [*PATHS, (LOG, LOG)],
    "list_laws": [*PATHS, ("law", None)],  # None: the model of Table I
    "list_numbers": [(0.5, 0.5), (2, 2.0), (np.float64(0.5), 0.5)],
}
"""Items and what a function receives for them, by reader."""

FORMS: dict[str, Callable[[Any], Any]] = {
    "one item": lambda item: item,
    "tuple": lambda item: (item, item),
    "list": lambda item: [item, item],
    "generator": lambda item: (each for each in (item, item)),
    "keys": lambda item: {item: 0}.keys(),
}

WRONG = {
    "list_names": [3, {"a": 1}, None, [3], [["a"]], [b"a"]],
    "list_paths": [3, {"a": 1}, None, [3], [["a"]], b"a"],
    "list_logs": [3, {"a": 1}, None, [3], [["a"]], np.zeros((2, 2))],
    "list_laws": [3, None, [3], [["a"]], [LOG]],
    "list_numbers": ["3,3,0.6", {"a": 1}, ["a"], [[1.0]], [None]],
}


def public_functions() -> dict[str, Function]:
    """Functions of `import hesr`, and the exporting method of the regressor."""
    functions: dict[str, Function] = {"to_fmu": hesr.FrictionRegressor().to_fmu}
    for name in dir(hesr):
        value = getattr(hesr, name)
        if inspect.isfunction(value):
            functions[name] = value
    return functions


def annotation_of(parameter: inspect.Parameter) -> str:
    kind = parameter.annotation
    if not isinstance(kind, str):
        kind = "Names" if kind == arguments.Names | None else str(kind)
    return str(kind).removesuffix(" | None")


def parameters_of_several() -> Iterator[tuple[str, str, str]]:
    """Yield function, parameter and reader."""
    for name, function in public_functions().items():
        for parameter in inspect.signature(function).parameters.values():
            reader = READERS.get(annotation_of(parameter))
            if reader:
                yield name, parameter.name, reader


PARAMETERS = list(parameters_of_several())


class ReceivedError(Exception):
    """Ends a call with the list that the function received for a parameter."""

    def __init__(self, items: list[Any]) -> None:
        super().__init__(str(items))
        self.items = items


@pytest.fixture
def receive(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str, Any], list[Any]]:
    """Call a function with one argument, and return the list that it received."""

    def call(name: str, parameter: str, value: Any) -> list[Any]:
        function = public_functions()[name]
        module = sys.modules[function.__module__]
        for reader in set(READERS.values()):
            real = getattr(arguments, reader)

            def read(name: str, value: Any, real: Function = real, **options: Any) -> list[Any]:
                items: list[Any] = real(name, value, **options)
                if name == parameter:
                    raise ReceivedError(items)
                return items

            monkeypatch.setattr(arguments, reader, read)
            if reader in vars(module):
                monkeypatch.setattr(module, reader, read)
        required = {
            parameter.name: "uf850-table1"
            for parameter in inspect.signature(function).parameters.values()
            if parameter.default is parameter.empty and parameter.kind != parameter.VAR_KEYWORD
        }
        with pytest.raises(ReceivedError) as received:
            function(**required | {parameter: value})
        monkeypatch.undo()
        return received.value.items

    return call


def test_no_public_function_takes_a_plain_sequence() -> None:
    """A plain sequence of texts accepts one text as a sequence of letters."""
    for name, function in public_functions().items():
        for parameter in inspect.signature(function).parameters.values():
            kind = annotation_of(parameter).lower()
            assert not kind.startswith(("sequence", "list", "tuple", "set")), (name, parameter)
    names = {name for name, *_ in PARAMETERS}
    assert names == set(public_functions()) - {
        *("excite", "laws", "register", "previous", "block", "write_fmu")
    }


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("name", "parameter", "reader"), PARAMETERS)
def test_one_item_and_every_iterable_are_received_as_a_list(
    receive: Callable[[str, str, Any], list[Any]],
    table1: FrictionModel,
    name: str,
    parameter: str,
    reader: str,
    form: str,
) -> None:
    for item, expected in ITEMS[reader]:
        if expected is None:
            item, expected = table1, table1
        if form == "keys" and item in (LOG, table1):  # not hashable
            continue
        count = 1 if form in ("one item", "keys") else 2
        received = receive(name, parameter, FORMS[form](item))
        assert received == [expected] * count
        assert [type(each) for each in received] == [type(expected)] * count


@pytest.mark.parametrize(("name", "parameter", "reader"), PARAMETERS)
def test_an_argument_of_another_type_is_refused_by_name(
    name: str, parameter: str, reader: str
) -> None:
    function = public_functions()[name]
    required = {
        parameter.name: "uf850-table1"
        for parameter in inspect.signature(function).parameters.values()
        if parameter.default is parameter.empty and parameter.kind != parameter.VAR_KEYWORD
    }
    optional = inspect.signature(function).parameters.get(parameter)
    for value in WRONG[reader]:
        if value is None and (optional is None or optional.default is None):
            continue
        with pytest.raises(ArgumentError) as caught:
            function(**required | {parameter: value})
        sentence = str(caught.value)
        assert sentence.startswith(f"'{parameter}' ")
        assert sentence.count(".") == 1
        assert sentence.endswith(".")


def options_of_several() -> dict[str, ExportOption]:
    """Options of export formats with several items, by name."""
    return {
        option.name: option
        for kind in KINDS
        for exporter in load_exporters(kind).values()
        for option in exporter.options
        if option.per_joint or option.repeatable
    }


def test_options_of_exporters_take_one_item_and_every_iterable(
    table1: FrictionModel, tmp_path: Path
) -> None:
    request = ExportRequest(
        source=table1, output=tmp_path, options={}, platforms=(), progress=lambda *_: None
    )
    options = options_of_several()
    assert {"inertia", "kv", "torque_constants", "calibration"} <= set(options)
    for name, option in options.items():
        reader = "list_numbers" if option.per_joint else f"list_{option.type}s"
        for item, expected in ITEMS[reader]:
            items = [item] * len(table1.joints)
            for value in (items, tuple(items), iter(items), (each for each in items)):
                assert list(read_option(option, value, request)) == [expected] * len(items)
            count = len(items) if option.per_joint else 1
            assert list(read_option(option, item, request)) == [expected] * count
        for wrong in WRONG[reader]:
            if wrong is not None:
                with pytest.raises(ArgumentError, match=rf"^'{name}' "):
                    read_option(option, wrong, request)


def test_no_items_where_one_is_needed_are_refused() -> None:
    calls: dict[str, Function] = {
        "fmus": lambda: hesr.check([]),
        "results": lambda: hesr.report([]),
        "laws": lambda: hesr.test([]),
        "logs": lambda: hesr.identify([], robot="robot.toml"),
    }
    for parameter, call in calls.items():
        with pytest.raises(ArgumentError, match=f"^'{parameter}' is empty; give at least one"):
            call()
    with pytest.raises(ArgumentError, match=r"^'logs' is empty"):
        hesr.monitor([], law="law.json")


@pytest.mark.parametrize("value", [3, {"a": 1}, ["c"]])
def test_other_values_than_text_are_refused_by_name(tmp_path: Path, value: Any) -> None:
    calls: dict[str, list[Function]] = {
        "format": [
            lambda: hesr.export("uf850-table1", tmp_path / "a", format=value),
            lambda: hesr.excite("robot.toml", format=value),
        ],
        "scheme": [lambda: hesr.report(tmp_path, scheme=value)],
        "cluster": [lambda: hesr.simulate("a.toml", cluster=value)],
    }
    for name, functions in calls.items():
        for function in functions:
            with pytest.raises(ArgumentError, match=rf"^'{name}' is given as \w+; expected text"):
                function()


def test_other_values_than_numbers_are_refused_by_name() -> None:
    with pytest.raises(ArgumentError, match=r"^'load' is given as str; expected a number"):
        hesr.test("uf850-table1", load="3")  # type: ignore[arg-type]  # the mistake
    with pytest.raises(ArgumentError, match=r"^'seeds' is given as list; expected a number"):
        hesr.run(seeds=[3])  # type: ignore[call-overload]  # the mistake


def test_texts_where_a_mapping_is_needed_are_refused() -> None:
    with pytest.raises(ArgumentError, match=r"^'options' is given as str; expected a mapping"):
        hesr.fit("a.csv", law="lugre", options="ripple=false")  # type: ignore[arg-type]  # mistake
    with pytest.raises(ArgumentError, match=r"^'log' is given as list; expected a mapping"):
        hesr.new("folder", bench="rotary", log=["sort=true"])  # type: ignore[arg-type]  # mistake


def test_names_of_joints_are_separated_by_commas() -> None:
    read = arguments.list_names
    assert read("joints", "a, b,,c", commas=True) == ["a", "b", "c"]
    assert read("joints", ["a,b", "c"], commas=True) == ["a", "b", "c"]
    assert read("accept", "a, b") == ["a, b"]


def test_a_platform_as_text_is_that_platform(tmp_path: Path) -> None:
    paths = [
        hesr.export("uf850-table1", tmp_path / f"{number}.fmu", platform=platform)
        for number, platform in enumerate(["linux64", ("linux64",), iter(["linux64"])])
    ]
    first, *others = [path.read_bytes() for path in paths]
    assert others == [first, first]
    with pytest.raises(hesr.HesrError, match="platform 'linux' is unknown"):
        hesr.export("uf850-table1", tmp_path / "a.fmu", platform="linux")


def test_a_kind_as_text_is_that_kind() -> None:
    for kind in ("passivity", {"passivity"}, (kind for kind in ["passivity"])):
        report = hesr.test("uf850-table1", kind=kind)
        assert list(report.audits) == ["uf850-table1"]
        assert not report.passed


def test_inertias_of_a_drive_are_numbers_in_any_iterable(tmp_path: Path) -> None:
    forms: list[Any] = [2, 2.0, [2.0] * 3, np.full(3, 2.0), (2.0 for _ in range(3))]
    codes = set()
    for number, inertia in enumerate(forms):
        fmu = hesr.export(
            "uf850-table1",
            tmp_path / f"{number}.fmu",
            format="drive",
            platform="linux64",
            inertia=inertia,
        )
        codes.add(fmu.read_bytes())
    assert len(codes) == 1
