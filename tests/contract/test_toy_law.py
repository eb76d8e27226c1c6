"""A law from another package: every verb and table treats it like one of HESR's own.

The package is the example of docs/add-a-law.md, with a module and entry points as installed by
`pip install`.
"""

import html
import json
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from containing import OneSentence
from documents import ROOT, block
from plugin_packages import lay_package, run_python
from small_twin import ALONE, GAINS, MOTIONS

from fmu_src.check.run import check
from hesr_model.fitting.estimator import select_laws
from hesr_model.support.files import models_folder

LAW, TITLE = "smooth_coulomb", "Smooth Coulomb"

MODULE = block("add-a-law.md", "python")
PROJECT = tomllib.loads(block("add-a-law.md", "toml"))["project"]

UF850 = models_folder() / "uf850"

STUDY = f"""
name = "toy"
robot = "{UF850 / "robot.toml"}"
laws = ["{LAW}"]

[twin]
plant = "{UF850 / "plant.toml"}"
signals = "{UF850 / "arm.toml"}"
motions = "motions.toml"

[logs]
identification = ["excitation"]
reversed = ["excitation_reversed"]
test.unseen = ["trial"]

[tracking]
seeds = [11]
duration = 1.0
harmonics = 2
peak_velocity = [0.3, 0.25, 0.3]
offset = [0.0, 0.3, -1.9]
Kx = 5.0
sources = ["{LAW}"]
drift = 1.0
"""


def installed(folder: Path, *, module: str = MODULE, law: str = LAW) -> Path:
    """Install the package into a folder."""
    value = PROJECT["entry-points"]["hesr.laws"][LAW]
    points = {"hesr.laws": {law: value}}
    return lay_package(folder, points, name=PROJECT["name"], modules={value: module})


def hesr(site: Path, *arguments: object, cwd: Path) -> str:
    """Run the command line with the package installed; return its output."""
    answer = run_python(site, "-c", "from hesr.cli import main; main()", *arguments, cwd=cwd)
    assert answer.returncode == 0, answer.stderr
    return answer.stdout


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return installed(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory, site: Path) -> Path:
    """Results of `hesr run` with the law."""
    folder = tmp_path_factory.mktemp("toy")
    (folder / "motions.toml").write_text(MOTIONS, encoding="utf-8")
    (folder / "study.toml").write_text(STUDY + GAINS, encoding="utf-8")
    said = hesr(site, "run", "study.toml", "-o", "results", cwd=folder)
    assert TITLE in said
    return folder / "results"


def read(file: Path) -> dict[str, object]:
    return dict(json.loads(file.read_text(encoding="utf-8")))


def test_the_example_is_short() -> None:
    assert len(MODULE.splitlines()) < 60
    assert PROJECT["entry-points"]["hesr.laws"].keys() == {LAW}


def test_the_law_is_listed(site: Path, tmp_path: Path) -> None:
    assert TITLE in hesr(site, "fit", "--list", cwd=tmp_path)


@pytest.mark.ci
def test_the_command_line_fits_and_exports_the_law(
    site: Path, small_results: Path, tmp_path: Path
) -> None:
    """From the log and the body of a run without the law."""
    said = hesr(
        site,
        "fit",
        small_results / "logs" / "excitation.csv",
        "--robot",
        UF850 / "robot.toml",
        "--rigid-body",
        small_results / "rigid_body.json",
        "--law",
        LAW,
        "-o",
        "law.json",
        cwd=tmp_path,
    )
    assert f"{LAW} for joint1, joint2, joint3" in said
    assert "Passivity: proven on joint1, joint2, joint3." in said
    hesr(site, "export", "law.json", "-o", "law.fmu", cwd=tmp_path)
    assert "no finding" in hesr(site, "check", "law.fmu", cwd=tmp_path)
    hesr(site, "export", "law.json", "--format", "modelica", "-o", "Law.mo", cwd=tmp_path)
    assert "tanh(" in (tmp_path / "Law.mo").read_text(encoding="utf-8")


@pytest.mark.ci
def test_the_verdict_recommends_the_law(results: Path) -> None:
    found = read(results / "verdict.json")
    assert (found["law"], found["fmu"]) == (LAW, f"fmus/{LAW}.fmu")
    assert found["unexplained"]


@pytest.mark.ci
def test_a_run_scores_its_fmu_against_the_truth(results: Path) -> None:
    scores = read(results / "evaluation.json")["unseen"]
    assert LAW in scores["laws"]
    assert not check(results / "fmus" / f"{LAW}.fmu").problems


@pytest.mark.ci
def test_the_law_gets_the_physics_checks(results: Path) -> None:
    assert LAW in (results / "properties.json").read_text(encoding="utf-8")


