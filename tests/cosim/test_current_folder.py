"""No process of HESR imports a module of the current folder, which may be a stranger's."""

import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from processes import started

PLANTED = """
with open({mark!r}, "a", encoding="utf-8") as file:
    file.write(__name__ + "\\n")
raise SystemExit(7)
"""

WORKERS = """
from hesr_model.support.parallel import results_of

class Job:
    def __call__(self):
        import colorsys, fractions, scipy
        return 7

with results_of([Job()] * 2, 2) as results:
    print(*results)
"""

SANDBOX = """
import sys
from pathlib import Path
from fmu_src.run.fmu import FmuInstance

with FmuInstance(Path(sys.argv[1])) as lag:
    lag.initialise()
    lag.step(0.0, 0.1)
    print("stepped")
"""

DOWNLOAD = """
import sys
from contextlib import suppress
from hesr.cli import main

sys.argv[1:] = ["--version"]
with suppress(SystemExit):
    main()
from fmu_src.arm.library import _WHEELS, _download_library
from hesr_model.errors import ExportError

try:
    _download_library("win64", _WHEELS["win64"])
except ExportError as error:  # there is no index
    print("No matching distribution" in str(error), error)
"""


@pytest.fixture
def mark(tmp_path: Path) -> Path:
    """Plant a module of every name that HESR could import; return the file that each writes."""
    mark = tmp_path / "executed"
    folder = tmp_path / "foreign"
    folder.mkdir()
    names = {
        *sys.stdlib_module_names,
        *packages_distributions(),
        "hesr",
        "hesr_model",
        "fmu_src",
        "cosim",
    }
    for name in filter(str.isidentifier, names):
        (folder / f"{name}.py").write_text(PLANTED.format(mark=str(mark)), encoding="utf-8")
    assert (folder / "json.py").exists()
    assert (folder / "pip.py").exists()
    assert (folder / "numpy.py").exists()
    return mark


def run_script(text: str, mark: Path, *arguments: object, **environment: str) -> str:
    """Run a script in the folder of planted modules as `hesr` does; return its output."""
    folder = mark.parent / "foreign"
    with started("-c", text, *arguments, folder=folder, program=("-P",), **environment) as process:
        out, err = process.communicate(timeout=120)
    assert not mark.exists(), mark.read_text(encoding="utf-8")
    assert process.returncode == 0, err
    return out


@pytest.mark.ci
def test_workers_import_nothing_of_it(mark: Path) -> None:
    assert run_script(WORKERS, mark) == "7 7\n"


@pytest.mark.ci
def test_foreign_fmus_import_nothing_of_it(mark: Path, lag_fmu: Path) -> None:
    foreign = mark.with_name("Lag.fmu")
    foreign.write_bytes(lag_fmu.read_bytes())
    assert run_script(SANDBOX, mark, foreign, XDG_CONFIG_HOME=str(mark.parent)) == "stepped\n"


@pytest.mark.ci
def test_downloads_import_nothing_of_it(mark: Path) -> None:
    out = run_script(DOWNLOAD, mark, PIP_NO_INDEX="1", PIP_CONFIG_FILE="/dev/null")
    assert out.splitlines()[-1].startswith("True "), out
