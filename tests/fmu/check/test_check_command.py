"""`hesr check` through the real command line: what is printed, written and returned."""

import json
import subprocess
import sys
from dataclasses import dataclass

import pytest
from fmu_files import changed

from fmu_src import export_fmu


@dataclass
class Answer:
    code: int
    out: list[str]
    err: str


def hesr(*arguments):
    result = subprocess.run(
        [sys.executable, "-c", "from hesr.cli import main; main()", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )
    return Answer(result.returncode, result.stdout.splitlines(), result.stderr)


@pytest.fixture
def bad(source_fmu, tmp_path):
    return changed(
        source_fmu, tmp_path / "Bad.fmu", lambda xml: xml.root.set("description", "/home/anna/x/y")
    )


NO_VDMCHECK = "not run: VDMCheck2: there is no vdmcheck2.jar in .tools/vdmcheck2."
PROBLEM = (
    "modelDescription.xml: it holds '/home/anna/x', a path of the machine on which the FMU was "
    "built."
)


def test_nothing_is_wrong(table1_fmu):
    found = hesr("check", table1_fmu)
    assert found == Answer(
        0, [f"{table1_fmu}: {NO_VDMCHECK}", f"{table1_fmu}: no problem found."], ""
    )


def test_something_is_wrong(source_fmu, bad, tmp_path):
    found = hesr("check", source_fmu, bad, "--json", tmp_path / "deep" / "o.json")
    assert found.code == 1
    assert found.out == [
        f"{source_fmu}: {NO_VDMCHECK}",
        f"{source_fmu}: no problem found.",
        f"{bad}: [paths] {PROBLEM}",
        f"{bad}: {NO_VDMCHECK}",
        f"{bad}: 1 problem found.",
    ]
    written = json.loads((tmp_path / "deep" / "o.json").read_text(encoding="utf-8"))
    skipped = [NO_VDMCHECK.removeprefix("not run: ")]
    assert written == [
        {"fmu": str(source_fmu), "problems": [], "skipped": skipped},
        {
            "fmu": str(bad),
            "problems": [{"check": "paths", "text": PROBLEM}],
            "skipped": skipped,
        },
    ]


def test_a_file_that_is_no_fmu_is_a_problem_and_no_error(tmp_path):
    path = tmp_path / "F.fmu"
    path.write_bytes(b"no zip")
    found = hesr("check", path)
    assert found.code == 1
    assert found.out[-1] == f"{path}: 1 problem found."


def test_a_file_that_is_not_there_is_told_before_any_work(source_fmu, tmp_path):
    found = hesr("check", source_fmu, tmp_path / "none.fmu", "--json", "o.json")
    assert found == Answer(2, [], f"hesr: {tmp_path / 'none.fmu'}: no such file.\n")
    assert not (tmp_path / "o.json").exists()


def test_a_folder_that_lacks_vdmcheck2(source_fmu):
    found = hesr("check", source_fmu, "--vdmcheck", "none")
    assert found.code == 2
    assert found.err == "hesr: --vdmcheck is 'none', where there is no vdmcheck2.jar.\n"


def test_an_fmu_has_to_be_given():
    assert hesr("check").code == 2


def test_a_master_at_its_worst(make_law, make_model, tmp_path):
    fmu = export_fmu(make_model(make_law("lugre")), tmp_path / "F.fmu")
    found = hesr("check", fmu, "--hostile", "--json", tmp_path / "o.json")
    assert found == Answer(0, [f"{fmu}: {NO_VDMCHECK}", f"{fmu}: no problem found."], "")
    assert json.loads((tmp_path / "o.json").read_text(encoding="utf-8"))[0]["problems"] == []
