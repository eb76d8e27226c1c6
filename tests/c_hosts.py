"""Hosts in plain C, built for any platform."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fmu_src.export.package import read_c_source
from fmu_src.export.toolchain import TARGETS
from hesr_model.support.compiler import compile_c

HOSTS = Path(__file__).with_name("fmu")
LINUX = ("-target", *TARGETS["linux64"].triples, "-O2")
"""Options of all test programs; for others the compiler rebuilds its own libraries (3 to 15 s)."""


def build_host(name: str, folder: Path, target: str = "x86_64-linux-gnu.2.17") -> Path:
    """Compile a test host in a folder and return the program.

    The target's baseline processor is used, which emulators and valgrind support.
    """
    sources = {"fmi2.h": read_c_source("fmi2.h")}
    sources |= {n: (HOSTS / n).read_text(encoding="utf-8") for n in ("host.h", "motion.h", name)}
    for file, text in sources.items():
        (folder / file).write_text(text, encoding="utf-8")
    program = folder / f"host-{target}"
    # Fused multiply-adds would change the motion of the same formula.
    contract = "-ffp-contract=off"
    flags = ("-target", target, "-std=gnu99", "-O2", contract, "-Wall", "-Wextra", "-Werror")
    compile_c(folder / name, flags, program, _WINDOWS if "windows" in target else ("-ldl",))
    return program


_LIBC = "{compiler}/lib/libc/mingw/stdio/ucrt_"
_WINDOWS = (
    *(flag for flag in TARGETS["win64"].flags if flag != "-Wl,--no-entry"),
    "-Wl,-e,start",
    str(HOSTS / "windows_start.c"),
    *(f"{_LIBC}{name}.c" for name in ("printf", "fprintf")),
    *(f"-lapi-ms-win-crt-{part}-l1-1-0" for part in ("convert", "runtime", "time")),
)


@dataclass(frozen=True)
class Wine:
    """Command for Windows programs: the program and its environment."""

    program: str
    environment: Mapping[str, str]
