"""Plug-ins: the entry points of HESR, in the same groups, and of other packages."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, distributions
from importlib.util import find_spec
from typing import Any

from hesr_model.errors import ConfigError

GROUPS = {
    "hesr.laws": "law",  # module that registers the estimator of this name
    "hesr.logs": "log format",  # FileFormat
    "hesr.exports": "export format",  # Exporter of a friction model
    "hesr.exports.arm": "arm format",  # Exporter of an MJCF or a URDF
    "hesr.exports.system": "system format",  # Exporter of a system
    "hesr.exports.results": "results format",  # Exporter of results or a study
    "hesr.checks": "check",  # function (description, contents, folder) of an FMU
    "hesr.tests": "test",  # function of laws and logs; `properties` one of subjects
    "hesr.systems": "system format",  # reader and checks of files of systems
    "hesr.studies": "part of a study",  # function, see the calls in `cosim`
    "hesr.sheets": "sheet",  # function of the result of a test: HTML for pages
    "hesr.refinements": "refinement",  # function of a fitted law and its records
    "hesr.jobs": "job",  # object with `key`, `read` and `run`
    "hesr.motions": "planner",  # function (robot, output, *, purpose, time, ..)
    "hesr.setpoints": "motion format",  # function (path, motion, joints), and its suffix
    "hesr.findings": "format of findings",  # writer (path, reports)
    "hesr.reports": "report",  # writer of a suffix or view
    "hesr.chapters": "chapter",  # Chapter of a run's report
    "hesr.objects": "method",  # function of an object, for its methods to files and figures
    "hesr.commands": "command",  # workflow function of a verb
}  # Groups of entry points, with the word for one plug-in in messages
_OWN_PACKAGE = "hesr"


@dataclass(frozen=True, kw_only=True)
class Plugin:
    """An entry point, not imported yet."""

    name: str
    package: str
    entry: EntryPoint

    @property
    def is_built_in(self) -> bool:
        """Whether HESR itself registers it."""
        return self.package == _OWN_PACKAGE

    @property
    def label(self) -> str:
        """Description for messages."""
        return f"{GROUPS[self.entry.group]} '{self.name}' of the package '{self.package}'"

    def load(self) -> Any:
        """Import and return the object; raises ConfigError if another package fails."""
        try:
            return self.entry.load()
        except Exception as error:
            if self.is_built_in:
                raise
            raise ConfigError(
                f"{self.label} cannot be loaded ({type(error).__name__}: {error}); repair or "
                "uninstall the package."
            ) from error


def load(group: str) -> Mapping[str, Plugin]:
    """Return the plug-ins of a group by name, HESR's own first; raises ConfigError."""
    entry_points = [plugin for plugin in _installed(tuple(sys.path)) if plugin.entry.group == group]
    plugins: dict[str, Plugin] = {}
    for plugin in sorted(
        entry_points, key=lambda plugin: (not plugin.is_built_in, plugin.name, plugin.package)
    ):
        if plugin.is_built_in and not _exists(plugin.entry.module):
            continue
        other_plugin = plugins.get(plugin.name)
        if other_plugin:
            raise ConfigError(
                f"{plugin.label} has the name of one of '{other_plugin.package}'; names must "
                "differ."
            )
        plugins[plugin.name] = plugin
    return plugins


@cache
def _installed(_path: tuple[str, ...]) -> list[Plugin]:
    """Return all plug-ins; only their metadata are parsed."""
    entries_by_package: dict[str, list[EntryPoint]] = {}
    for distribution in distributions():
        if "[hesr." in (distribution.read_text("entry_points.txt") or ""):
            entries_by_package.setdefault(distribution.name, list(distribution.entry_points))
    plugins: list[Plugin] = []
    for package, entries in entries_by_package.items():
        plugins += [Plugin(name=entry.name, package=package, entry=entry) for entry in entries]
    return plugins


def names(group: str) -> tuple[str, ...]:
    """Return the names of the plug-ins of a group."""
    return tuple(load(group))


def find(group: str, name: str) -> Any:
    """Import and return a plug-in's object, or raise ConfigError."""
    plugins = load(group)
    if name not in plugins:
        reason = "not installed"
        if plugins:
            reason = f"unknown; known are {', '.join(plugins)}"
        raise ConfigError(f"{GROUPS[group]} '{name}' is {reason}.")
    return plugins[name].load()


def _exists(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ImportError:  # a parent package is absent
        return False
