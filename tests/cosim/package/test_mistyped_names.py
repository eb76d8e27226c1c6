"""One name mistyped or one key moved: the file is refused, and both names are in the sentence."""

import json
import random
import zipfile
from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from containing import OneSentence
from small_study import Hesr, uf850

from hesr.extras.ssp.vocabulary import IRRELEVANT, USED
from hesr_model.support.ledger import get_local_name
from hesr_model.support.text import to_toml

CASES = 14  # per kind of file
NAMESPACES = "".join(
    f' xmlns:{prefix}="http://ssp-standard.org/SSP1/SystemStructure{name}"'
    for prefix, name in (
        ("ssc", "Common"),
        ("ssd", "Description"),
        ("ssv", "ParameterValues"),
        ("ssm", "ParameterMapping"),
    )
)
SSD = f"""<ssd:SystemStructureDescription version="1.0" name="made"{NAMESPACES}>
<ssd:System name="root"><ssd:ParameterBindings>
<ssd:ParameterBinding source="outer.ssv" prefix="p.">
<ssd:ParameterMapping source="map.ssm"/></ssd:ParameterBinding></ssd:ParameterBindings>
<ssd:Elements><ssd:Component name="first" source="Lag.fmu"><ssd:Connectors>
<ssd:Connector name="u" kind="input"><ssc:Real unit="1"/></ssd:Connector>
<ssd:Connector name="y" kind="output"><ssc:Real unit="1"/></ssd:Connector></ssd:Connectors>
<ssd:ParameterBindings><ssd:ParameterBinding source="own.ssv"/></ssd:ParameterBindings>
</ssd:Component><ssd:Component name="second" source="Lag.fmu"><ssd:Connectors>
<ssd:Connector name="u" kind="input"><ssc:Real unit="1"/></ssd:Connector></ssd:Connectors>
</ssd:Component></ssd:Elements><ssd:Connections>
<ssd:Connection startElement="first" startConnector="y" endElement="second" endConnector="u"
 suppressUnitConversion="true"><ssc:LinearTransformation factor="2" offset="1"/></ssd:Connection>
</ssd:Connections></ssd:System><ssd:Units><ssc:Unit name="1"><ssc:BaseUnit/></ssc:Unit></ssd:Units>
<ssd:DefaultExperiment startTime="0" stopTime="1"/></ssd:SystemStructureDescription>"""
SSV = f"""<ssv:ParameterSet version="1.0" name="own"{NAMESPACES}><ssv:Parameters>
<ssv:Parameter name="x_start"><ssv:Real value="0.5" unit="none"/></ssv:Parameter>
<ssv:Parameter name="refused"><ssv:Real value="1e8"/></ssv:Parameter></ssv:Parameters>
<ssv:Units><ssc:Unit name="none"><ssc:BaseUnit factor="1"/></ssc:Unit></ssv:Units>
</ssv:ParameterSet>"""
OUTER = SSV.replace("x_start", "level").replace("refused", "lateness")
SSM = f"""<ssm:ParameterMapping version="1.0"{NAMESPACES}>
<ssm:MappingEntry source="p.level" target="second.x_start" suppressUnitConversion="true">
<ssc:LinearTransformation factor="0.5" offset="0.25"/></ssm:MappingEntry>
<ssm:MappingEntry source="p.lateness" target="second.refused"/></ssm:ParameterMapping>"""
FILES = {"SystemStructure.ssd": SSD, "own.ssv": SSV, "outer.ssv": OUTER, "map.ssm": SSM}

