"""The rooms of the house: which package may import which, and what may stand only in one place."""

import ast
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from fnmatch import fnmatch
from graphlib import TopologicalSorter
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import cosim
import fmu_src
import hesr
import hesr_model

ORDER = ("hesr_model", "fmu_src", "cosim", "hesr")
"""Each may import those before it."""

ROOT = Path(hesr_model.__file__).parents[1]

ONLY_IN = {
    "pinocchio": ("hesr_model/robots/robot.py", "hesr_model/robots/model_file.py"),
    "mujoco": ("fmu_src/arm/*", "hesr/extras/view/*"),
    "pythonfmu": ("fmu_src/arm/*", "fmu_src/package*.py"),
    # The modules that draw: one for the pictures in an FMU, one for those of a report.
    "matplotlib": ("fmu_src/pages/picture.py", "cosim/report/figures/*"),
    "bokeh": ("cosim/report/zoom.py",),
    # Packaging, checking, and running.
    "fmpy": (
        "fmu_src/record*.py",
        "fmu_src/package*.py",
        "*/check*.py",
        "fmu_src/run/fmu.py",
        "cosim/instance*.py",
        "fmu_src/run/description.py",
        "cosim/systems/*",
    ),
    "lief": ("fmu_src/check/*",),
    "lxml": ("fmu_src/check/*",),
    "ziglang": ("hesr_model/support/compiler.py",),
    "pyarrow": (
        "hesr_model/logs/tables.py",
        "cosim/loop/traces.py",
        "hesr/extras/sweep/store.py",
        "hesr/extras/fleet/parquet.py",
    ),
    "distributed": ("hesr/extras/sweep/cluster.py",),
    # Optional: each reads one kind of log.
    "h5py": ("hesr_model/logs/readers/matlab.py",),
    "rosbags": ("hesr_model/logs/readers/bag.py",),
    "sklearn": ("cosim/regressor.py",),
    "typer": ("cosim/cli*",),
    "rich": ("cosim/*",),
    "joblib": ("hesr_model/support/parallel.py",),
    "cloudpickle": ("hesr_model/support/parallel.py",),
}

EVERY_MODULE = [
    path.relative_to(ROOT)
    for package in (hesr_model, fmu_src, cosim)
    for path in sorted(Path(package.__file__).parent.rglob("*.py"))
] + [Path(hesr.__file__).relative_to(ROOT)]

# Scripts for interpreters that have an engine and need not have HESR.
HOSTS = [module for module in EVERY_MODULE if module.is_relative_to("cosim/interop/hosts")]
MODULES = [module for module in EVERY_MODULE if module not in HOSTS]


def parsed(module: Path) -> ast.Module:
    return ast.parse((ROOT / module).read_text(encoding="utf-8"))


