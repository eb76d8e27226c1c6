"""The wheel and the source archive, built as for a release."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SWITCHES = ("--no-isolation", "--skip-dependency-check")


def built(source: Path, folder: Path, *switches: str, cache: Path | None = None) -> list[Path]:
    command = [sys.executable, "-m", "build", *SWITCHES, *switches, "--outdir", str(folder)]
    own = {} if cache is None else {"XDG_CACHE_HOME": str(cache)}
    environment = os.environ | {"SOURCE_DATE_EPOCH": "1760000000", **own}
    subprocess.run([*command, str(source)], check=True, env=environment, stdout=subprocess.DEVNULL)
    return sorted(folder.iterdir())


FIRST = """
import sys
import hesr
from hesr_model.equations.rows import library
from hesr_model.support import compiler
from fmu_src.run.native import write_library
from pathlib import Path
assert compiler.__file__.startswith(sys.argv[1]), compiler.__file__
library()
assert write_library(Path(sys.argv[2])) is not None
assert len(list(compiler.PREBUILT.iterdir())) == 7
"""


def require_prebuilt(wheel: Path, folder: Path) -> None:
    """Check that an installed wheel loads its kernels without compiling."""
    site, cache = folder / "site", folder / "cache"
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(site)
    cache.mkdir()
    environment = os.environ | {"PYTHONPATH": str(site), "XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-c", FIRST, str(site), str(folder)]
    subprocess.run(command, check=True, env=environment, cwd=folder)
    assert not list(cache.rglob("binaries"))


@pytest.mark.ci
def test_a_release_is_complete_and_reproducible(tmp_path: Path) -> None:
    pytest.importorskip("hatchling", reason="hatchling is not installed")
    (archive,) = built(ROOT, tmp_path / "source", "--sdist")
    wheels, new = [], tmp_path / "new_cache"
    new.mkdir()
    for k in range(2):
        with tarfile.open(archive) as packed:
            # Python 3.11.2 has no filters, and 3.13 warns where none is chosen.
            packed.extraction_filter = getattr(tarfile, "data_filter", lambda member, _: member)
            packed.extractall(tmp_path / f"unpacked{k}")
        (source,) = (tmp_path / f"unpacked{k}").iterdir()
        # The second one has no compiled results of others, as on another machine.
        wheels += built(source, tmp_path / f"wheel{k}", "--wheel", cache=new if k else None)
    assert wheels[0].read_bytes() == wheels[1].read_bytes()
    with zipfile.ZipFile(wheels[0]) as wheel:
        names = set(wheel.namelist())
    assert not [name for name in names if "test_" in name or name.startswith("tests/")]
    needed = ("hesr/py.typed", "hesr/__init__.pyi", "hesr/llms.txt", "fmu_src/c/component.h")
    assert names.issuperset(needed)
    assert any(name.startswith("hesr_model/_models/uf850/") for name in names)
    require_prebuilt(wheels[0], tmp_path)
    twine = [sys.executable, "-m", "twine", "check", "--strict", str(archive), str(wheels[0])]
    subprocess.run(twine, check=True, stdout=subprocess.DEVNULL)
