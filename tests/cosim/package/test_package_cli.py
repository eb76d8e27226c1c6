"""hesr export of systems: a message for each misuse, through the real command line."""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from containing import Containing, OneSentence
from small_study import Hesr, contents

from cosim.systems.system import write_system
from hesr.extras.ssp.contents import SystemContents
from hesr.extras.ssp.ssp import write_ssp

SSD = "SystemStructure.ssd"
Edit = Callable[..., Path]


@pytest.fixture
def edited(opened: SystemContents, tmp_path: Path) -> Edit:
    """Write the open system as an SSP with texts in a member replaced, or without it."""

    def file(*changes: tuple[str, str], member: str = SSD, without: str = "") -> Path:
        whole, path = write_ssp(opened, tmp_path / "whole.ssp"), tmp_path / "open.ssp"
        with zipfile.ZipFile(whole) as old, zipfile.ZipFile(path, "w") as new:
            for name in old.namelist():
                data = old.read(name)
                if name == member:
                    for before, after in changes:
                        assert before.encode() in data
                        data = data.replace(before.encode(), after.encode())
                if name != without:
                    new.writestr(name, data)
        whole.unlink()
        return path

    return file


@pytest.mark.parametrize(
    ("order", "coupling"),
    [
        ("gauss_seidel", "gauss_seidel, in 'hesr simulate' and simulate.py"),
        ("jacobi", "jacobi, as in other engines."),
    ],
)
def test_an_ssp_is_written(
    opened: SystemContents, tmp_path: Path, hesr: Hesr, order: str, coupling: str
) -> None:
    spec = opened.system.model_copy(update={"order": order})
    system = write_system(spec, tmp_path / "open.toml")
    output = tmp_path / "made" / "open.ssp"
    answer = hesr("export", system, "-o", output, "--ssp", "2.0")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.startswith("SSP, for ")
    assert answer.out == Containing(f"KiB.\nCoupling: {coupling}", f"\nWritten: {output}\n")
    assert [path.name for path in output.parent.iterdir()] == [output.name]
    with zipfile.ZipFile(output) as archive:
        assert b' version="2.0" name="open"' in archive.read(SSD)