def imports(module: Path) -> Iterator[str]:
    """Dotted names of everything that a module imports, at its top or inside a function."""
    for node in ast.walk(parsed(module)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: a relative import"
            yield node.module or ""


def room(module: Path) -> str:
    return module.parts[0].removesuffix(".py")


def top(name: str) -> str:
    return name.partition(".")[0]


def test_the_packages_are_there() -> None:
    assert set(map(room, MODULES)) == set(ORDER)
    assert len(MODULES) > 30


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_imports_go_one_way(module: Path) -> None:
    above = ORDER[ORDER.index(room(module)) + 1 :]
    for name in imports(module):
        assert top(name) not in above, f"{module} imports {name}"
        assert top(name) not in ("tests", "models"), f"{module} imports {name}"


def test_no_module_imports_one_that_imports_it() -> None:
    """However long the way round, and whether at the top or inside a function."""
    names = {
        ".".join(module.with_suffix("").parts).removesuffix(".__init__"): module
        for module in MODULES
    }
    needs = {
        name: {
            submodule if (submodule := f"{node.module}.{alias.name}") in names else node.module
            for node in ast.walk(parsed(module))
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        & names.keys() - {name}
        for name, module in names.items()
    }
    assert sum(map(len, needs.values())) > 300
    TopologicalSorter(needs).prepare()  # raises CycleError, which names them


@pytest.mark.parametrize("module", HOSTS, ids=str)
def test_a_host_of_an_engine_needs_nothing_of_ours(module: Path) -> None:
    known = {*sys.stdlib_module_names, "files", "numpy"}
    # The last for a plain library.
    own = {"fmpy", "casadi", "ecospy", "libcosimpy", "pyfmi", "ctypes"}
    found = set(map(top, imports(module)))
    assert found <= known | own
    assert len(found & own) == (module.stem != "files")


@pytest.mark.parametrize("library", ONLY_IN)
def test_a_library_stands_in_its_own_modules_only(library: str) -> None:
    users = {str(module) for module in MODULES if library in map(top, imports(module))}
    strangers = {
        user for user in users if not any(fnmatch(user, place) for place in ONLY_IN[library])
    }
    assert not strangers


@pytest.mark.parametrize(
    "library", ["pinocchio", "mujoco", "fmpy", "lief", "lxml", "pyarrow", "typer"]
)
def test_the_search_for_a_library_finds_its_users(library: str) -> None:
    """A rule that finds nobody would hold for a misspelt name, too."""
    assert any(library in map(top, imports(module)) for module in MODULES)


def test_every_library_is_a_declared_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = project["optional-dependencies"]
    extras = [name for extra, names in optional.items() if extra != "dev" for name in names]
    needed = [*project["dependencies"], *extras]
    declared = {re.split(r"[<>=!~\[ ]", name)[0].lower() for name in needed}
    # The wheel of pinocchio installs outside the folder in which owners are looked up.
    # What is optional need not be installed.
    owners = {"pinocchio": ["pin"], "sklearn": ["scikit-learn"]} | packages_distributions()
    for module in MODULES:
        for name in map(top, imports(module)):
            if name in sys.stdlib_module_names or name in ORDER:
                continue
            assert declared & {owner.lower() for owner in owners[name]}, f"{module} needs {name}"


FORBIDDEN_CALLS = {"print", "eval", "exec", "sympify", "parse_expr", "breakpoint"}


def called(node: ast.Call) -> str:
    """Last part of what is called by name; a method is called on an object and counts less."""
    if isinstance(node.func, ast.Name):
        return node.func.id
    if isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name):
        return node.func.attr if node.func.value.id == "sympy" else ""
    return ""


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_nothing_is_printed_and_no_text_is_run_as_code(module: Path) -> None:
    calls = {called(node) for node in ast.walk(parsed(module)) if isinstance(node, ast.Call)}
    assert not calls & FORBIDDEN_CALLS
    assert not {"pickle", "marshal", "shelve", "dill"} & set(map(top, imports(module)))


def loaded_by(code: str) -> set[str]:
    """Top-level modules that are loaded after some code has run in a fresh process."""
    report = "import json, sys; print(json.dumps(sorted({n.split('.')[0] for n in sys.modules})))"
    result = subprocess.run(
        [sys.executable, "-c", f"{code}\n{report}"], capture_output=True, text=True, check=True
    )
    return set(json.loads(result.stdout.splitlines()[-1]))


HEAVY = {"sympy", "mujoco", "matplotlib", "pinocchio", "scipy", "fmpy", "pyarrow", "jinja2"}
HEAVY |= {"lxml", "lief"}


@pytest.mark.parametrize(
    "command", [[], ["run"], ["new"], ["fit"], ["replay"], ["check"]], ids=" ".join
)
def test_help_is_quick_because_it_loads_nothing_heavy(command: list[str]) -> None:
    loaded = loaded_by(
        "from contextlib import suppress\n"
        "from hesr.cli import app\n"
        f"with suppress(SystemExit): app({[*command, '--help']!r})"
    )
    assert "cosim" in loaded
    assert not loaded & HEAVY


def test_measured_logs_need_no_simulator() -> None:
    loaded = loaded_by("import cosim.study.run, cosim.study.study, fmu_src.run.replay")
    assert "scipy" in loaded
    assert not loaded & {"mujoco", "matplotlib", "pythonfmu"}


def test_the_science_needs_neither_fmi_nor_a_terminal() -> None:
    loaded = loaded_by(
        "import hesr_model.artifacts, hesr_model.fitting.fit, "
        "hesr_model.friction.registry, hesr_model.rigid_body.residual"
    )
    assert {"sympy", "scipy"} <= loaded
    assert not loaded & {"fmpy", "mujoco", "matplotlib", "typer", "rich", "cosim", "fmu_src"}
