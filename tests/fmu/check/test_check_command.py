"""`hesr check` through the real command line: output, files and exit codes."""

import json
import signal
import subprocess
import sys
from dataclasses import dataclass
from xml.etree import ElementTree

import pytest
from containing import Containing
from fmu_files import changed
from plugin_packages import lay_package
from rule_changes import put

from cosim.workflow.check import check
from fmu_src import export_fmu
from fmu_src.check.external import NO_VDMCHECK
from hesr_model.errors import ArtifactError


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


RULE_COUNT = 65
RECORD = "record: unchanged since its export."
PLATFORMS = "platforms: linux64; no binary for tools on Windows and macOS."
PROBLEM = "modelDescription.xml: it holds '/home/anna/x'"


def test_a_valid_fmu_passes(table1_fmu):
    found = hesr("check", table1_fmu)
    lines = [
        f"{table1_fmu}: passed, no finding of {RULE_COUNT} rules.",
        f"  {PLATFORMS}",
        f"  {RECORD}",
    ]
    assert found == Answer(0, lines, "")


def test_problems_are_printed(source_fmu, bad, tmp_path):
    found = hesr("check", source_fmu, bad, "--json", tmp_path / "deep" / "o.json")
    assert found.code == 0
    assert found.out == [
        f"{source_fmu}: passed, no finding of {RULE_COUNT} rules.",
        "  platforms: none.",
        f"{bad}: 1 advice.",
        Containing(f"  advice: {PROBLEM}", "[machine-path]"),
        "  platforms: none.",
    ]
    written = json.loads((tmp_path / "deep" / "o.json").read_text(encoding="utf-8"))
    assert written["passed"]
    assert [(f["where"], f["found"]) for f in written["findings"]] == [
        (str(bad), Containing(PROBLEM))
    ]
    skipped = [NO_VDMCHECK]
    first, second = written["result"]
    assert first == {
        "fmu": str(source_fmu),
        "problems": [],
        "skipped": skipped,
        "platforms": [],
        "record": "",
    }
    assert [(p["check"], p["found"]) for p in second["problems"]] == [
        ("machine-path", Containing(PROBLEM))
    ]


@pytest.mark.parametrize(("least", "code"), [("never", 0), ("advice", 1), ("warning", 0)])
def test_the_failing_severity_is_selectable(bad, least, code):
    assert hesr("check", bad, "--fail-on", least).code == code


def test_a_file_other_than_an_fmu_is_a_problem_not_an_error(tmp_path):
    path = tmp_path / "F.fmu"
    path.write_bytes(b"no zip")
    found = hesr("check", path)
    assert found.code == 1
    assert found.out[0] == f"{path}: 1 error."


def test_a_missing_file_is_refused(tmp_path):
    found = hesr("check", tmp_path / "none.fmu", "--json", "o.json")
    assert found == Answer(2, [], f"hesr: {tmp_path / 'none.fmu'}: no such file.\n")
    assert not (tmp_path / "o.json").exists()


def test_a_missing_file_among_several_is_a_failing_case(source_fmu, tmp_path):
    missing = tmp_path / "none.fmu"
    files = {"--junit": tmp_path / "o.xml", "--sarif": tmp_path / "o.sarif"}
    options = [part for pair in files.items() for part in pair]
    found = hesr("check", missing, source_fmu, *options)
    assert found.code == 1
    assert found.out[1] == "  error: no such file. [file-missing]"
    assert Containing("passed") in found.out
    failure = ElementTree.parse(files["--junit"]).find(f"testsuite[@name='{missing}']//failure")
    assert failure is not None
    (result,) = json.loads(files["--sarif"].read_text(encoding="utf-8"))["runs"][0]["results"]
    assert (result["ruleId"], result["level"]) == ("file-missing", "error")


def test_quiet_prints_errors_and_nothing_else(source_fmu, bad, tmp_path):
    path = tmp_path / "F.fmu"
    path.write_bytes(b"no zip")
    found = hesr("check", path, "--quiet")
    assert (found.code, found.out) == (1, [])
    assert found.err == Containing(f"hesr: {path}: ", "[archive-damaged]\n")
    assert hesr("check", bad, "--quiet") == Answer(0, [], "")


def test_vdmcheck_is_mentioned_once_on_request(source_fmu, bad):
    found = hesr("check", source_fmu, bad, "--verbose")
    assert "\n".join(found.out).count("VDMCheck2") == 1


