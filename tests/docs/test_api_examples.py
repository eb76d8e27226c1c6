"""The examples of the page of the Python interface run in its order, from an empty folder."""

import doctest
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest
from documents import ROOT

from hesr_model.fitting import estimator

PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")
LONG = ("run", "report")  # sections whose examples take half a minute

Names = dict[str, Any]


def read_blocks(text: str) -> list[tuple[str, str, str]]:
    """Return section, language and code of each block that runs."""
    blocks = []
    for section in re.split(r"(?m)^#{2,3} ", text)[1:]:
        title = section.partition("\n")[0]
        for language, code in re.findall(r"(?ms)^```(python|pycon)\n(.*?)^```$", section):
            blocks.append((title, language, code))
    return blocks


def run_blocks(wanted: Callable[[str], bool], names: Names) -> int:
    """Run the blocks of some sections; return their number."""
    chosen = [block for block in read_blocks(PAGE) if wanted(block[0])]
    for title, language, code in chosen:
        if language == "python":
            exec(compile(code, title, "exec"), names)
        else:
            test = doctest.DocTestParser().get_doctest(code, names, title, None, 0)
            runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
            assert runner.run(test, clear_globs=False).failed == 0, title
            names.update(test.globs)
    return len(chosen)


@pytest.fixture
def names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Names:
    """Return the names of a session in an empty folder, with the package imported."""
    mpl.use("agg")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(estimator, "_REGISTRY", dict(estimator.registry()))
    started: Names = {"__name__": "__main__"}
    exec("import hesr", started)
    return started


@pytest.mark.ci
@pytest.mark.timeout(900)
def test_recipes_and_commands_run(names: Names, capsys: pytest.CaptureFixture[str]) -> None:
    """The first recipe is the Python block of the README."""
    first = read_blocks(PAGE)[0][2]
    assert f"```python\n{first}```" in README
    assert run_blocks(lambda title: title not in LONG, names) >= 20
    assert all(Path(f"{name}.fmu").is_file() for name in ("Friction", "Own", "Arm"))
    assert names["own"].law == "smooth_coulomb"
    # Friction compensation brings the first joint to its command.
    assert names["signals"].vector("arm.q")[-1, 0] == pytest.approx(0.2, abs=1e-3)
    assert "tau = " in capsys.readouterr().out


@pytest.mark.nightly("commands")
@pytest.mark.timeout(900)
def test_a_study_and_its_report_run(names: Names) -> None:
    names["hesr"].new("my_arm")
    assert run_blocks(lambda title: title in LONG, names) == len(LONG)
    assert Path("results/my_arm/report.html").is_file()