STUDY = {
    "name": "s",
    "robot": str(uf850("robot.toml")),
    "seed": 3,
    "laws": ["stribeck", "parfam_h"],
    "physical": True,
    "folds": 3,
    "options": {"parfam_h": {"cells": 2, "starts": 4, "candidates": 2}},
    "variants": {"few": {"law": "parfam_h", "options": {"functions": ["tanh"]}}},
    "bands": [{"test": "unseen", "name": "late", "start": 1.0}],
    "logs": {
        "identification": ["excitation"],
        "reversed": ["back"],
        "friction": ["sweep"],
        "test": {"unseen": ["trial"]},
        "parts": {"excitation": {"log": "a.csv", "stop": 16.5}},
    },
}
ROBOT = {
    "name": "r",
    "model": "arm.urdf",
    "joints": ["a", "b"],
    "locked": {"c": 0.5},
    "gravity": [0.0, 0.0, -9.81],
    "mount": [0.0, 0.1, 0.0],
    "known": [],
    "rotor_inertia": True,
    "gear_ratio": [100.0, 50.0],
    "log": {
        "sample_rate": 100.0,
        "missing": "drop",
        "duplicates": "first",
        "filter_cutoff": 10.0,
        "torque_per_ampere": [1.0, 2.0],
        "columns": {"t": "time", "current": "amps{}"},
        "units": {"temperature": "K"},
        "bag": {"topic": "/states", "effort": "current"},
    },
    "sources": {"torque_per_ampere": "measured"},
    "servo": {"kp": 10.0},
}
FREE = {"locked", "options", "variants", "logs.test", "logs.parts", "provenance"}
"""Tables whose keys are free names."""
Mutation = tuple[str, str, Any]


def mistype(draw: random.Random, name: str) -> str:
    """Return the name with two letters exchanged, or one left out or written twice."""
    k = draw.randrange(len(name))
    letters = [name[: k + 1] + name[k:]]
    if len(name) > 3:
        letters += [name[:k] + name[k + 1 :], name[:k] + name[k : k + 2][::-1] + name[k + 2 :]]
    return next(word for word in draw.sample(letters, len(letters)) if word != name)