CONTAINER = "SSP (.ssp), not as one FMU"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["-o", "open.zip"], "open.zip: the name of a packaged"),
        (["-o", "open.ssp", "--format", "fmu"], CONTAINER),
        (["-o", "open.fmu"], CONTAINER),
        (["-o", "open.fmu", "--ssp", "1.0"], CONTAINER),
        (["-o", "open.ssp", "--format", "c"], "system becomes an SSP (ssp)"),
        (["-o", "open.ssp", "--platform", "win64"], "--platform is for FMUs"),
        (["-o", "open.ssp", "--inertia", "3"], "--inertia is for friction laws, not for a system."),
    ],
)
def test_unsupported_options_are_refused(
    arguments: list[str],
    sentence: str,
    opened: SystemContents,
    tmp_path: Path,
    hesr: Hesr,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    system = write_system(opened.system, tmp_path / "open.toml")
    monkeypatch.chdir(tmp_path)
    answer = hesr("export", system, *arguments)
    assert (answer.code, answer.out, answer.err) == (2, "", OneSentence("hesr: ", sentence))
    assert contents(tmp_path).keys() == {"open.toml"}


TOML = [
    ('fmu = "Friction.fmu"', 'fmu = "Gone.fmu"',
     "component 'friction': there is no FMU {folder}/Gone.fmu."),
    ('fmu = "Friction.fmu"', 'fmu = "open.toml"',
     "component 'friction': {folder}/open.toml: not a readable FMU (File is not a zip file)."),
    ('"friction.q" = ', '"friktion.q" = ',
     "connection 'friktion.q' = 'trajectory.q': there is no component 'friktion'; did you mean "
     "'friction'?"),
    ('"trajectory.q"\n', '"trajectory.p"\n',
     "connection 'friction.q' = 'trajectory.p': {folder}/Trajectory.fmu: there is no variable "
     "'p'."),
    ('"friction.q" = "trajectory.q"', '"friction.q" = "trajectory.dq"',
     "rad, the output in rad/s"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "sentence"), TOML)
def test_an_inconsistent_system_is_refused(
    old: str,
    new: str,
    sentence: str,
    opened: SystemContents,
    tmp_path: Path,
    hesr: Hesr,
) -> None:
    spec = opened.system
    for component, name in zip(spec.components, ("Trajectory", "Friction"), strict=True):
        (tmp_path / f"{name}.fmu").write_bytes(component.fmu.read_bytes())
    fmus = [tmp_path / f"{name}.fmu" for name in ("Trajectory", "Friction")]
    components = tuple(
        c.model_copy(update={"fmu": fmu}) for c, fmu in zip(spec.components, fmus, strict=True)
    )
    path = write_system(spec.model_copy(update={"components": components}), tmp_path / "open.toml")
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    before = contents(tmp_path)
    answer = hesr("export", path, "-o", tmp_path / "x.ssp")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == OneSentence(f"hesr: {path}: ", sentence.format(folder=tmp_path))
    assert contents(tmp_path) == before


def test_a_cyclic_connection_is_refused(closed: SystemContents, tmp_path: Path, hesr: Hesr) -> None:
    """The controller's command, connected to the desired velocity with direct feedthrough to it."""
    spec = closed.system
    connections = dict(spec.connections) | {"controller.dq_d": "controller.dq_cmd"}
    path = write_system(
        spec.model_copy(update={"connections": connections}), tmp_path / "cyclic.toml"
    )
    answer = hesr("export", path, "-o", tmp_path / "cyclic.ssp")
    assert answer.code == 2
    assert answer.err.startswith(
        f"hesr: {path}: algebraic loop through direct feedthrough: controller."
    )
    assert answer.err.count("\n") == 1
    assert "controller.dq_cmd[1] -> controller.dq_d[1]" in answer.err


def test_a_missing_system_is_reported(tmp_path: Path, hesr: Hesr) -> None:
    for name in ("gone.toml", "gone.ssp"):
        answer = hesr("export", tmp_path / name, "-o", tmp_path / "x.ssp")
        assert (answer.code, answer.err) == (2, f"hesr: {tmp_path / name}: no such file.\n")


def test_a_missing_fmu_of_an_ssp_is_reported(edited: Edit, tmp_path: Path, hesr: Hesr) -> None:
    path = edited(without="resources/friction.fmu")
    answer = hesr("export", path, "-o", tmp_path / "x.ssp")
    assert (answer.code, answer.err) == (
        2,
        f"hesr: {path}: component 'friction': resources/friction.fmu is missing.\n",
    )


def test_an_invalid_ssp_is_refused(tmp_path: Path, hesr: Hesr) -> None:
    path = tmp_path / "text.ssp"
    path.write_text("no archive", encoding="utf-8")
    answer = hesr("simulate", path, "-o", tmp_path / "x.csv")
    assert answer.err == f"hesr: {path}: not a readable SSP (File is not a zip file).\n"


SSP: list[tuple[dict[str, Any], str]] = [
    ({"without": SSD}, "SystemStructure.ssd is missing."),
    ({"without": "resources/friction.ssv"},
     "component 'friction': resources/friction.ssv is missing."),
    ({"changes": [("</ssd:System>", "")]},
     "SystemStructure.ssd is not valid XML (mismatched tag: line {line}, column 2)."),
    ({"changes": [("ssd:System ", "ssd:Sytem "), ("</ssd:System>", "</ssd:Sytem>")]},
     "SystemStructure.ssd: 'Sytem' is no part of <SystemStructureDescription>; did you mean "
     "'System'?"),
    ({"changes": [(' stopTime="10.0"', "")]},
     "default experiment has no stopTime"),
    ({"changes": [("stopTime=\"10.0\"", "stopTime=\"late\"")]},
     "SystemStructure.ssd: stopTime is 'late'; it must be a number."),
    ({"changes": [('endConnector="dq[2]"', 'endConnector="dp[2]"')]},
     "connection 'friction.dp[2]' = 'trajectory.dq[2]': {fmu}: there is no variable 'dp[2]'; did "
     "you mean 'dq[2]', "),
    ({"changes": [('startElement="trajectory" startConnector="dq[2]"', 'startConnector="dq[2]"')]},
     "connection of 'dq[2]': the system"),
    ({"changes": [('endConnector="dq[2]" />', 'endConnector="dq[2]">'
                   '<ssc:LinearTransformation factor="2"/></ssd:Connection>')]},
     "connection of 'friction.dq[2]': a conversion cannot"),
    ({"changes": [('endConnector="dq[2]"', 'endConnector="dq[1]"')]},
     "'friction.dq[1]' is connected to 'trajectory.dq[1]' and to 'trajectory.dq[2]'."),
    ({"changes": [('startConnector="q[1]"', 'startConnector="dq[1]"')]},
     "= 'trajectory.dq[1]': rad/s cannot be converted"),
    ({"changes": [(' source="resources/friction.fmu"', "")]},
     "component 'friction': attribute 'source' is missing."),
    ({"member": "resources/friction.ssv", "changes": [('value="1.5"', 'value="much"')]},
     "component 'friction': parameter 'tau_load[1]' is 'much', which is not of type Real."),
    ({"changes": [("<ssd:Elements>", "<ssd:Elements><ssd:SignalDictionaryReference name='bus'/>")]},
     "element 'bus' is a SignalDictionaryReference, which is not supported."),
]  # fmt: skip


@pytest.mark.parametrize(("change", "sentence"), SSP)
def test_an_unreadable_ssp_is_refused(
    change: dict[str, Any], sentence: str, edited: Edit, tmp_path: Path, hesr: Hesr
) -> None:
    others = {key: value for key, value in change.items() if key != "changes"}
    path = edited(*change.get("changes", ()), **others)
    answer = hesr("export", path, "-o", tmp_path / "x.ssp")
    with zipfile.ZipFile(path) as archive:
        lines = archive.read(SSD).count(b"\n") if SSD in archive.namelist() else 0
    head, _, tail = sentence.partition("{fmu}")
    assert answer.code == 2
    assert answer.err == OneSentence(f"hesr: {path}: ", head.format(line=lines), tail)
    assert not (tmp_path / "x.ssp").exists()


def test_further_features_of_the_standard_are_read(
    edited: Edit, tmp_path: Path, hesr: Hesr
) -> None:
    """Values at the system, values inside the description, and a step only for OMSimulator."""
    inline = """<ssd:ParameterBindings>
<ssd:ParameterBinding prefix="friction."><ssd:ParameterValues>
<ssv:ParameterSet version="1.0" name="inside"><ssv:Parameters>
<ssv:Parameter name="tau_load[1]"><ssv:Real value="7.0"/></ssv:Parameter>
</ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding>
</ssd:ParameterBindings><ssd:Elements>"""
    path = edited(("<ssd:Elements>", inline), ("osp:FixedStepAlgorithm", "osp:Other"))
    assert hesr("export", path, "-o", tmp_path / "again.ssp").code == 0
    with zipfile.ZipFile(tmp_path / "again.ssp") as archive:
        values = archive.read("resources/friction.ssv").decode()
    assert values.count('value="7.0"') == 1
    assert values.count('value="1.5"') == 2
