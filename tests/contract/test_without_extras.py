"""The core without `hesr.extras` and without optional packages: laws, verbs and a quick run."""

import json
import subprocess
from pathlib import Path

import markupsafe
import numpy as np
import pytest
from containing import OneSentence
from plugin_packages import run_python
from small_twin import ALONE, MOTIONS

from hesr_model.fitting.estimator import laws_of_paper, registry
from hesr_model.support import plugins
from hesr_model.support.extras import install_command
from hesr_model.support.files import models_folder

NO_EXTRAS = """
import sys


class NoExtras:
    def find_spec(self, name, path=None, target=None):
        if name == "hesr.extras" or name.startswith("hesr.extras."):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, NoExtras())
"""
"""Text of a `sitecustomize`, imported by every Python process."""

NO_PACKAGES = """
import sys

sys.modules.update(dict.fromkeys(("bokeh", "h5py", "openpyxl", "pandas", "pyarrow", "rosbags")))
"""
"""The same for optional packages."""

VERBS = ("new", "inspect", "excite", "identify", "fit", "export", "check", "simulate", "run",
         "report")  # fmt: skip

HELP = f"""
import click
from click.testing import CliRunner
from hesr.cli.app import app
for verb in {VERBS}:
    found = CliRunner().invoke(app, [verb, "--help"])
    assert found.exit_code == 0, (verb, found.output, found.exception)
"""

UF850 = models_folder() / "uf850"

STUDY = f"""
name = "core"
robot = "{UF850 / "robot.toml"}"

[twin]
plant = "{UF850 / "plant.toml"}"
signals = "{UF850 / "arm.toml"}"
motions = "motions.toml"

[logs]
identification = ["excitation"]
reversed = ["excitation_reversed"]
test.unseen = ["trial"]
"""

FEW_STARTS = """
[options.parfam_h]
cells = 2
starts = 4
candidates = 2

[options.parfam_v]
starts = 4
"""

