"""The names of `import hesr`: quick to import, documented, the same for checkers; and its help."""

import ast
import inspect
import pydoc
import subprocess
import sys
import time
from pathlib import Path

import pytest

import hesr
from hesr.cli.old_app import _ORDER as COMMANDS
from hesr_model.support.lazy import lazy

NOT_CALLS = {"thermal", "view", "constants", "sweep"}
"""Commands that only show; the last two have no call yet."""


def test_every_name_is_there_and_documented() -> None:
    for name in dir(hesr):
        assert inspect.getdoc(getattr(hesr, name)), name
    with pytest.raises(AttributeError, match="module 'hesr' has no attribute 'fitt'"):
        _ = hesr.fitt


def test_checkers_see_the_same_names_from_the_same_modules() -> None:
    tree = ast.parse(Path(hesr.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If) and len(node.body) > 1)
    seen = {
        alias.asname or alias.name: f"{node.module}:{alias.name}"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    homes = {name: home if ":" in home else f"{home}:{name}" for name, home in hesr._HOMES.items()}
    assert seen == homes
    (listed,) = (ast.literal_eval(n.value) for n in block.body if isinstance(n, ast.Assign))
    assert sorted(listed) == dir(hesr)


def test_every_command_is_a_call() -> None:
    assert set(COMMANDS) - set(dir(hesr)) == NOT_CALLS


def test_help_fits_a_screen_and_names_everything() -> None:
    lines = pydoc.render_doc(hesr).splitlines()
    assert len(lines) <= 60
    assert max(map(len, lines)) <= 110
    assert [name for name in dir(hesr) if name not in str(hesr.__doc__)] == []


def test_importing_it_loads_nothing() -> None:
    code = "import sys; before = set(sys.modules); import hesr; print(*set(sys.modules) - before)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    ours = {name for name in loaded if name.startswith(("hesr", "cosim", "fmu_src"))}
    assert ours == {"hesr", "hesr_model", "hesr_model.support", "hesr_model.support.lazy"}
    assert not {"numpy", "sympy", "scipy", "pinocchio"} & set(loaded)


def test_a_lazy_name_is_looked_up_once() -> None:
    module = type(sys)("lazy_names")
    sys.modules[module.__name__] = module
    try:
        find, names = lazy(module.__name__, {"now": "time:perf_counter", "sleep": "time"})
        assert find("now") is vars(module)["now"] is time.perf_counter
        assert find("sleep") is time.sleep
        assert names() == ["now", "sleep"]
        with pytest.raises(AttributeError, match="module 'lazy_names' has no attribute 'wake'"):
            find("wake")
    finally:
        del sys.modules[module.__name__]
