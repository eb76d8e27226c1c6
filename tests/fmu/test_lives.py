"""Random lives of every FMU of a closed loop, and of a drive, under sanitizers.

A share of the lives is gone through here, all 10,000 of each with `-m soak`.
"""

import json
import shutil
import subprocess
import zipfile
from pathlib import Path

import mujoco
import pytest
from adaptive_models import lugre, model, stops
from closed_loop import build

from fmu_src.drive.drive_fmu import export_drive
from fmu_src.friction.friction_fmu import export_fmu

HERE = Path(__file__).parent
FEW, ALL = 300, 10_000
FLAGS = ("gcc", "-std=c99", "-g", "-O1", "-I.", "-Wno-unknown-pragmas")
MEMORY = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
WRAPPED = ("-DWRAPPED", "-Wl,--wrap=malloc,--wrap=calloc")

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")

KINDS = ("arm", "trajectory", "body", "friction", "controller", "velocity", "drive", "adaptive")


GIVEN = {
    "controller": ("sample_time=0.001", "Kv=90", "Ki=900"),
    "trajectory": ("kind=3", "amplitude=1", "swing=0.5"),
}
"""What has no start value with which an FMU could begin."""


@pytest.fixture(scope="session")
def kinds(table1, tmp_path_factory):
    """All FMUs by kind."""
    folder = tmp_path_factory.mktemp("kinds")
    fmus = build(folder, table1).fmus
    more = {
        "drive": export_drive(table1, folder / "Drive.fmu", inertia=(1.0,) * len(table1.joints)),
        "adaptive": export_fmu(model(lugre(), stops()), folder / "Adaptive.fmu", adaptive=True),
    }
    return {kind: more.get(kind) or getattr(fmus, kind) for kind in KINDS}


@pytest.fixture(scope="session", params=KINDS)
def unpacked(request, kinds, tmp_path_factory):
    """Folder of an FMU's sources, flags for what it is linked to, and what hosts are told."""
    folder = tmp_path_factory.mktemp(request.param)
    with zipfile.ZipFile(kinds[request.param]) as archive:
        archive.extractall(folder)
    wheel = Path(mujoco.__file__).parent
    [library] = wheel.glob("libmujoco.so.*")
    linked = (f"-isystem{wheel / 'include'}", str(library), f"-Wl,-rpath,{wheel}")
    more = linked if request.param == "arm" else ()
    told = ((folder / "resources").as_uri(), *GIVEN.get(request.param, ()))
    return folder / "sources", more, told


def built(sources, host, flags, linked):
    program = sources / Path(host).stem
    command = [*FLAGS, *flags, "-o", program, "all.c", str(HERE / host), *linked, "-lm"]
    subprocess.run(command, cwd=sources, check=True)
    return program


@pytest.fixture(scope="session")
def fuzz(unpacked):
    """Go through random lives; return what has happened."""
    sources, linked, told = unpacked
    program = built(sources, "fuzz.c", (*MEMORY, *WRAPPED), linked)

    def go(lives, fail_every=0):
        command = [program, str(lives), str(fail_every), *told]
        ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=3000)
        assert ended.returncode == 0, ended.stdout[-2000:] + ended.stderr[-4000:]
        assert ended.stderr == ""
        return json.loads(ended.stdout)

    return go


def test_random_lives(fuzz):
    counts = fuzz(FEW)
    assert counts["calls"] > 40 * FEW
    assert counts["steps"] > FEW
    assert counts["restored"] > FEW


@pytest.mark.soak
def test_ten_thousand_random_lives(fuzz):
    counts = fuzz(ALL)
    assert counts["calls"] > 40 * ALL
    assert counts["steps"] > ALL


@pytest.mark.parametrize("every", [1, 2, 3, 7])
def test_allocations_that_fail(fuzz, every):
    counts = fuzz(FEW // 3, every)
    assert counts["failed_allocations"] > FEW // 3 // every // 2
    # An instance of the arm takes memory twice.
    assert counts["steps"] > 0 or every < 3


def test_two_threads_with_an_instance_each(unpacked):
    sources, linked, told = unpacked
    program = built(sources, "threads.c", ("-fsanitize=thread", "-pthread"), linked)
    ended = subprocess.run(
        [program, *told], capture_output=True, text=True, check=False, timeout=600
    )
    assert ended.returncode == 0, ended.stderr[-4000:]
    assert ended.stdout == "1000 1000\n"
