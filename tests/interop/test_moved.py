"""A packaged system is self-contained: it runs in another folder with a minimal environment."""

import json
import os
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from interop.case import Case, Run, Together, deviation
from interop.engine import Engine, Tools, given_together, read_signals
from interop.engines import ENGINES
from interop.engines.ecos import parameter_sets
from interop.matrix import Expected

HOSTS = Path(__file__).with_name("hosts")
OURS = ("hesr_model", "fmu_src", "cosim", "mujoco", "pinocchio")
PYTHON = {"FMPy": "run_fmpy_ssp.py", "libcosim": "run_libcosim.py", "ecos": "run_ecos.py"}


def bare(python: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run an interpreter in a folder with a minimal environment, without user packages."""
    command = [str(python), "-E", "-s", *arguments]
    path = {"PATH": os.defpath}  # ecos unpacks archives by an external program
    return subprocess.run(command, cwd=folder, env=path, capture_output=True, text=True)


@pytest.fixture
def python(tools: Tools) -> Path:
    """The interpreter of the engines, without our packages."""
    found = (tools.folder / "python/bin/python").absolute()
    if not found.is_file():
        pytest.skip("there is no Python of the engines: make interop")
    look = "import importlib.util as u, sys; sys.exit(any(map(u.find_spec, sys.argv[1:])))"
    assert bare(found, Path("/"), "-c", look, *OURS).returncode == 0
    return found


@pytest.mark.parametrize("name", PYTHON)
def test_the_closed_loop_runs_without_hesr(
    name: str,
    python: Path,
    need: Callable[[Engine], None],
    cases: Mapping[str, Case],
    references: Expected,
    tmp_path: Path,
) -> None:
    engine = next(e for e in ENGINES if e.name == name)
    need(engine)
    case = cases["closed"]
    assert isinstance(case, Together)
    # Only the SSP file and the script are copied.
    (tmp_path / "moved.ssp").write_bytes(case.ssp.read_bytes())
    for script in ("files.py", PYTHON[name]):
        (tmp_path / script).write_bytes((HOSTS / script).read_bytes())
    given: dict[str, Any] = given_together(case)
    given |= {"ssp": "moved.ssp", "parameter_set": next(iter(parameter_sets(case.ssp)))}
    (tmp_path / "case.json").write_text(json.dumps(given), encoding="utf-8")
    ended = bare(python, tmp_path, PYTHON[name], "case.json")
    assert ended.returncode == 0, ended.stderr
    run = Run(signals=read_signals(tmp_path / "result.csv"), first=int(name == "FMPy"))
    assert deviation(run, references(case, engine.coupling)) <= case.tolerance
