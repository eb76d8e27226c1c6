"""Structure of the imports: layers, libraries confined to modules, and lightweight help."""

import ast
import io
import json
import re
import subprocess
import sys
import tokenize
import tomllib
from fnmatch import fnmatch
from graphlib import TopologicalSorter
from importlib.metadata import packages_distributions

import pytest
from sources import (
    HOSTS,
    LAYERS,
    MODULES,
    ROOT,
    imports,
    layer,
    libraries,
    top,
    tree,
)

KNOWN_UPWARD: set[str] = set()
"""Modules that still import upwards. Remove an entry with its last such import."""

LEVELS = 10
"""Longest chain of imports inside cosim. Target: 10."""

ONLY_IN = {
    "pinocchio": ("hesr_model/robots/*",),
    "mujoco": (
        "hesr_model/robots/mjcf.py",
        "fmu_src/arm/*",
        "hesr/extras/view/*",
    ),
    "pythonfmu": ("fmu_src/arm/*",),
    "matplotlib": ("cosim/report/figures/*", "hesr/extras/*figures.py"),
    "bokeh": ("cosim/report/figures/zoom.py",),
    "fmpy": (
        "fmu_src/run/*",
        "fmu_src/check/*",
        "hesr/extras/hostile/scenarios.py",
        "fmu_src/export/package.py",
    ),
    "lief": ("fmu_src/check/*",),
    "lxml": ("fmu_src/check/*",),
    "ziglang": ("hesr_model/support/compiler.py",),
    "pyarrow": ("hesr_model/logs/tables.py", "hesr_model/logs/parsers/arrow.py"),
    "distributed": ("hesr/extras/sweep/cluster.py",),
    # Optional: each reads one log format.
    "h5py": ("hesr_model/logs/parsers/hdf5.py",),
    "openpyxl": ("hesr_model/logs/parsers/excel.py",),
    "rosbags": ("hesr_model/logs/parsers/ros_bag.py",),
    "sklearn": ("cosim/regressor.py",),
    "click": ("hesr/cli/*",),
    "rich": ("hesr/cli/*", "cosim/report/tables/*"),
    "cloudpickle": ("hesr_model/support/parallel.py",),
    "imageio_ffmpeg": ("hesr/extras/view/report.py",),
}

FORBIDDEN_CALLS = {"print", "eval", "exec", "sympify", "parse_expr", "breakpoint"}
FORBIDDEN_LIBRARIES = {"pickle", "marshal", "shelve", "dill", "tests", "models"}

LOWEST_ROOMS = ("fmu_src.run", "fmu_src.check", "fmu_src.export")
"""Lowest packages of fmu_src: they handle FMUs of any content and import only `BASE`."""

BASE = ("hesr_model.support", "hesr_model.errors", "hesr_model.findings")

HEAVY = {"sympy", "mujoco", "matplotlib", "pinocchio", "scipy", "fmpy", "pyarrow", "jinja2"}
HEAVY |= {"lxml", "lief"}


def named_extras(name: str) -> set[str]:
    """Return the modules of extras that a module names in strings for late import."""
    texts = (
        node.value.partition(":")[0]
        for node in ast.walk(tree(MODULES[name]))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    )
    return {text for text in texts if text in MODULES and layer(text) == "hesr.extras"}


def own_imports(name: str) -> set[str]:
    return set(imports(MODULES[name])) & MODULES.keys() - {name}


def parents(name: str) -> list[str]:
    """Return the packages of the same layer that Python executes before a module."""
    parts = name.split(".")
    packages = (".".join(parts[:count]) for count in range(1, len(parts)))
    return [package for package in packages if layer(package) == layer(name)]


def test_every_layer_has_modules() -> None:
    assert {layer(name) for name in MODULES} == set(LAYERS)
    assert len(MODULES) > 300


