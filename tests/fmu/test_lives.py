"""Random life cycles of every FMU of a closed loop, and of others, under sanitizers.

Some of them run here, all 10,000 of each with `-m soak`; so do all life cycles of FMUs whose code
others share.
"""

import json
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import mujoco
import pytest
from adaptive_models import lugre, model, stops
from closed_loop import build

from fmu_src.blocks.controller import velocity
from fmu_src.blocks.trajectory import trajectory
from fmu_src.export.package import write_fmu
from fmu_src.friction.friction_fmu import export_bare, export_fmu
from hesr.extras.adaptive.monitor import export_adaptive
from hesr.extras.drive.drive_fmu import export_drive
from hesr_model.friction.band import Band
from hesr_model.friction.thermal import Thermal
from hesr_model.robots.transmission import Coupling

HERE = Path(__file__).parent
FEW, ALL = 300, 10_000
FLAGS = ("gcc", "-std=c99", "-g", "-O1", "-I.", "-Wno-unknown-pragmas")
MEMORY = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
WRAPPED = ("-DWRAPPED", "-Wl,--wrap=malloc,--wrap=calloc")

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed"),
]

LOOP = ("arm", "trajectory", "body", "friction", "controller", "velocity")
RARE = ("trajectory 3", "velocity 3", "warm 3", "adaptive", "thermal", "band")
"""Only in the soak test."""
KINDS = (*LOOP, "coupled", "drive", "warm", "drive 3", "band 3")
"""FMI 3.0 if the name has a 3. Warm FMUs adapt and follow temperature, thermal ones only follow
temperature."""

GIVEN = {
    "controller": ("sample_time=0.001", "Kv=90", "Ki=900"),
    "trajectory": ("kind=3", "amplitude=1", "swing=0.5"),
}
"""Variables without a start value that an FMU could use."""

BAND = Band(
    floor=0.7, slow=1.3, slow_speed=0.02, rest=0.4, fast=0.5, load=0.05, tail=0.7, envelope=1.0
)
WARM = Thermal(coulomb=0.004, viscous=0.02, resistance=0.5, time_constant=30.0)


@pytest.fixture(scope="session")
def loop(table1, tmp_path_factory):
    return build(tmp_path_factory.mktemp("loop"), table1).fmus


@pytest.fixture(scope="session")
def export(loop, table1, make_law, make_model, tmp_path_factory):
    """Write the FMU of a kind."""
    followed = model(lugre(), stops())
    laws = [replace(make_law(name), band=BAND) for name in ("lugre", "viscous", "elements")]

    def write(kind):
        path = tmp_path_factory.mktemp("kind") / "F.fmu"
        name, fmi = kind.split()[0], 3 if kind.endswith("3") else 2
        if kind in LOOP:
            return getattr(loop, kind)
        if name == "drive":
            inertia = (1.0,) * len(table1.joints)
            return export_drive(table1, path, inertia=inertia, fmi=fmi, bare=True)
        if name == "band":
            return export_bare(make_model(*laws), path, band=True, fmi=fmi)
        if name == "coupled":
            turned = Coupling(((1.0, 0.0, 0.0), (0.25, 1.0, 0.0), (0.0, -0.8, 1.0)))
            bare = [replace(law, band=None) for law in laws]
            return export_bare(make_model(*bare, coupling=turned), path)
        if name in ("warm", "adaptive", "thermal"):
            known = followed if name == "adaptive" else replace(followed, thermal=(WARM,) * 2)
            write = export_fmu if name == "thermal" else export_adaptive
            return write(known, path, fmi=fmi)
        return write_fmu({"trajectory": trajectory, "velocity": velocity}[name](3), path, fmi=fmi)

    return write


@pytest.fixture(
    scope="session",
    params=[*KINDS, *(pytest.param(kind, marks=pytest.mark.soak) for kind in RARE)],
)
def unpacked(request, export, tmp_path_factory):
    """Folder of an FMU's sources, compiler and linker flags, and arguments of hosts."""
    folder = tmp_path_factory.mktemp("unpacked")
    with zipfile.ZipFile(export(request.param)) as archive:
        archive.extractall(folder)
    wheel = Path(mujoco.__file__).parent
    [library] = wheel.glob("libmujoco.so.*")
    linked = (f"-isystem{wheel / 'include'}", str(library), f"-Wl,-rpath,{wheel}")
    name, of_3 = request.param.split()[0], request.param.endswith("3")
    resources = folder / "resources"
    told = (str(resources) if of_3 else resources.as_uri(), *GIVEN.get(name, ()))
    more = (*(linked if name == "arm" else ()), *(("-DFMI=3",) if of_3 else ()))
    return folder / "sources", more, told


def built(sources, host, flags, linked):
    program = sources / Path(host).stem
    command = [*FLAGS, *flags, "-o", program, "all.c", str(HERE / host), *linked, "-lm"]
    subprocess.run(command, cwd=sources, check=True)
    return program


@pytest.fixture(scope="session")
def fuzz(unpacked):
    """Run random life cycles; return the counts of calls."""
    sources, linked, told = unpacked
    program = built(sources, "fuzz.c", (*MEMORY, *WRAPPED), linked)

    def go(lives, fail_every=0):
        command = [program, str(lives), str(fail_every), *told]
        ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=3000)
        assert ended.returncode == 0, ended.stdout[-2000:] + ended.stderr[-4000:]
        assert ended.stderr == ""
        return json.loads(ended.stdout)

    return go


def test_random_life_cycles_are_clean(fuzz):
    counts = fuzz(FEW)
    assert counts["calls"] > 40 * FEW
    assert counts["steps"] > FEW
    assert counts["restored"] > FEW


@pytest.mark.soak
def test_ten_thousand_random_life_cycles_are_clean(fuzz):
    counts = fuzz(ALL)
    assert counts["calls"] > 40 * ALL
    assert counts["steps"] > ALL


@pytest.mark.parametrize("every", [1, 2, 3, 7])
def test_failed_allocations_are_handled(fuzz, every):
    counts = fuzz(FEW // 3, every)
    assert counts["failed_allocations"] > FEW // 3 // every // 2
    # An instance of the arm allocates memory twice.
    assert counts["steps"] > 0 or every < 3


def test_two_threads_may_have_an_instance_each(unpacked):
    sources, linked, told = unpacked
    program = built(sources, "threads.c", ("-fsanitize=thread", "-pthread"), linked)
    ended = subprocess.run(
        [program, *told], capture_output=True, text=True, check=False, timeout=600
    )
    assert ended.returncode == 0, ended.stderr[-4000:]
    assert ended.stdout == "1000 1000\n"