def test_an_interrupted_check_keeps_what_was_found(source_fmu, tmp_path):
    """It ends when the first finding is read, which comes before the other files are checked."""
    bad = tmp_path / "bad.fmu"
    bad.write_bytes(b"no zip")
    copies = [tmp_path / f"F{k}.fmu" for k in range(40)]
    for copy in copies:
        copy.write_bytes(source_fmu.read_bytes())
    outputs = ("--json", tmp_path / "o.json", "--junit", tmp_path / "o.xml")
    command = [sys.executable, "-c", "from hesr.cli import main; main()", "check", bad, *copies]
    process = subprocess.Popen(
        [*map(str, [*command, *outputs])], stderr=subprocess.PIPE, text=True, encoding="utf-8"
    )
    assert process.stderr is not None
    assert process.stderr.readline() == Containing(str(bad), "[archive-damaged]")
    process.send_signal(signal.SIGINT)
    _, rest = process.communicate(timeout=60)
    assert (process.returncode, rest) == (130, Containing("of 41 files were checked"))
    result = json.loads((tmp_path / "o.json").read_text(encoding="utf-8"))["result"]
    assert 1 <= len(result) < 41
    checked = list(map(str, [bad, *copies]))[: len(result)]
    assert [report["fmu"] for report in result] == checked
    suites = ElementTree.parse(tmp_path / "o.xml").findall("testsuite")
    assert [suite.get("name") for suite in suites] == checked


def test_a_killed_check_leaves_complete_files_of_what_was_found(source_fmu, tmp_path):
    """Files may lag by a few checks: writing them takes at most a tenth of the time."""
    bad = changed(
        source_fmu, tmp_path / "Bad.fmu", put("DefaultExperiment", tolerance="-1")
    ).read_bytes()
    copies = [tmp_path / f"F{k}.fmu" for k in range(40)]
    for copy in copies:
        copy.write_bytes(bad)
    files = {kind: tmp_path / f"o.{kind}" for kind in ("json", "junit", "sarif")}
    options = [part for kind, file in files.items() for part in (f"--{kind}", file)]
    command = [sys.executable, "-c", "from hesr.cli import main; main()", "check", *copies]
    process = subprocess.Popen(
        [*map(str, [*command, *options])], stderr=subprocess.PIPE, text=True, encoding="utf-8"
    )
    assert process.stderr is not None
    for copy in copies[:20]:
        assert process.stderr.readline() == Containing(str(copy), "[experiment-times]")
    process.kill()
    process.communicate(timeout=60)
    result = json.loads(files["json"].read_text(encoding="utf-8"))["result"]
    suites = ElementTree.parse(files["junit"]).findall("testsuite")
    (run,) = json.loads(files["sarif"].read_text(encoding="utf-8"))["runs"]
    for count in (len(result), len(suites), len(run["results"])):
        assert 10 <= count < 40
    assert [report["fmu"] for report in result] == list(map(str, copies))[: len(result)]


def test_a_folder_without_vdmcheck2_is_reported(source_fmu):
    found = hesr("check", source_fmu, "--vdmcheck", "none")
    assert found.code == 2
    assert found.err == "hesr: --vdmcheck is 'none', which does not contain vdmcheck2.jar.\n"


def test_an_fmu_is_required():
    assert hesr("check").code == 2


def test_hostile_masters_are_simulated(make_law, make_model, tmp_path):
    fmu = export_fmu(make_model(make_law("lugre")), tmp_path / "F.fmu")
    found = hesr("check", fmu, "--kind", "hostile", "--json", tmp_path / "o.json")
    verdict = f"{fmu}: passed, no finding of {RULE_COUNT + 1} rules."
    assert found == Answer(0, [verdict, f"  {PLATFORMS}", f"  {RECORD}"], "")
    assert json.loads((tmp_path / "o.json").read_text(encoding="utf-8"))["passed"]


@pytest.mark.parametrize("format_name", ["junit", "sarif"])
def test_a_file_of_findings_is_refused_before_any_check(source_fmu, tmp_path, format_name):
    begun = []
    with pytest.raises(ArtifactError, match="cannot be written there"):
        check(source_fmu, progress=lambda *stage: begun.append(stage), **{format_name: tmp_path})
    assert begun == []


OWN_CHECK = """
def problems(about, contents, folder):
    return [("my-rule", f"it has {len(about.variables)} variables.")], ["My second check: no time."]
"""


def test_checks_of_other_packages_are_run(source_fmu, tmp_path, monkeypatch):
    points = {"hesr.checks": {"mine": "my_checks:problems"}}
    monkeypatch.syspath_prepend(lay_package(tmp_path, points, modules={"my_checks": OWN_CHECK}))
    found = check(source_fmu, kind=["mine"])
    (finding,) = [f for f in found.findings if f.check == "my-rule"]
    assert (finding.severity, finding.found) == ("error", "it has 64 variables.")
    assert "My second check: no time." in found.reports[0].skipped