def test_imports_go_down_only() -> None:
    upward = {
        name: above
        for name in MODULES
        if (
            above := {
                other
                for other in own_imports(name) | named_extras(name)
                if LAYERS.index(layer(other)) > LAYERS.index(layer(name))
            }
        )
    }
    assert {name: above for name, above in upward.items() if name not in KNOWN_UPWARD} == {}
    assert KNOWN_UPWARD - upward.keys() == set(), "these no longer import upwards: remove them"


def test_imports_are_acyclic() -> None:
    """Counts indirect imports, imports inside functions, and packages executed on the way."""
    needs = {
        name: {
            needed
            for other in own_imports(name)
            for needed in (other, *parents(other))
            if not f"{name}.".startswith(f"{needed}.")
        }
        for name in MODULES
    }
    assert sum(map(len, needs.values())) > 300
    TopologicalSorter(needs).prepare()  # raises CycleError with the cycle


def test_cosim_has_two_files_at_its_top() -> None:
    files = {path.name for path in MODULES.values() if path.parent.as_posix() == "cosim"}
    assert files - {"__init__.py"} <= {"regressor.py", "monolithic.py"}


def test_import_chains_in_cosim_are_short() -> None:
    needs = {
        name: {other for other in own_imports(name) if layer(other) == "cosim"}
        for name in MODULES
        if layer(name) == "cosim"
    }
    chains: dict[str, list[str]] = {}
    for name in TopologicalSorter(needs).static_order():
        chains[name] = [name, *max((chains[other] for other in needs[name]), key=len, default=[])]
    longest = max(chains.values(), key=len)
    assert len(longest) <= LEVELS, longest


def modules_of(room: str) -> list[str]:
    """Return the modules of a package."""
    return [name for name in MODULES if f"{name}.".startswith(f"{room}.")]


@pytest.mark.parametrize("room", LOWEST_ROOMS)
def test_the_lowest_rooms_stand_alone(room: str) -> None:
    """They could become a distribution of their own, since no model or component is known there."""
    assert len(modules_of(room)) > 5
    strangers = {
        (name, needed)
        for name in modules_of(room)
        for needed in own_imports(name)
        if not any(f"{needed}.".startswith(f"{place}.") for place in (*LOWEST_ROOMS, *BASE))
    }
    assert strangers == set()


@pytest.mark.parametrize("room", LOWEST_ROOMS)
def test_the_lowest_rooms_do_not_name_friction(room: str) -> None:
    friction = re.compile("friction|robot|torque", re.IGNORECASE)
    named = {
        (name, token.string)
        for name in modules_of(room)
        for token in tokenize.generate_tokens(
            io.StringIO((ROOT / MODULES[name]).read_text("utf-8")).readline
        )
        if token.type == tokenize.NAME and friction.search(token.string)
    }
    assert named == set()


def test_running_fmus_does_not_load_their_export() -> None:
    """Only compiling a missing library imports it, inside a function."""
    loaded = modules_loaded_by(f"import {', '.join(modules_of('fmu_src.run'))}")
    assert set(modules_of("fmu_src.run")) <= loaded
    assert {name for name in loaded if name.startswith("fmu_src.")} <= {*modules_of("fmu_src.run")}


def test_engine_hosts_do_not_import_hesr() -> None:
    known = {*sys.stdlib_module_names, "files", "numpy"}
    # The last one is for a plain library.
    own = {"fmpy", "casadi", "ecospy", "libcosimpy", "pyfmi", "ctypes"}
    assert len(HOSTS) > 3
    wrong = {
        host: found
        for host in HOSTS
        if not (found := libraries(host)) <= known | own
        or len(found & own) != (host.stem != "files")
    }
    assert wrong == {}


def test_libraries_are_imported_only_in_their_modules() -> None:
    strangers = {
        (library, str(path))
        for path in MODULES.values()
        for library in libraries(path) & ONLY_IN.keys()
        if not any(fnmatch(str(path), place) for place in ONLY_IN[library])
    }
    assert strangers == set()