def tables_of(data: Any, place: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield place and content of each table whose keys are not free names."""
    if isinstance(data, dict):
        if place not in FREE:
            yield place, data
        for key, value in data.items():
            if (place, key) != ("", "provenance"):
                yield from tables_of(value, ".".join(filter(None, (place, key))))
    elif isinstance(data, list):
        for value in data:
            yield from tables_of(value, place)


def mutate_data(draw: random.Random, data: dict[str, Any], is_moved: bool) -> Mutation:
    """Return old and new name of a key, and the data with it."""
    data = deepcopy(data)
    tables = list(tables_of(data))
    names = [name for _, table in tables for name in table]
    while True:
        place, table = draw.choice(tables)
        old = draw.choice(list(table))
        if old == "format":
            continue
        if not is_moved:
            new = mistype(draw, old)
            table[new] = table.pop(old)
            return old, new, data
        inside = {name for _, inner in tables_of(table[old]) for name in inner}
        targets = [other for _, other in tables if other is not table and not inside & other.keys()]
        # Which law has an option is not known before the law.
        is_option = place == "options.parfam_h" or place.endswith(".options")
        if names.count(old) == 1 and targets and not is_option:
            draw.choice(targets)[old] = table.pop(old)
            return old, old, data


def mutate_xml(draw: random.Random, text: str, is_moved: bool) -> Mutation:
    """Return old and new name of an attribute or an element, and the file with it."""
    root = ElementTree.fromstring(text)
    parents = {child: parent for parent in root.iter() for child in parent}
    items = [
        (element, name)
        for element in parents
        for name in (*element.attrib, "")
        if not name or name in USED[get_local_name(element)]
    ]
    while True:
        element, old = draw.choice(items)
        kind = get_local_name(element)
        if is_moved and old and old not in USED[get_local_name(parents[element])]:
            parents[element].set(old, element.attrib.pop(old))
            return old, old, ElementTree.tostring(root, encoding="unicode")
        if is_moved:
            continue
        if old:
            new = mistype(draw, old)
            element.set(new, element.attrib.pop(old))
        else:
            old, new = kind, mistype(draw, kind)
            element.tag = element.tag.replace(kind, new)
        return old, new, ElementTree.tostring(root, encoding="unicode")


def mutate_parameter(draw: random.Random, text: str) -> Mutation:
    """Return old and new name of a parameter or its mapping, and the file with it."""
    root = ElementTree.fromstring(text)
    keys = {"Parameter": ["name"], "MappingEntry": ["source", "target"]}
    element = draw.choice([e for e in root.iter() if get_local_name(e) in keys])
    key = draw.choice(keys[get_local_name(element)])
    old = element.get(key, "")
    prefix, _, name = old.rpartition(".")
    new = ".".join(filter(None, (prefix, mistype(draw, name))))
    element.set(key, new)
    return old, new, ElementTree.tostring(root, encoding="unicode")


@pytest.fixture
def write_ssp(tmp_path: Path, lag_fmu: Path) -> Callable[..., Path]:
    def write(name: str = "", text: str = "") -> Path:
        path = tmp_path / "made.ssp"
        with zipfile.ZipFile(path, "w") as archive:
            archive.write(lag_fmu, "Lag.fmu")
            for member, content in (FILES | ({name: text} if name else {})).items():
                archive.writestr(member, content)
        return path

    return write


def test_the_files_without_a_mistake_are_read(
    hesr: Hesr, write_ssp: Callable[..., Path], tmp_path: Path
) -> None:
    answer = hesr("simulate", write_ssp(), "-o", tmp_path / "x.csv")
    assert (answer.code, answer.err) == (0, "")


def change_irrelevant(text: str) -> str:
    """Return a file with all that is known to be irrelevant, at odd values."""
    root = ElementTree.fromstring(text)
    for element in list(root.iter()):
        kind = get_local_name(element)
        for name in sorted(IRRELEVANT.get(kind, {}).keys() - set(USED[kind])):
            if name[0].islower():
                element.set(name, "odd")
            else:
                namespace = element.tag.removesuffix(kind)
                ElementTree.SubElement(element, f"{namespace}{name}", {"odd": "value"})
    return ElementTree.tostring(root, encoding="unicode")


def test_irrelevant_parts_change_no_output(
    hesr: Hesr, write_ssp: Callable[..., Path], tmp_path: Path
) -> None:
    hesr("simulate", write_ssp(), "-o", tmp_path / "plain.csv")
    for name, text in FILES.items():
        answer = hesr(
            "simulate", write_ssp(name, change_irrelevant(text)), "-o", tmp_path / "x.csv"
        )
        assert (answer.code, answer.err) == (0, ""), answer.err
        assert (tmp_path / "x.csv").read_bytes() == (tmp_path / "plain.csv").read_bytes()


@pytest.mark.parametrize("case", range(CASES))
@pytest.mark.parametrize("name", FILES)
def test_names_in_ssps(
    name: str, case: int, hesr: Hesr, write_ssp: Callable[..., Path], tmp_path: Path
) -> None:
    draw = random.Random(f"{name} {case}")
    is_moved = case % 3 == 0
    if name != "SystemStructure.ssd" and case % 3 == 1:
        old, new, text = mutate_parameter(draw, FILES[name])
    else:
        old, new, text = mutate_xml(draw, FILES[name], is_moved)
    answer = hesr("simulate", write_ssp(name, text), "-o", tmp_path / "x.csv")
    assert answer.code == 2
    assert answer.err == OneSentence(new)
    assert old in answer.err.replace(f"{new}'", "", new != old)


@pytest.mark.parametrize("case", range(CASES))
@pytest.mark.parametrize("kind", ["study", "robot", "law"])
def test_keys_of_files(kind: str, case: int, hesr: Hesr, tmp_path: Path) -> None:
    law = json.loads(Path(__file__).parents[2].joinpath("version_1", "law.json").read_text("utf-8"))
    data = {"study": STUDY, "robot": ROBOT, "law": law}[kind]
    old, new, changed = mutate_data(random.Random(f"{kind} {case}"), data, case % 3 == 0)
    path = tmp_path / ("law.json" if kind == "law" else f"{kind}.toml")
    lines = [f"{key} = {to_toml(value)}" for key, value in changed.items()]
    path.write_text(json.dumps(changed) if kind == "law" else "\n".join(lines), encoding="utf-8")
    commands = {
        "study": ("run", path),
        "robot": ("identify", tmp_path / "a.csv", "--robot", path, "-o", tmp_path / "b.json"),
        "law": ("export", path, "-o", tmp_path / "x.fmu"),
    }
    answer = hesr(*commands[kind])
    assert answer.code == 2
    assert answer.err == OneSentence(new)
    assert old in answer.err.replace(f"{new}'", "", new != old)
