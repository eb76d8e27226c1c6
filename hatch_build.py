"""Build hook: compiled kernels in the wheel, so that fits and simulations compile nothing."""

import atexit
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

MASTER = ("linux64", "aarch64-linux")  # platforms of the master; others have paths in their flags


class Kernels(BuildHookInterface[Any]):
    """Kernels of all machines, for a wheel that is not editable."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the kernels and add them to the wheel."""
        if version == "editable":
            return
        sys.path.insert(0, self.root)
        place = Path(tempfile.mkdtemp(prefix="hesr-kernels-"))
        atexit.register(shutil.rmtree, place, ignore_errors=True)
        from fmu_src.export import toolchain
        from hesr_model.equations import rows
        from hesr_model.support import compiler

        def kept(source: Path, flags: Any, output: Path, last: Any = ()) -> None:
            compile_c(source, flags, output, last)
            names.append(compiler.digest(source, flags, output, last))
            (place / names[-1]).write_bytes(output.read_bytes())

        compile_c, names = compiler.compile_c, list[str]()
        rows.compile_c = toolchain.compile_c = kept
        for host in rows.HOSTS:
            with tempfile.TemporaryDirectory() as folder:
                rows.built(Path(folder), host)
        for name in MASTER:
            with tempfile.TemporaryDirectory() as folder:
                for file in ("master.c", "fmi2.h"):
                    Path(folder, file).write_bytes(Path(self.root, "fmu_src/c", file).read_bytes())
                toolchain.build(Path(folder, "master.c"), "master", toolchain.TARGETS[name])
        inside = "hesr_model/support/binaries"
        build_data["force_include"] |= {f"{place}/{name}": f"{inside}/{name}" for name in names}
