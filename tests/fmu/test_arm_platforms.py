"""The native arm on other platforms, with MuJoCo of the same version."""

import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import mujoco
import numpy as np
import pytest
from c_hosts import build_host
from fmpy import read_model_description
from mjcf_models import UF850

from fmu_src.arm.native import export_mjcf
from fmu_src.check.run import check
from hesr_model.errors import ExportError

pytestmark = pytest.mark.ci

STEPS = 400  # of 5 ms
OUTPUTS = 18
AGREEMENT = 1e-9  # of the range of an output

QEMU = shutil.which("qemu-aarch64")
ARM_LIBRARIES = Path("/usr/aarch64-linux-gnu")  # from Debian's libc6-arm64-cross


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    folder = tmp_path_factory.mktemp("platforms")
    try:
        return export_mjcf(
            UF850 / "uf850.xml", folder / "Arm.fmu", table=UF850 / "arm.toml", platforms=["all"]
        )
    except ExportError as error:
        if "pip could not download MuJoCo's wheel" in str(error):
            pytest.skip(f"MuJoCo for other platforms cannot be had here: {error}")
        raise


@pytest.fixture(scope="module")
def unpacked(fmu, tmp_path_factory):
    folder = tmp_path_factory.mktemp("unpacked")
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    return folder


def rows(folder, library, program, *before, resources="file://", steps=STEPS, **environment):
    arguments = (
        folder / "binaries" / library,
        read_model_description(str(folder)).guid,
        f"{resources}{folder}/resources",
    )
    command = [*before, program, *arguments, 3, OUTPUTS, steps]
    ended = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
        env=os.environ | environment,
    )
    assert ended.returncode == 0, ended.stderr
    found = np.array([line.split() for line in ended.stdout.splitlines()], dtype=float)
    assert found.shape == (steps, OUTPUTS)
    return found


@pytest.fixture(scope="module")
def reference(unpacked, tmp_path_factory):
    program = build_host("mjcf_host.c", tmp_path_factory.mktemp("host"))
    found = rows(unpacked, "linux64/uf850.so", program)
    assert np.all(np.ptp(found[:, :3], axis=0) > 0.01)  # the joints have moved
    return found


def assert_agrees(found, reference):
    worst = np.abs(found - reference).max(axis=0) / np.ptp(reference, axis=0)
    assert np.all(worst <= AGREEMENT), worst


def test_windows_matches(unpacked, reference, wine, tmp_path):
    program = build_host("mjcf_host.c", tmp_path, "x86_64-windows-gnu").rename(tmp_path / "h.exe")
    library = "win64/uf850.dll"

    def found():
        return rows(
            unpacked, library, program, wine.program, resources="file:///Z:", **wine.environment
        )

    assert_agrees(found(), reference)
    model = unpacked / "resources" / "model.mjb"
    whole = model.read_bytes()
    model.write_bytes(
        whole[: len(whole) // 2]
    )  # an error of MuJoCo does not end the host here either
    try:
        with pytest.raises(AssertionError, match=r"model\.mjb cannot be loaded"):
            found()
    finally:
        model.write_bytes(whole)


@pytest.mark.skipif(
    QEMU is None or not ARM_LIBRARIES.is_dir(),
    reason="qemu-user and the C library of 64-bit ARM are not installed",
)
def test_linux_on_arm_matches(unpacked, reference, tmp_path):
    program = build_host("mjcf_host.c", tmp_path, "aarch64-linux-gnu.2.17")
    library = "aarch64-linux/uf850.so"
    found = rows(unpacked, library, program, QEMU, "-L", ARM_LIBRARIES, steps=40)
    assert_agrees(found, reference[:40])


def test_macos_finds_mujoco_by_its_install_name(unpacked):
    import lief  # slow

    folder = unpacked / "binaries" / "darwin64"
    fat = lief.MachO.parse(str(folder / "uf850.dylib"))
    place = "mujoco.framework/Versions/A/libmujoco." + mujoco.__version__ + ".dylib"
    fat_of_mujoco = lief.MachO.parse(str(folder / place))
    given = {}
    for k in range(len(fat_of_mujoco)):
        own = fat_of_mujoco.at(k)
        given[own.header.cpu_type] = {symbol.name for symbol in own.exported_symbols}
    assert len(fat) == len(given) == 2  # Intel and Apple
    for k in range(len(fat)):
        part = fat.at(k)
        assert [rpath.path for rpath in part.rpaths] == ["@loader_path"]
        assert f"@rpath/{place}" in [library.name for library in part.libraries]
        wanted = {s.name for s in part.imported_symbols if s.name.startswith(("_mj", "__mj"))}
        assert "_mj_step" in wanted
        assert wanted <= given[part.header.cpu_type]


def test_dependencies_of_each_binary_are_next_to_it(unpacked):
    import lief  # slow

    version = mujoco.__version__
    for library, name in (
        ("linux64/uf850.so", f"libmujoco.so.{version}"),
        ("aarch64-linux/uf850.so", f"libmujoco.so.{version}"),
    ):
        elf = lief.ELF.parse(str(unpacked / "binaries" / library))
        assert name in elf.libraries
        assert (unpacked / "binaries" / library).with_name(name).is_file()
    pe = lief.PE.parse(str(unpacked / "binaries/win64/uf850.dll"))
    assert not any("mujoco" in x.name for x in pe.imports)  # it is loaded by its full name
    dll = lief.PE.parse(str(unpacked / "binaries/win64/mujoco.dll"))
    assert "mj_step" in {entry.name for entry in dll.get_export().entries}


def test_all_validators_pass(fmu):
    assert check(fmu).problems == ()
