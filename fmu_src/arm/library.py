"""MuJoCo's library of the installed version for each platform."""

import subprocess
import zipfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import mujoco

from fmu_src.export.package import Binary
from fmu_src.export.toolchain import host_platform
from hesr_model.errors import ExportError
from hesr_model.support.files import scratch_folder
from hesr_model.support.process import python_command

_PACKAGE = "mujoco-core"
_DOWNLOAD_TIMEOUT = 600.0


@dataclass(frozen=True, kw_only=True)
class _Wheel:
    """Source of a platform's library: platform tags and file pattern of wheels.

    `place` is relative to the FMU's binary. Without linker flags the component looks the library
    up.
    """

    tags: tuple[str, ...]
    pattern: str
    place: str = ""
    flags: tuple[str, ...] = ()


def _linux(processor: str) -> _Wheel:
    tags = tuple(f"manylinux_2_{glibc}_{processor}" for glibc in (27, 28))
    return _Wheel(tags=tags, pattern="libmujoco.so.*", flags=("-Wl,-rpath,$ORIGIN",))


_WHEELS = {
    "linux64": _linux("x86_64"),
    "win64": _Wheel(tags=("win_amd64",), pattern="mujoco.dll"),
    "darwin64": _Wheel(
        tags=("macosx_11_0_arm64",),  # universal binary
        pattern="libmujoco.*.dylib",
        place="mujoco.framework/Versions/A/",  # its install name
        flags=("-Wl,-rpath,@loader_path",),
    ),
    "aarch64-linux": _linux("aarch64"),
}


def library(platform: str) -> Binary:
    """Return MuJoCo for a platform, to compile against and to ship; ExportError if unavailable."""
    wheel = _WHEELS[platform]
    host_files: list[Path] = []
    if platform == host_platform():
        host_files = find_host_libraries()
    if host_files:
        name = host_files[-1].name
        content = host_files[-1].read_bytes()
    else:
        name, content = _download_library(platform, wheel)
    include = (f"-isystem{Path(mujoco.__file__).parent / 'include'}",)
    return Binary(name=wheel.place + name, content=content, flags=include, link=wheel.flags)


def find_host_libraries() -> list[Path]:
    """Return the library files of this machine in MuJoCo's package, normally one."""
    platform = host_platform()
    if platform is None:
        return []
    return sorted(Path(mujoco.__file__).parent.glob(_WHEELS[platform].pattern))


def _download_library(platform: str, wheel: _Wheel) -> tuple[str, bytes]:
    requirement = f"{_PACKAGE}=={version(_PACKAGE)}"
    options: list[str] = []
    for tag in wheel.tags:
        options += ["--platform", tag]
    options += ["--no-deps", "--only-binary", ":all:", "--quiet", "--disable-pip-version-check"]
    with scratch_folder() as folder:
        command = python_command(
            "-m", "pip", "download", requirement, *options, "--dest", str(folder)
        )
        try:
            process = subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=_DOWNLOAD_TIMEOUT
            )
        except subprocess.TimeoutExpired as error:
            raise _download_error(
                platform, requirement, f"no answer within {_DOWNLOAD_TIMEOUT:g} s"
            ) from error
        if process.returncode:
            lines = process.stderr.strip().splitlines() or ["no message"]
            raise _download_error(platform, requirement, lines[-1].rstrip("."))
        [file] = Path(folder).glob("*.whl")
        with zipfile.ZipFile(file) as archive:
            for name in archive.namelist():
                path = Path(name)
                if path.parent.name == "mujoco" and path.match(wheel.pattern):
                    return path.name, archive.read(name)
    raise _download_error(platform, requirement, f"the wheel holds no {wheel.pattern}")


def _download_error(platform: str, requirement: str, reason: str) -> ExportError:
    return ExportError(
        f"platform '{platform}': pip could not download MuJoCo's wheel of {requirement} ({reason})."
    )