SYSTEM = """
step = 0.01
stop = 1.0

[[components]]
name = "gain"
fmu = "gain.fmu"
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    (folder / "sitecustomize.py").write_text(NO_EXTRAS, encoding="utf-8")
    return folder


def hesr(site: Path, *arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return run_python(site, "-c", ALONE, *arguments, cwd=cwd)


def core_laws() -> list[str]:
    entries = plugins.load("hesr.laws")
    return [name for name in registry() if not entries[name].entry.module.startswith("hesr.extras")]


def test_only_laws_of_the_core_are_listed(site: Path, tmp_path: Path) -> None:
    code = "import json, hesr; print(json.dumps(list(hesr.laws())))"
    found = run_python(site, "-c", code, cwd=tmp_path)
    assert found.returncode == 0, found.stderr
    assert json.loads(found.stdout) == core_laws()
    assert set(laws_of_paper()) <= set(core_laws())
    assert len(core_laws()) < len(registry())


def test_help_of_every_core_verb(site: Path, tmp_path: Path) -> None:
    found = run_python(site, "-c", HELP, cwd=tmp_path)
    assert found.returncode == 0, found.stderr


def test_verbs_and_formats_of_extras_are_unknown(site: Path, tmp_path: Path) -> None:
    found = hesr(site, "monitor", "log.csv", cwd=tmp_path)
    assert found.returncode == 2
    assert "No such command 'monitor'" in found.stderr
    code = "import hesr; hesr.export('uf850-table1', 'f.mo', format='modelica')"
    found = run_python(site, "-c", code, cwd=tmp_path)
    assert "'format' is modelica; allowed are" in found.stderr.splitlines()[-1]
    found = hesr(site, "check", "F.fmu", "--kind", "hostile", cwd=tmp_path)
    assert found.returncode == 2
    assert found.stderr == (
        "hesr: --kind is hostile; allowed are static, references, convention.\n"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("test", "uf850-table1", "--kind", "properties"),
            "--kind is properties; allowed are prediction, passivity.",
        ),
        (
            ("export", "uf850-table1", "-o", "F.fmu", "--properties"),
            "test 'properties' is not installed.",
        ),
        (("run", "--quick", "--seeds", "2"), "part of a study 'seeds' is not installed."),
        (("report", "r", "-o", "r.md"), "r.md: reports are .html."),
        (
            ("check", "F.fmu", "--junit", "F.xml"),
            "format of findings 'junit' is not installed.",
        ),
        (("simulate", "loop.ssp"), "system format 'ssp-reader' is not installed."),
        (("check", "loop.ssp"), "system format 'ssp-check' is not installed."),
        (("export", "system.toml", "-o", "loop.ssp"), "system format 'ssp' is not installed."),
    ],
)
def test_parts_of_extras_are_refused(
    arguments: tuple[str, ...], message: str, site: Path, tmp_path: Path
) -> None:
    (tmp_path / "system.toml").write_text(SYSTEM, encoding="utf-8")
    found = hesr(site, *arguments, cwd=tmp_path)
    assert (found.returncode, found.stderr) == (2, f"hesr: {message}\n")
    assert [path.name for path in tmp_path.iterdir()] == ["system.toml"]


def test_fmus_are_exported_and_checked(site: Path, tmp_path: Path) -> None:
    for arguments in (("export", "uf850-table1", "-o", "F.fmu"), ("check", "F.fmu")):
        found = hesr(site, *arguments, cwd=tmp_path)
        assert found.returncode == 0, found.stderr


@pytest.mark.ci
def test_laws_of_the_paper_table_are_fitted(site: Path, tmp_path: Path) -> None:
    laws = f"laws = {json.dumps(laws_of_paper())}\n{FEW_STARTS}\n"
    (tmp_path / "motions.toml").write_text(MOTIONS, encoding="utf-8")
    (tmp_path / "study.toml").write_text(STUDY.replace("[twin]", f"{laws}[twin]"), encoding="utf-8")
    found = hesr(site, "run", "study.toml", "-o", "results", cwd=tmp_path)
    assert found.returncode == 0, found.stderr
    scores = json.loads((tmp_path / "results" / "evaluation.json").read_text(encoding="utf-8"))
    assert set(laws_of_paper()) <= set(scores["unseen"]["laws"])


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("base")
    (folder / "sitecustomize.py").write_text(NO_EXTRAS + NO_PACKAGES, encoding="utf-8")
    return folder


def test_logs_need_no_optional_package(base: Path, tmp_path: Path) -> None:
    """Excited by sines, each joint has its own friction; Parquet names its package."""
    robot, t = UF850 / "robot.toml", np.arange(0.0, 20.0, 0.005)
    rates = np.array([1.0, 1.7, 2.3])
    q, dq = np.sin(np.outer(t, rates)), rates * np.cos(np.outer(t, rates))
    rows = np.column_stack([t, q, dq, 5.0 * np.sign(dq) + 3.0 * dq])
    names = ",".join(["t", *(f"{name}{k}" for name in ("q", "dq", "tau") for k in range(1, 4))])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=names, comments="")
    found = hesr(base, "inspect", "log.csv", "--robot", robot, "--fail-on", "never", cwd=tmp_path)
    assert found.returncode == 0, found.stderr
    assert "(+- 0.3) times the inertial torque" in found.stdout
    (tmp_path / "log.parquet").write_bytes(b"PAR1")
    found = hesr(base, "inspect", "log.parquet", "--robot", robot, cwd=tmp_path)
    assert found.returncode == 2
    assert found.stderr == OneSentence("hesr: Parquet and Feather need pyarrow")


@pytest.mark.ci
def test_a_twin_needs_no_extra_and_no_optional_package(base: Path, tmp_path: Path) -> None:
    """The main path: a project, its quick run, the report and a simulation."""
    for arguments in (
        ("new", "project", "--twin"),
        ("run", "--quick"),
        ("simulate", "results/uf850/closed_loop.toml", "-o", "loop.csv"),
        ("report", "results/uf850"),
    ):
        found = hesr(base, *arguments, cwd=tmp_path)
        assert found.returncode == 0, found.stderr
    assert found.stderr == OneSentence("hesr: figures of the report")
    results = tmp_path / "results" / "uf850"
    assert {path.stem for path in (results / "fmus").glob("*.fmu")} >= {"parfam_h"}
    page = (results / "report.html").read_text(encoding="utf-8")
    assert f"Figures zoom after <code>{markupsafe.escape(install_command('report'))}</code>" in page
    assert 'class="to-zoom"' not in page
    assert {path.suffix for path in (results / "traces").iterdir()} == {".npz"}
    assert (results / "closed_loop.npz").is_file()