@pytest.mark.ci
def test_the_law_tracks_in_the_closed_loop(results: Path) -> None:
    found = read(results / "closed_loop.json")
    rows = {row["scheme"]: row for row in found["tracking"] if row["law"] == LAW}
    assert len(rows) == 8  # compensation without and with Kx, measured and filtered velocity
    assert not any(row["failures"] for row in rows.values())
    assert any(row["law"] == LAW for row in found["long"])
    assert any(row["law"] == LAW for row in found["sweeps"])


@pytest.mark.ci
def test_the_law_is_in_the_report(results: Path) -> None:
    assert TITLE in (results / "report.html").read_text(encoding="utf-8")


@pytest.mark.ci
def test_the_law_fulfils_the_contract_of_all_laws(site: Path) -> None:
    tests = [ROOT / "tests" / "contract" / f"test_{name}.py" for name in ("laws", "lowerings")]
    options = ("-q", "-m", "not soak", "-p", "no:cacheprovider", "-p", "no:xdist")
    options += ("-p", "no:benchmark")
    answer = run_python(site, "-m", "pytest", *tests, *options, "-k", LAW, cwd=ROOT)
    assert answer.returncode == 0, answer.stdout
    passed = re.search(r"(\d+) passed", answer.stdout)
    assert passed
    skipped = re.search(r"(\d+) skipped", answer.stdout)  # lowerings without their tools
    # As many tests as for any other law without needs.
    listed = run_python(site, "-m", "pytest", *tests, *options, "-k", "stribeck", "--co", cwd=ROOT)
    count = int(passed[1]) + int(skipped[1] if skipped else 0)
    assert count == listed.stdout.count("[stribeck")
    assert int(passed[1]) > 10


@pytest.mark.parametrize(
    ("module", "law", "sentence"),
    [
        (
            "import no_such_library",
            LAW,
            "'smooth_coulomb' of the package 'my-laws' cannot",
        ),
        (
            MODULE,
            "smooth",
            "law 'smooth' of the package 'my-laws'",
        ),
        (
            MODULE.replace('name = "smooth_coulomb"', 'name = "lugre"'),
            "lugre",
            "'lugre' of the package 'my-laws' has",
        ),
    ],
)
def test_a_broken_package_is_named(module: str, law: str, sentence: str, tmp_path: Path) -> None:
    broken = installed(tmp_path / "site", module=module, law=law)
    answer = run_python(
        broken, "-c", "from hesr.cli import main; main()", "fit", "--list", cwd=tmp_path
    )
    assert answer.returncode == 2
    assert answer.stderr == OneSentence("hesr: ", sentence)


# --- a law the logs do not determine ----------------------------------------------------------

UNFIT = (
    MODULE
    + '''
    def fit(self, records, rng):
        """Find that nothing can be said."""
        from hesr_model.errors import FitError

        raise FitError(f"joint '{records[0].joint}': nothing can be said.")
'''
)
WHY = "joint 'joint1': nothing can be said."
MEASURED = STUDY[: STUDY.index("[tracking]")]


@pytest.fixture
def study(tmp_path: Path) -> Path:
    installed(tmp_path / "site", module=UNFIT)
    (tmp_path / "motions.toml").write_text(MOTIONS, encoding="utf-8")
    return tmp_path / "study.toml"


def ran(study: Path, text: str) -> subprocess.CompletedProcess[str]:
    study.write_text(text, encoding="utf-8")
    site = study.parent / "site"
    return run_python(site, "-c", ALONE, "run", study.name, "-o", "results", cwd=study.parent)


@pytest.mark.ci
def test_a_run_continues_without_the_law(study: Path) -> None:
    answer = ran(study, MEASURED.replace(f'["{LAW}"]', f'["stribeck", "{LAW}"]'))
    assert answer.returncode == 0
    assert answer.stderr == f"hesr: law '{LAW}' is left out: {WHY}\n"
    results = study.parent / "results"
    fmus = {fmu.stem for fmu in (results / "fmus").glob("[!A]*.fmu")}
    assert fmus == {"stribeck", *select_laws("baseline")}
    assert read(results / "run.json")["left_out"] == {LAW: WHY}
    page = html.unescape((results / "report.html").read_text(encoding="utf-8"))
    assert f"The law {LAW} was left out: {WHY}" in page


@pytest.mark.ci
def test_a_run_without_another_law_compares_the_baselines(study: Path) -> None:
    answer = ran(study, MEASURED)
    assert answer.returncode == 0
    assert answer.stderr == f"hesr: law '{LAW}' is left out: {WHY}\n"
    fmus = {fmu.stem for fmu in (study.parent / "results" / "fmus").glob("[!A]*.fmu")}
    assert fmus == set(select_laws("baseline"))


@pytest.mark.ci
def test_a_run_whose_closed_loop_needs_the_law_ends(study: Path) -> None:
    answer = ran(study, STUDY.replace("laws = [", 'laws = ["stribeck", ') + GAINS)
    assert (answer.returncode, answer.stderr) == (2, f"hesr: {WHY}\n")
    assert not (study.parent / "results").exists()