def test_the_libraries_of_the_definition_are_in_use() -> None:
    """A rule with a misspelt library would always hold, so these must be imported somewhere."""
    used = set().union(*map(libraries, MODULES.values()))
    assert {"fmpy", "numpy", "scipy", "pinocchio", "mujoco", "pythonfmu", "matplotlib"} <= used


def test_every_library_is_a_declared_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = project["optional-dependencies"]
    extras = [name for extra, names in optional.items() if extra != "dev" for name in names]
    needed = [*project["dependencies"], *extras]
    declared = {re.split(r"[<>=!~\[ ]", name)[0].lower() for name in needed}
    # Pinocchio's wheel installs outside the folder searched for owners; optional packages may be
    # missing.
    owners = {"pinocchio": ["pin"], "sklearn": ["scikit-learn"]} | packages_distributions()
    free = sys.stdlib_module_names | set(map(top, LAYERS))
    undeclared = {
        (str(path), library)
        for path in MODULES.values()
        for library in libraries(path) - free
        if not declared & {owner.lower() for owner in owners.get(library, [])}
    }
    assert undeclared == set()


def called(node: ast.Call) -> str:
    """Return the name of a called function; for methods, only those of the module sympy."""
    if isinstance(node.func, ast.Name):
        return node.func.id
    if isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name):
        return node.func.attr if node.func.value.id == "sympy" else ""
    return ""


def test_nothing_is_printed_or_evaluated() -> None:
    offenders = {
        (str(path), name)
        for path in MODULES.values()
        for name in (
            {called(node) for node in ast.walk(tree(path)) if isinstance(node, ast.Call)}
            & FORBIDDEN_CALLS
        )
        | libraries(path) & FORBIDDEN_LIBRARIES
    }
    assert offenders == set()


def test_python_is_started_by_one_function() -> None:
    """So that each process has the option that keeps the current folder out of its path."""
    starts = {
        (name, ast.unparse(node))
        for name, path in MODULES.items()
        for node in ast.walk(tree(path))
        if isinstance(node, (ast.List, ast.Tuple))
        and any(ast.unparse(part) == "sys.executable" for part in node.elts)
    }
    assert {name for name, _ in starts} == {"hesr_model.support.process"}
    for _, text in starts:
        assert "'-P'" in text or "'-ISc'" in text


def modules_loaded_by(code: str) -> set[str]:
    """Return the full names of the modules loaded after code has run in a fresh process."""
    report = "import json, sys; print(json.dumps(sorted(sys.modules)))"
    result = subprocess.run(
        [sys.executable, "-c", f"{code}\n{report}"], capture_output=True, text=True, check=True
    )
    return set(json.loads(result.stdout.splitlines()[-1]))


def loaded_by(code: str) -> set[str]:
    """Return the top-level modules loaded after code has run in a fresh process."""
    return {top(name) for name in modules_loaded_by(code)}


def test_help_loads_no_heavy_library() -> None:
    verbs = [[], *([verb] for verb in ("run", "new", "fit", "check", "export", "simulate"))]
    loaded = loaded_by(
        "from contextlib import suppress\n"
        "from hesr.cli import app\n"
        f"for verb in {verbs}:\n"
        "    with suppress(SystemExit): app([*verb, '--help'])"
    )
    assert "hesr" in loaded
    assert not loaded & HEAVY


def test_measured_logs_do_not_load_the_simulator() -> None:
    loaded = loaded_by("import cosim.study.run, cosim.study.study, fmu_src.friction.replay")
    assert "scipy" in loaded
    assert not loaded & {"mujoco", "matplotlib", "pythonfmu"}


def test_the_models_load_neither_fmi_nor_a_terminal() -> None:
    science = sorted(name for name in MODULES if layer(name) == "hesr_model")
    loaded = loaded_by(f"import {', '.join(science)}")
    assert {"sympy", "scipy"} <= loaded
    assert not loaded & {"fmpy", "mujoco", "matplotlib", "click", "rich", "cosim", "fmu_src"}
