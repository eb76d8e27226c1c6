"""Code blocks of the pages are valid: Python runs, TOML is read, command options exist."""

import re
import shlex
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import click
import pytest
from documents import PAGES, ROOT, Block, blocks

from fmu_src import export_fmu, model_file
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log


@pytest.fixture
def folder(tmp_path: Path, arm_log: Log, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Working folder of the blocks: a robot file, its logs and a friction FMU, named as on the
    pages."""
    (tmp_path / "robot.toml").write_text(
        'name = "arm"\nmodel = "arm.xml"\njoints = ["j1", "j2", "j3"]\n', encoding="utf-8"
    )
    for name in ("excitation", "sweep", "test"):
        arm_log.write(tmp_path / f"{name}.csv")
    one = {name: getattr(arm_log, name)[:, :1] for name in ("q", "dq", "tau")}
    replace(arm_log, **one).write(tmp_path / "motor.csv")
    shutil.copy(friction_fmu(tmp_path), tmp_path / "Friction.fmu")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def friction_fmu(folder: Path) -> Path:
    return export_fmu(FrictionModel.read(model_file("uf850-table1")), folder / "table1.fmu")


def run(text: str, name: str) -> dict[str, object]:
    """Run a block; return the names it defines."""
    names: dict[str, object] = {"__name__": "__main__"}
    exec(compile(text, name, "exec"), names)
    return names


@pytest.mark.parametrize("block", blocks("python"), ids=str)
def test_python_blocks_compile(block: Block) -> None:
    compile(block.text, str(block), "exec")


PACKAGES = ("add-a-law.md", "add-a-log-format.md", "add-an-export-format.md", "closed-loop.md")
STORIES = ("README.md", "api.md")
"""Pages with tests of their own: test_toy_law.py, test_own_parts.py, test_toy_export.py,
test_closed_loop_page.py and, of both stories, test_api_examples.py."""

RUN = [b for b in blocks("python") if b.runs and b.page.name not in (*PACKAGES, *STORIES)]


def test_some_blocks_are_run() -> None:
    assert RUN


@pytest.mark.parametrize("block", RUN, ids=str)
def test_python_blocks_run(block: Block, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(block.text, str(block))
    assert capsys.readouterr().out.strip()


@pytest.mark.parametrize("block", blocks("toml"), ids=str)
def test_toml_blocks_are_valid(block: Block) -> None:
    assert tomllib.loads(block.text)


def commands() -> list[tuple[str, str]]:
    """Lines of the pages that call hesr, with their continuation lines."""
    return [
        (page.name, line.replace("\\\n", ""))
        for page in PAGES
        for line in re.findall(r"(?m)^ {4}(hesr (?:.*\\\n)*.*)", page.read_text(encoding="utf-8"))
    ]


@pytest.mark.parametrize(("page", "line"), commands())
def test_options_of_commands_exist(page: str, line: str) -> None:
    from hesr.cli import app

    _, name, *rest = shlex.split(line, comments=True)
    command = app.get_command(click.Context(app), name)
    assert command is not None
    options = {option for parameter in command.params for option in parameter.opts}
    used = {argument for argument in rest if re.match(r"--?[a-z]", argument)}
    assert used <= options | {"--help"}, f"{page}: {line}"


def linked() -> list[tuple[Path, str]]:
    return [
        (page, target)
        for page in PAGES
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
        if "://" not in target
    ]


@pytest.mark.parametrize(
    ("page", "target"), linked(), ids=lambda value: str(value).rpartition("/")[2]
)
def test_links_between_files_are_valid(page: Path, target: str) -> None:
    found = (page.parent / target).resolve()
    assert found.is_relative_to(ROOT)
    assert found.exists()
