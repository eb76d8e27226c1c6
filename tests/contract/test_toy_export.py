"""An export format from another package: help, calls, types and refusals treat it like HESR's own.

The package is the example of docs/add-an-export-format.md, with a module and entry points as
installed by `pip install`.
"""

import csv
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from containing import OneSentence
from documents import block
from plugin_packages import lay_package, run_python

import cosim.workflow.export_options as types_of_options
from cosim.workflow.export_formats import KINDS, export_options_code, load_exporters
from fmu_src import model_file
from fmu_src.exporter import Exporter
from hesr.cli import main
from hesr_model.friction.model import FrictionModel

FORMAT, LAW = "slow-swing", "uf850-table1"
MODULE = block("add-an-export-format.md", "python")
PROJECT = tomllib.loads(block("add-an-export-format.md", "toml"))["project"]


def install(folder: Path, module: str = MODULE) -> Path:
    """Install the package into a folder."""
    points = PROJECT["entry-points"]
    name = points["hesr.exports"][FORMAT].partition(":")[0]
    return lay_package(folder, points, name=PROJECT["name"], modules={name: module})


run = partial(run_python, columns=80)


def export(site: Path, *arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run `hesr export` with the package installed."""
    return run(site, "-c", "from hesr.cli import main; main()", "export", *arguments, cwd=cwd)


@pytest.fixture
def refuse(
    site: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Callable[..., str]:
    """Return a function that runs `hesr export` in this process and returns the error."""
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", ["hesr", "export", *arguments])
        with pytest.raises(SystemExit) as caught:
            main()
        assert caught.value.code == 2
        return capsys.readouterr().err

    return call


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install(tmp_path_factory.mktemp("site"))


def test_the_example_is_short() -> None:
    assert len(MODULE.splitlines()) < 60
    assert PROJECT["entry-points"]["hesr.exports"].keys() == {FORMAT}


def test_the_help_groups_options_by_format(site: Path, tmp_path: Path) -> None:
    shown = export(site, "--help", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    sections = dict(re.findall(r"(?m)^(\S[^\n]*):\n((?:  .*\n|\n)+)", shown.stdout))
    rows = " ".join(sections["Formats of a friction law"].split())
    assert f"{FORMAT} table of the friction over one slow swing of the speed (.csv)" in rows
    assert re.search(r"\bdrive FMU with the rotor:.*?\(\.fmu\)", rows)
    own = " ".join(sections[f"Options of {FORMAT}"].split())
    assert "--top-speed X[,X...] Largest speed of the joints, one value or one per joint." in own
    assert "--duration X Duration of the swing; by default 10. [s]" in own
    assert "--inertia X[,X...]" in sections["Options of drive"]
    assert "--duration" not in sections["Options of drive"]
    assert "--fmi [2|3]" in sections["Options of adaptive, drive, fmu, observer and plant"]
    assert "--top-speed" not in sections["Options"]


def test_the_command_and_the_function_write_the_file(site: Path, tmp_path: Path) -> None:
    options = ("--top-speed", "0.5,0.5,1", "--duration", "2")
    answer = export(site, LAW, "--format", FORMAT, *options, "-o", "command.csv", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.startswith("Table of the friction over one slow swing of the speed, ")
    call = (
        f"hesr.export('{LAW}', 'call.csv', format='{FORMAT}', top_speed=[0.5, 0.5, 1], duration=2)"
    )
    answer = run(site, "-c", f"import hesr; {call}", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert (tmp_path / "command.csv").read_bytes() == (tmp_path / "call.csv").read_bytes()
    with (tmp_path / "command.csv").open(encoding="utf-8", newline="") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    assert columns["t"][-1] == pytest.approx(2.0, abs=0.01)
    assert columns["dq[1]"].max() == pytest.approx(0.5, rel=1e-3)
    assert columns["dq[3]"].max() == pytest.approx(1.0, rel=1e-3)
    dq = np.column_stack([columns[f"dq[{i}]"] for i in (1, 2, 3)])
    model = FrictionModel.read(model_file(LAW))
    tau = model.predict(t=columns["t"], dq=dq, q=np.zeros_like(dq), tau_load=np.zeros_like(dq))
    for i in (1, 2, 3):
        np.testing.assert_allclose(columns[f"tau[{i}]"], tau[:, i - 1], rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            (LAW, "--top-speed", "1", "-o", "F.fmu"),
            f"--top-speed needs --format {FORMAT}, but the format is 'fmu'.",
        ),
        (
            (LAW, "--duration", "1", "--format", "modelica", "-o", "F.mo"),
            f"--duration needs --format {FORMAT}, but the format is 'modelica'.",
        ),
        (
            (LAW, "--format", FORMAT, "--top-speed", "1", "--fmi", "3", "-o", "s.csv"),
            "--fmi needs --format adaptive, drive, fmu, observer or plant, but the format "
            f"is '{FORMAT}'.",
        ),
        (
            (LAW, "--format", FORMAT, "--top-speed", "1", "--platform", "win64", "-o", "s.csv"),
            "--platform needs --format adaptive, drive, fmu, observer or plant, but the "
            f"format is '{FORMAT}'.",
        ),
        (
            (LAW, "--format", FORMAT, "-o", "s.csv"),
            f"--format {FORMAT} needs --top-speed, the largest speed of the swing.",
        ),
        (
            (LAW, "--format", FORMAT, "--top-speed", "1,2", "-o", "s.csv"),
            "--top-speed: found 2 values,",
        ),
        (
            (LAW, "--format", FORMAT, "--top-speed", "1", "-o", "s.txt"),
            "s.txt: the name of a table ends in .csv.",
        ),
        (
            ("robot.xml", "--top-speed", "1", "-o", "A.fmu"),
            "--top-speed is for friction laws, not for a robot.",
        ),
        (
            ("system.toml", "--duration", "1", "-o", "loop.ssp"),
            "--duration is for friction laws, not for a system.",
        ),
        (
            ("robot.xml", "--format", FORMAT, "-o", "A.fmu"),
            f"--format is {FORMAT}, which is for friction laws; a robot becomes an FMU",
        ),
        ((LAW, "--format", "swing", "-o", "s.csv"), f"urdf-dynamics, {FORMAT}."),
    ],
)
def test_refusals_are_those_of_own_formats(
    arguments: tuple[str, ...], sentence: str, refuse: Callable[..., str], tmp_path: Path
) -> None:
    error = refuse(*arguments)
    assert error.startswith("hesr: ")
    assert sentence in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


CHANGING = """
from fmu_src.exporter import Exporter

def write(model, output, platforms, progress):
    output.write_text(f"version VERSION for {', '.join(platforms)}")

SWING = Exporter(title="text", suffixes=(".txt",), write=write, platforms="common")
"""


def test_a_changed_format_is_not_copied_from_the_cache(tmp_path: Path) -> None:
    """Its package has the same version; a compiling format of HESR's own would be copied."""
    written = []
    for version in ("1", "2"):
        module = CHANGING.replace("VERSION", version)
        site = install(tmp_path / version, module)
        options = ("--format", FORMAT, "--platform", "linux64", "-o", "s.txt")
        answer = export(site, LAW, *options, cwd=tmp_path)
        assert answer.returncode == 0, answer.stderr
        written.append((tmp_path / "s.txt").read_text(encoding="utf-8"))
    assert written == ["version 1 for linux64", "version 2 for linux64"]


# --- types ---------------------------------------------------------------------------------------


def test_the_types_are_those_of_the_exporters() -> None:
    """After a change: `hesr.export_types.write_stubs`, or copy the code that is expected here."""
    assert Path(types_of_options.__file__).read_text(encoding="utf-8") == export_options_code()


def test_every_own_format_is_an_exporter() -> None:
    exporters = {kind.group: load_exporters(kind) for kind in KINDS}
    assert {group: len(formats) > 0 for group, formats in exporters.items()} == {
        kind.group: True for kind in KINDS
    }
    for formats in exporters.values():
        for name, exporter in formats.items():
            assert isinstance(exporter, Exporter)
            names = [option.name for option in exporter.options]
            assert len(names) == len(set(names)), name
            assert all(option.help.endswith(".") for option in exporter.options), name


SCRIPT = f"""
import hesr

hesr.export("{LAW}", "a.csv", format="{FORMAT}", top_speed=[1.0], duration=2.0)
hesr.export("{LAW}", "a.fmu", fmi=3, power=True)
hesr.export("{LAW}", "a.csv", format="{FORMAT}", top_speed=1.0, duration="long")
hesr.export("{LAW}", "a.csv", format="{FORMAT}", top_sped=1.0)
hesr.export("{LAW}", "a.fmu", fmi=4)
"""


@pytest.mark.ci
def test_type_checkers_know_the_options(tmp_path: Path) -> None:
    site = install(tmp_path / "site")
    written = run(site, "-m", "hesr.export_types", site, cwd=tmp_path)
    assert written.returncode == 0, written.stderr
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    options = ("--strict", "--no-error-summary", "--cache-dir", tmp_path / "cache")
    checked = run(site, "-m", "mypy", *options, "script.py", cwd=tmp_path)
    errors = re.findall(r'(?m)^script\.py:(\d+): error: .*?"(\w+)"', checked.stdout)
    assert errors == [("6", "duration"), ("7", "top_sped"), ("8", "fmi")], checked.stdout


# --- broken packages -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("module", "sentence"),
    [
        ("import no_such_library", f"'{FORMAT}' of the package 'slow-swing' cannot"),
        ("SWING = print", f"'{FORMAT}' of the package 'slow-swing' is not an Exporter;"),
        (
            MODULE.replace('type="float", unit="s"', 'type="bool", repeatable=True'),
            "'duration' of the type bool cannot",
        ),
        (
            MODULE.replace('"duration"', '"platform"'),
            "an option cannot have the name 'platform'.",
        ),
        (
            MODULE.replace('name="duration"', 'name="band"'),
            "but bool in the format 'fmu'",
        ),
    ],
)
def test_a_broken_package_is_named(module: str, sentence: str, tmp_path: Path) -> None:
    site = install(tmp_path / "site", module)
    answer = export(site, "--help", cwd=tmp_path)
    assert answer.returncode == 2
    assert answer.stderr == OneSentence("hesr: ", sentence)
