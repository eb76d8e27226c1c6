"""Repeated and concurrent exports of a model: same bytes, built once."""

import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from c_hosts import LINUX

from fmu_src.export import cache
from fmu_src.export.cache import export_with_cache
from hesr.cli import main
from hesr_model.equations.rows import library
from hesr_model.support.compiler import compile_c

pytestmark = pytest.mark.ci


def hesr(*arguments: object) -> None:
    """Run the command line in this process, which it exits."""
    sys.argv = ["hesr", *map(str, arguments)]
    main()


def entries(cache: Path, kind: str) -> set[Path]:
    return {p for p in (cache / kind).rglob("*") if p.is_file() and p.name != "lock"}


@pytest.fixture
def model(table1, tmp_path):
    path = tmp_path / "model.json"
    table1.write(path)
    return path


def test_concurrent_exports_equal_sequential_ones(model, tmp_path, empty_cache):
    library.__wrapped__()  # an installed checkout has it, and compiles nothing
    others = entries(empty_cache, "binaries")
    models, expected = [], []
    for k in range(4):
        data = json.loads(model.read_text())
        data["joints"][0]["coefficients"]["c_0"]["value"] = -2.0 - 0.1 * k
        models.append(tmp_path / f"{k}.json")
        models[k].write_text(json.dumps(data))
    # Separate processes that have finished their imports before they start.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        ["hesr.cli", "hesr_model.friction.model", "fmu_src.friction.friction_fmu"]
    )
    outputs = [tmp_path / f"F{k}.fmu" for k in range(20)]
    processes = [
        context.Process(target=hesr, args=("export", models[k % 4], "-o", output))
        for k, output in enumerate(outputs)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0] * 20
    # Libraries of the two default platforms and a module for all.
    assert len(entries(empty_cache, "binaries") - others) == 3
    assert len(entries(empty_cache, "fmus")) == 4

    for k in range(4):
        for entry in (empty_cache / "binaries").rglob("*"):
            if entry.is_file():
                entry.unlink()
        output = tmp_path / "one.fmu"
        process = context.Process(target=hesr, args=("export", models[k], "-o", output))
        process.start()
        process.join()
        expected.append(output.read_bytes())
    assert len(set(expected)) == 4
    assert [output.read_bytes() for output in outputs] == expected * 5


def test_files_that_python_compiles_do_not_disturb_an_export(tmp_path, monkeypatch):
    """Another process writes a file of byte code under a name that soon vanishes."""
    (tmp_path / "module.py").write_text("x = 1")
    monkeypatch.setattr(cache, "_HASHED_FOLDERS", (tmp_path,))
    expected = cache.software.__wrapped__()
    (tmp_path / "__pycache__").mkdir()
    (tmp_path / "__pycache__" / "module.cpython-311.pyc.139641").symlink_to(tmp_path / "gone")
    assert cache.software.__wrapped__() == expected
    (tmp_path / "module.py").write_text("x = 2")
    assert cache.software.__wrapped__() != expected


def test_only_a_repeated_export_is_a_copy(model, tmp_path, empty_cache, monkeypatch):
    written = []

    def export(name="F.fmu", **options):
        def write():
            written.append(name)
            (tmp_path / name).write_bytes(f"number {len(written)}".encode())

        export_with_cache(model, options, tmp_path / name, write)
        return (tmp_path / name).read_bytes()

    first = export(platforms=["linux64"])
    assert export("G.fmu", platforms=["linux64"]) == first
    assert written == ["F.fmu"]
    others = {
        export(platforms=["win64"]),
        export(platforms=["linux64"], motor={"inertia": "1"}),
        export("F.zip", platforms=["linux64"]),
    }
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    others.add(export(platforms=["linux64"]))
    monkeypatch.delenv("SOURCE_DATE_EPOCH")
    assert len({first, *others}) == 5
    model.write_text(model.read_text() + "\n")
    assert export(platforms=["linux64"]) not in {first, *others}


def test_exports_of_laws_of_other_packages_are_not_cached(
    model, tmp_path, empty_cache, install_plugin
):
    install_plugin("hesr.laws", own="my_law")
    times = []
    for _ in range(2):
        export_with_cache(model, {}, tmp_path / "F.fmu", lambda: times.append(1))
    assert len(times) == 2


@pytest.mark.parametrize("home", [None, "/proc"])
def test_an_unwritable_home_does_not_affect_the_compiler(home, tmp_path, empty_cache, monkeypatch):
    private = tmp_path / f"hesr-cache-{os.getuid()}"
    private.mkdir(mode=0o700)
    (private / "zig").symlink_to((empty_cache / "zig").resolve())
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.delenv("HOME")
    if home:
        monkeypatch.setenv("HOME", home)
    (tmp_path / "main.c").write_text("int main(void) { return 7; }\n")
    compile_c(tmp_path / "main.c", LINUX, tmp_path / "main")
    assert subprocess.run([tmp_path / "main"], check=False).returncode == 7
    assert len([p for p in (private / "binaries").rglob("*") if p.name == "lock"]) == 1
