"""Random life cycles of a container under sanitizers: some here, all with `-m soak`.

The container runs FMPy's runtime and our FMUs as built; tests/fmu/test_lives.py tests the life
cycles of the latter.
"""

import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from fmpy.model_description import read_model_description

from hesr.extras.ssp.container import holding_sources, write_container
from hesr.extras.ssp.contents import SystemContents

HERE = Path(__file__).parents[2] / "fmu"
FLAGS = ("gcc", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
FEW, ALL = 60, 10_000

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed"),
]


@pytest.fixture(scope="session")
def lives(
    closed: SystemContents, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[int], list[int]]:
    """Run life cycles; return the numbers of steps and of resets."""
    folder = tmp_path_factory.mktemp("container")
    with zipfile.ZipFile(write_container(closed, folder / "Loop.fmu")) as archive:
        archive.extractall(folder)
    about = read_model_description(str(folder))
    binaries = folder / "binaries" / "linux64"
    own = f"{about.coSimulation.modelIdentifier}.so"
    [runtime] = (path.name for path in binaries.glob("*.so") if path.name != own)
    for name, text in holding_sources(closed.spec.step, runtime).items():
        (folder / name).write_text(text, encoding="utf-8")
    library, host = binaries / own, folder / "host"
    subprocess.run(
        [*FLAGS, "-shared", "-fPIC", "-o", library, "hold.c", "-ldl"], cwd=folder, check=True
    )
    program = [*FLAGS, f"-I{folder}", f"-I{HERE}", "-rdynamic", "-o", host]
    program += [HERE / "container_lives.c", "-ldl"]
    subprocess.run(program, check=True)
    observed = [str(v.valueReference) for v in about.modelVariables if v.causality == "output"]

    def go(count: int) -> list[int]:
        resources = (folder / "resources").as_uri()
        ended = subprocess.run(
            [host, library, about.guid, resources, str(count), *observed],
            capture_output=True,
            text=True,
            check=False,
            timeout=3000,
        )
        assert ended.returncode == 0, ended.stderr[-4000:]
        return [int(n) for n in ended.stdout.split()]

    return go


def test_random_life_cycles_are_clean(lives: Callable[[int], list[int]]) -> None:
    steps, resets = lives(FEW)
    assert steps > 4 * FEW
    assert resets > FEW // 4


@pytest.mark.soak
def test_ten_thousand_random_life_cycles_are_clean(lives: Callable[[int], list[int]]) -> None:
    steps, resets = lives(ALL)
    assert steps > 8 * ALL
    assert resets > ALL // 4
