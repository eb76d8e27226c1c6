"""Packages with plug-ins, as installed in a folder of `sys.path`."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol


class InstallPlugin(Protocol):
    """Install a package with entry points of one group."""

    def __call__(self, group: str, **points: str) -> None: ...


def lay_package(
    site: Path,
    groups: Mapping[str, Mapping[str, str]],
    *,
    name: str = "my-plugins",
    modules: Mapping[str, str] | None = None,
) -> Path:
    """Write modules and metadata of a package with entry points (value by name by group)."""
    metadata = site / f"{name.replace('-', '_')}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = []
    for group, points in groups.items():
        lines += [f"[{group}]", *(f"{key} = {value}" for key, value in points.items()), ""]
    (metadata / "entry_points.txt").write_text("\n".join(lines))
    for module, text in (modules or {}).items():
        (site / f"{module}.py").write_text(text, encoding="utf-8")
    return site


def run_python(
    site: Path, *arguments: object, cwd: Path, columns: int = 120
) -> subprocess.CompletedProcess[str]:
    """Run Python with the packages of a folder installed."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        check=False,
        env=environment | {"PYTHONPATH": str(site), "COLUMNS": str(columns)},
    )
