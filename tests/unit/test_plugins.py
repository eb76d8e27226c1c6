"""The reader of entry points."""

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec

import pytest
from plugin_packages import InstallPlugin

from hesr_model.errors import ConfigError
from hesr_model.support import plugins


class NoExtras(MetaPathFinder):
    """Finder that makes `hesr.extras` impossible to import."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name.startswith("hesr.extras"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None


@pytest.fixture
def _no_extras(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("hesr.extras")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [NoExtras(), *sys.meta_path])


def test_own_plugins_come_first_then_others_sorted(install_plugin: InstallPlugin) -> None:
    own = plugins.names("hesr.exports")
    assert {"fmu", "drive", "modelica"} <= set(own)
    assert list(own) == sorted(own)
    install_plugin("hesr.exports", b="no_such_module:write", a="no_such_module:write")
    assert plugins.names("hesr.exports") == (*own, "a", "b")


def test_names_import_nothing(install_plugin: InstallPlugin) -> None:
    install_plugin("hesr.exports", toy="toy_module_of_exports:write")
    assert "toy" in plugins.names("hesr.exports")
    assert "toy_module_of_exports" not in sys.modules


def test_a_broken_plugin_is_refused_by_name_and_package(install_plugin: InstallPlugin) -> None:
    install_plugin("hesr.exports", toy="no_such_module:write")
    with pytest.raises(ConfigError) as caught:
        plugins.load("hesr.exports")["toy"].load()
    assert "'toy' of the package 'my-plugins' cannot" in str(caught.value)


def test_duplicate_names_are_refused(install_plugin: InstallPlugin) -> None:
    install_plugin("hesr.exports", fmu="os:sep")
    with pytest.raises(ConfigError) as caught:
        plugins.names("hesr.exports")
    assert "'fmu' of the package 'my-plugins' has" in str(caught.value)


@pytest.mark.parametrize("group", plugins.GROUPS)
def test_own_plugins_can_be_loaded(group: str) -> None:
    for plugin in plugins.load(group).values():
        assert plugin.is_built_in
        plugin.load()


@pytest.mark.usefixtures("_no_extras")
def test_absent_extras_are_not_listed() -> None:
    assert {"fmu", "plant"} <= set(plugins.names("hesr.exports"))
    assert not {"drive", "modelica", "mjcf", "c"} & set(plugins.names("hesr.exports"))
    assert not any("extras" in p.entry.value for p in plugins.load("hesr.laws").values())
