"""A law in the cells of a notebook: fitted, tested, exported, and defined anew after a mistake."""

from pathlib import Path

import nbformat
import pytest
from documents import block

LOGS = '''
import numpy as np
import hesr

robot = hesr.new("motor", bench="rotary", inertia=0.01).folder / "robot.toml"
t = 0.01 * np.arange(1500)


def make_log(name, phase):
    """Return a log of a motor with smooth Coulomb friction."""
    q = np.sin(t + phase) + 0.4 * np.sin(2.7 * t)
    dq = np.cos(t + phase) + 1.08 * np.cos(2.7 * t)
    ddq = -np.sin(t + phase) - 2.916 * np.sin(2.7 * t)
    noise = 0.01 * np.random.default_rng(len(name)).normal(size=len(t))
    tau = 0.01 * ddq + 2.0 * np.tanh(dq / 0.05) + 0.5 * dq + noise
    np.savetxt(f"{name}.csv", np.column_stack([t, q, dq, tau]), delimiter=",",
               header="t,q1,dq1,tau1", comments="")


make_log("train", 0.0)
make_log("test", 0.7)
'''

MISTAKE = """
try:
    exec({code!r})
except hesr.HesrError as error:
    print(error.code, error.key)
"""

FIT = """
law = hesr.fit("train.csv", law={law}, robot=robot)
print(law.law, *law.laws[0].values)
"""

USE = """
regressor = hesr.FrictionRegressor(law=SmoothCoulomb, robot=robot).fit("train.csv")
report = hesr.test(law, on="test.csv", robot=robot, rigid_body=regressor.rigid_body_)
fmu = hesr.export(law, "Friction.fmu", platform="linux64")
print(regressor.score("test.csv") > 0.99, [law.name for law in report.laws], hesr.check(fmu).passed)
law.write("law.json")
print(hesr.FrictionModel.read("law.json").laws[0].values == law.laws[0].values)
"""

STUDY = '''
from pathlib import Path
Path("study.toml").write_text(f"""
name = "motor"
robot = "{robot.as_posix()}"
laws = ["smooth_coulomb"]
[logs]
identification = ["train.csv"]
test.test = ["test.csv"]
""")
run = hesr.run("study.toml", output="results", platform="linux64")
print(*(name for name in run.outcome.fmus if name == "smooth_coulomb"))
'''


def run_cells(cells: list[str], folder: Path) -> list[str]:
    """Execute cells in a kernel; return what each printed to standard output."""
    nbclient = pytest.importorskip("nbclient", reason="needs hesr[docs]")
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    client = nbclient.NotebookClient(book, timeout=500, resources={"metadata": {"path": folder}})
    client.execute()
    return [
        "".join(output.text for output in cell.outputs if output.get("name") == "stdout").strip()
        for cell in book.cells
    ]


@pytest.mark.ci
@pytest.mark.parametrize(
    "studies",
    [
        pytest.param([], id="alone"),
        pytest.param([STUDY], id="in a study", marks=pytest.mark.nightly("studies")),
    ],
)
def test_a_notebook_defines_fits_tests_and_exports_its_law(
    studies: list[str], tmp_path: Path
) -> None:
    law = block("add-a-law.md", "python")
    without_unit = law.replace('unit="rad/s", ', "")
    without_width = law.replace('bounds=(("width", (1e-4, 1.0)),)', "bounds=()")
    coulomb_only = law.replace(" + SIGMA_2.symbol * hesr.DQ", "")
    coulomb_only = coulomb_only.replace(', "sigma_2"), non_negative=2', ",), non_negative=1")
    coulomb_only = coulomb_only.replace("WIDTH, SIGMA_2)", "WIDTH)")
    assert len({law, without_unit, without_width, coulomb_only}) == 4
    printed = run_cells(
        [
            LOGS,
            MISTAKE.format(code=without_unit),
            MISTAKE.format(code=without_width),
            coulomb_only,
            FIT.format(law="'smooth_coulomb'"),
            law,
            FIT.format(law="'smooth_coulomb'"),
            FIT.format(law="SmoothCoulomb"),
            USE,
            *studies,
        ],
        tmp_path,
    )
    assert printed[1] == "law.class.unit width.unit"
    assert printed[2] == "law.class.missing space"
    assert printed[4] == "smooth_coulomb F_c width"
    assert printed[6] == printed[7] == "smooth_coulomb F_c width sigma_2"
    assert printed[8] == "True ['smooth_coulomb'] True\nTrue"
    assert all(text.endswith("smooth_coulomb") for text in printed[9:])
    assert len(printed) == 9 + len(studies)
