"""Build hook: compiled kernels in the wheel, so that fits and simulations compile nothing."""

import atexit
import os
import platform
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

MASTER = ("linux64", "aarch64-linux")  # platforms of the master; others have paths in their flags


INSIDE = "hesr_model/support/binaries"


class Kernels(BuildHookInterface[Any]):
    """Kernels of all machines in a wheel, that of this machine in a checkout."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the kernels and add them to the wheel, or to the folder of an editable one."""
        sys.path.insert(0, self.root)
        place = Path(tempfile.mkdtemp(prefix="hesr-kernels-"))
        atexit.register(shutil.rmtree, place, ignore_errors=True)
        from fmu_src.export import toolchain
        from hesr_model.equations import rows
        from hesr_model.support import compiler

        editable, here = version == "editable", (sys.platform, platform.machine())
        if editable:
            place = Path(self.root, INSIDE)
            place.mkdir(exist_ok=True)

        def kept(source: Path, flags: Any, output: Path, last: Any = ()) -> None:
            compile_c(source, flags, output, last)
            names.append(compiler.digest(source, flags, output, last))
            # Whole at once: another installation of the same checkout may read it.
            part = place / f"{names[-1]}.{os.getpid()}"
            part.write_bytes(output.read_bytes())
            part.replace(place / names[-1])

        compile_c, names = compiler.compile_c, list[str]()
        rows.compile_c = toolchain.compile_c = kept
        for host in {here} & rows.HOSTS.keys() if editable else rows.HOSTS:
            with tempfile.TemporaryDirectory() as folder:
                rows.compile_rows(Path(folder), host)
        if editable:
            return
        for name in MASTER:
            with tempfile.TemporaryDirectory() as folder:
                for file in ("master.c", "fmi2.h"):
                    Path(folder, file).write_bytes(Path(self.root, "fmu_src/c", file).read_bytes())
                toolchain.build(Path(folder, "master.c"), "master", toolchain.TARGETS[name])
        build_data["force_include"] |= {f"{place}/{name}": f"{INSIDE}/{name}" for name in names}
