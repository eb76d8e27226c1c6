"""The command `hesr test --kind properties`: its tables, file and errors."""

import json
import re
from pathlib import Path

import pytest
from containing import OneSentence
from small_study import Answer, Hesr, hesr_here
from subjects import bristle, model, slip

import hesr as package
from hesr_model.audit.properties import EXPECTATIONS, read_properties
from hesr_model.errors import ConfigError

KIND = ("--kind", "properties")


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    call = hesr_here(capsys, monkeypatch)

    def narrow(*arguments: object) -> Answer:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("COLUMNS", "80")
            return call(*arguments)

    return narrow


@pytest.fixture(scope="module")
def lugre(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("laws") / "lugre.json"
    model(bristle(), robot="bench").write(file)
    return file


def test_laws_and_fmus_share_the_tables(
    hesr: Hesr, lugre: Path, slip_fmu: Path, tmp_path: Path
) -> None:
    file = tmp_path / "found.json"
    answer = hesr("test", lugre, slip_fmu, *KIND, "--inertia", "0.7", "--verbose", "-o", file)
    assert answer.code == 0, answer.err
    table = answer.out[: answer.out.index("column")].splitlines()
    head = " ".join(line for line in table if line.split()[:1] == ["law"]).replace("law", "")
    assert head.split() == [e.short for e in EXPECTATIONS.values()]
    row = " ".join(line for line in table if line.strip().startswith("LuGre"))
    assert re.fullmatch(r"( ?LuGre|([-\d.e]+[✓✗])| )+", row), row
    assert len(re.findall("[✓✗]", row)) == len(EXPECTATIONS)
    row = " ".join(line for line in table if line.strip().startswith("Slip"))
    assert row.split().count("–") == 5
    assert "…" not in answer.out
    said = " ".join(answer.out.split())
    for word in ("Mayergoyz", "Dupont", "first-order state cannot", "contains no law"):
        assert word in said
    found = read_properties(file)
    assert list(found) == ["lugre", "Slip"]
    assert found["lugre"].joints[0].inertia == 0.7
    assert json.loads(file.read_text(encoding="utf-8"))["expectations"]["hold"]["unit"] == "mrad"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["lugre"],
            "nor one of uf850-table1",
        ),
        (["none.json"], "none.json: no such file."),
        (["none.fmu"], "none.fmu: no such file."),
        (["uf850-table1", "uf850-table1"], "'uf850-table1' is given twice."),
        (
            ["uf850-table1", "--inertia", "3;3"],
            "--inertia is '3;3'; expected numbers such as 3,3,0.6.",
        ),
        (
            ["uf850-table1", "--inertia", "3,3"],
            "uf850-table1: 2 inertias; expected one",
        ),
        (
            ["uf850-table1", "--inertia", "3,-1,0.6"],
            "joint 2 is -1 kg.m2; expected",
        ),
        (
            ["uf850-table1", "--inertia", "inf"],
            "joint 1 is inf kg.m2; expected",
        ),
        (["uf850-table1", "--load", "nan"], "--load is nan; expected a number."),
    ],
)
def test_unsuitable_subjects_are_refused_in_one_sentence(
    hesr: Hesr, arguments: list[str], said: str
) -> None:
    answer = hesr("test", *KIND, *arguments)
    assert (answer.code, answer.err) == (2, OneSentence("hesr: ", said))
    assert not answer.out


def test_an_fmu_without_the_connectors_is_refused(hesr: Hesr, tmp_path: Path) -> None:
    other = slip(tmp_path, output="force[1]")
    file = tmp_path / "found.json"
    answer = hesr("test", other, *KIND, "-o", file)
    assert answer.code == 2
    assert f"{other}: not a friction FMU: 'tau[1]'" in answer.err.strip()
    assert not file.exists()
    assert not list(tmp_path.glob(".*"))


def test_an_unwritable_file_is_reported_before_the_run(hesr: Hesr, tmp_path: Path) -> None:
    answer = hesr("test", "uf850-table1", *KIND, "-o", tmp_path)
    assert answer.code == 2
    assert f"{tmp_path}: cannot be written there" in answer.err


def test_passivity_alone_needs_a_law_inside_the_fmu(slip_fmu: Path) -> None:
    with pytest.raises(ConfigError, match="contains no friction law to audit"):
        package.test(slip_fmu, kind=["passivity"], trust=True)
