"""Instances are independent, and no call sequence corrupts memory."""

import json
import shutil
import subprocess
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from c_hosts import LINUX

from fmu_src.friction.friction_fmu import export_bare
from hesr_model.support.compiler import compile_c

FUZZ = Path(__file__).with_name("fuzz.c")
FLAGS = ("-std=c99", "-g", "-I.", f"-I{FUZZ.parent}", "-fno-sanitize-recover=all")

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


@pytest.fixture(scope="module")
def mixed(make_law, make_model, tmp_path_factory):
    """An FMU with all features of a friction FMU."""
    names = ("lugre", "viscous", "parfam_exp", "elements", "gaussians", "bare")
    return export_bare(make_model(*map(make_law, names)), tmp_path_factory.mktemp("m") / "F.fmu")


@pytest.fixture
def sources(mixed, tmp_path):
    with zipfile.ZipFile(mixed) as archive:
        members = [name for name in archive.namelist() if name.startswith("sources/")]
        archive.extractall(tmp_path, members)
    return tmp_path / "sources"


def go_through_random_lives(program):
    result = subprocess.run([program], capture_output=True, text=True, check=False, timeout=300)
    assert result.returncode == 0, result.stdout[-2000:] + result.stderr[-4000:]
    assert result.stderr == ""
    counts = json.loads(result.stdout)
    least = {"calls": 400000, "steps": 20000, "derivatives": 10000, "events": 1000,
             "restored": 10000, "refusals": 1000, "errors": 20000, "messages": 20000}  # fmt: skip
    assert {name: n for name, n in counts.items() if n < least.get(name, 0)} == {}


def test_call_sequences_have_no_undefined_behaviour(sources):
    """It ends the program; zig takes half a minute to build a runtime that names its place."""
    flags = (*LINUX, *FLAGS, "-fsanitize=undefined", "-fsanitize-trap=undefined")
    compile_c(sources / "all.c", flags, sources / "fuzz", (str(FUZZ), "-lm"))
    go_through_random_lives(sources / "fuzz")


@pytest.mark.ci
@needs_gcc
def test_call_sequences_have_no_memory_errors(sources):
    """Nor leaks, also with a thousand instances at a time."""
    flags = (*FLAGS, "-Wall", "-Wextra", "-Werror", "-fsanitize=address,undefined")
    command = ["gcc", *flags, "-o", "fuzz", "all.c", str(FUZZ), "-lm"]
    subprocess.run(command, cwd=sources, check=True)
    go_through_random_lives(sources / "fuzz")


@pytest.mark.ci
@needs_gcc
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not installed")
def test_no_uninitialised_memory_is_read(sources):
    """Not covered by the sanitizers; fewer life cycles, since it is fifty times slower."""
    command = ["gcc", *FLAGS[:4], "-O1", "-o", "fuzz", "all.c", str(FUZZ), "-lm"]
    subprocess.run(command, cwd=sources, check=True)
    command = ["valgrind", "--error-exitcode=9", "--leak-check=full", "-q", "./fuzz", "600"]
    result = subprocess.run(command, cwd=sources, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr[-4000:]
    assert json.loads(result.stdout)["steps"] > 5000


def run(fmu, number, steps=400):
    """Torques of an instance that is stepped, differentiated, saved and restored."""
    c = fmu.ready(name=f"instance {number}".encode())
    rows = []
    for k in range(steps):
        speed = 0.3 * (-1) ** ((k + number) // 7) + 0.01 * number
        fmu.set_all(c, {f"dq[{joint}]": speed for joint in range(1, 7)})
        assert fmu.step(c, 1e-3 * k, 1e-3) == 0
        rows += fmu.get(c, "tau[1]", "tau[3]", "tau[4]", "dtau_ddq[1]")
        if k % 50 == number % 50:  # an occasional message
            assert fmu.set(c, dq=float("nan")) == 2
    fmu("FreeInstance", c)
    return rows


def test_instances_run_in_threads(mixed, load):
    """Calls release the GIL, so instances do run concurrently."""
    fmu = load(mixed)
    alone = [run(fmu, number) for number in range(8)]
    fmu.messages.clear()
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(lambda number: run(fmu, number), range(8))) == alone
    assert {m.instance for m in fmu.messages} == {f"instance {number}" for number in range(8)}
    assert len(fmu.messages) == 8 * 8


def test_instances_of_both_types_coexist(mixed, load):
    fmu = load(mixed)
    alone = run(fmu, 3, 50)
    others = [fmu.continuous({"dq[1]": 0.01 * k}) for k in range(50)]
    slopes = [fmu.get(c, "der(z[1])") for c in others]
    assert run(fmu, 3, 50) == alone
    assert [fmu.get(c, "der(z[1])") for c in others] == slopes
    for c in others:
        fmu("FreeInstance", c)
