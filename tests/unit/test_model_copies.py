"""MuJoCo compiles copies of a model's files, which a child has compiled before."""

import os
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from hesr_model.errors import ConfigError
from hesr_model.robots import mjcf, mjcf_source
from hesr_model.robots.mjcf import compile_model, compile_spec, import_engine
from hesr_model.robots.mjcf_source import MjcfCopy, MjcfSource

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
BODY = '<body name="b"><joint/><geom type="mesh" mesh="k"/></body>'
MESH = '<asset><mesh name="k" file="{}"/></asset>'


def mjcf_text(*parts: str) -> str:
    return f"<mujoco>{''.join(parts)}</mujoco>"


def world(bodies: str = BODY) -> str:
    return f"<worldbody>{bodies}</worldbody>"


LAYOUTS: dict[str, dict[str, str]] = {
    "next to it": {"arm/m.xml": mjcf_text(MESH.format("k.obj"), world()), "arm/k.obj": ""},
    "above": {"arm/m.xml": mjcf_text(MESH.format("../m/k.obj"), world()), "m/k.obj": ""},
    "round about": {
        "arm/m.xml": mjcf_text(MESH.format("x/../../m/./k.obj"), world()),
        "arm/x/note": "",
        "m/k.obj": "",
    },
    "folder": {
        "arm/m.xml": mjcf_text('<compiler meshdir="../m"/>', MESH.format("k.obj"), world()),
        "m/k.obj": "",
    },
    "stripped": {
        "arm/m.xml": mjcf_text(
            '<compiler meshdir="m" strippath="true"/>', MESH.format("a/b/k.obj"), world()
        ),
        "arm/m/k.obj": "",
    },
    "absolute": {"arm/m.xml": mjcf_text(MESH.format("{here}/m/k.obj"), world()), "m/k.obj": ""},
    "absolute folder": {
        "arm/m.xml": mjcf_text('<compiler meshdir="{here}/m"/>', MESH.format("k.obj"), world()),
        "m/k.obj": "",
    },
    "included": {
        "arm/m.xml": mjcf_text('<include file="sub/a.xml"/>'),
        "arm/sub/a.xml": mjcf_text('<include file="b.xml"/>'),
        "arm/sub/b.xml": mjcf_text(MESH.format("k.obj"), world()),
        "arm/sub/k.obj": "",
    },
    "included absolutely": {
        "arm/m.xml": mjcf_text('<include file="{here}/sub/a.xml"/>'),
        "sub/a.xml": mjcf_text(MESH.format("{here}/m/k.obj"), world()),
        "m/k.obj": "",
    },
    "attached": {
        "arm/m.xml": mjcf_text(
            '<include file="sub/a.xml"/>', world('<attach model="n" body="b" prefix="p"/>')
        ),
        "arm/sub/a.xml": mjcf_text('<asset><model name="n" file="n.xml"/></asset>'),
        "arm/sub/n.xml": mjcf_text(MESH.format("m/k.obj"), world()),
        "arm/sub/m/k.obj": "",
    },
}
"""Files by name; a mesh has no text here."""


def lay(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        content = text or (TETRAHEDRON if path.suffix == ".obj" else "")
        path.write_text(content.replace("{here}", str(folder)), encoding="utf-8")
    return folder / "arm" / "m.xml"


@pytest.mark.parametrize("layout", LAYOUTS)
def test_files_of_every_layout_are_found(layout: str, tmp_path: Path) -> None:
    path = lay(tmp_path, LAYOUTS[layout])
    expected = import_engine().MjModel.from_xml_path(str(path))
    for model in (compile_model(path), compile_spec(path)):
        assert model.nmesh == expected.nmesh == 1
        assert model.body_mass.tolist() == expected.body_mass.tolist()


def test_a_relative_path_and_linked_folders_are_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lay(tmp_path / "true", LAYOUTS["above"])
    (tmp_path / "arm").symlink_to(tmp_path / "true" / "arm")
    (tmp_path / "true" / "m").rename(tmp_path / "m")
    (tmp_path / "true" / "m").symlink_to(tmp_path / "m")
    monkeypatch.chdir(tmp_path)
    assert compile_model(Path("arm/m.xml")).nmesh == 1
    assert compile_model(Path("true/arm/../arm/m.xml")).nmesh == 1


Change = Callable[[Path], None]


def make_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


CHANGES: dict[str, Change] = {
    "text": lambda path: path.write_text(mjcf_text(), encoding="utf-8") and None,
    "removed": Path.unlink,
    "pipe": make_pipe,
}


@pytest.mark.skipif(os.name != "posix", reason="pipes are those of POSIX")
@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", ["arm/m.xml", "arm/sub/n.xml", "arm/sub/m/k.obj"])
@pytest.mark.parametrize("compile_copy", [compile_model, compile_spec])
def test_what_a_child_has_compiled_is_compiled_here(
    compile_copy: Callable[[Path], object],
    name: str,
    change: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A file that changes after the trial is not seen."""
    path = lay(tmp_path, LAYOUTS["attached"])
    require_success = mjcf._require_success

    def change_after_the_trial(path: Path, refusal: str) -> None:
        require_success(path, refusal)
        CHANGES[change](tmp_path / name)

    monkeypatch.setattr(mjcf, "_require_success", change_after_the_trial)
    model = compile_copy(path)
    assert getattr(model, "nmesh", 0) == 1


@pytest.mark.skipif(os.name != "posix", reason="pipes are those of POSIX")
@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", ["arm/m.xml", "arm/sub/n.xml", "arm/sub/m/k.obj"])
def test_what_was_bounded_is_copied(
    name: str, change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A text that changes after it was read is not read again; a mesh is no pipe by then."""
    path = lay(tmp_path, LAYOUTS["attached"])
    copy_to = MjcfSource.copy_to

    def change_before_the_copy(source: MjcfSource, folder: Path) -> MjcfCopy:
        CHANGES[change](tmp_path / name)
        return copy_to(source, folder)

    monkeypatch.setattr(MjcfSource, "copy_to", change_before_the_copy)
    if name.endswith(".xml"):
        assert compile_model(path).nmesh == 1
        return
    with pytest.raises(ConfigError, match=r"k\.obj|compiled"):
        compile_model(path)


def test_no_more_than_a_limit_is_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = lay(tmp_path, LAYOUTS["above"])
    monkeypatch.setattr(mjcf_source, "_MAX_FILE_BYTES", 20)
    with pytest.raises(ConfigError, match="larger models"):
        compile_model(path)


@pytest.mark.parametrize("name", ["../" * 60 + "etc/hostname", "/../.." + "/etc/hostname"])
def test_no_copy_leaves_its_folder(name: str, tmp_path: Path) -> None:
    path = lay(tmp_path, {"arm/m.xml": mjcf_text(MESH.format(name), world())})
    with pytest.raises(ConfigError, match=r"root|compiled"):
        compile_model(path)


def test_refusals_name_the_files_of_the_user(tmp_path: Path) -> None:
    path = lay(tmp_path, {"arm/m.xml": mjcf_text(MESH.format("{here}/m/k.obj"), world())})
    with pytest.raises(ConfigError) as caught:
        compile_model(path)
    assert f"{tmp_path}/m/k.obj" in str(caught.value)
    assert "hesr-" not in str(caught.value).replace(str(tmp_path), "")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_file_is_parsed_once(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = lay(tmp_path, LAYOUTS[layout])
    parsed: list[bytes] = []
    parse = ElementTree.fromstring

    def count(data: bytes) -> ElementTree.Element:
        parsed.append(data)
        return parse(data)

    monkeypatch.setattr(mjcf_source.ElementTree, "fromstring", count)
    compile_model(path)
    assert len(parsed) == sum(name.endswith(".xml") for name in LAYOUTS[layout])


HUGE = '<worldbody><replicate count="100000"><site/></replicate></worldbody>'


@pytest.mark.parametrize(
    "files",
    [
        {"arm/sub/a.xml": mjcf_text('<include file="b.xml"/>'), "arm/sub/b.xml": mjcf_text(HUGE)},
        {
            "arm/sub/a.xml": mjcf_text('<asset><model name="n" file="n.xml"/></asset>'),
            "arm/sub/n.xml": mjcf_text(HUGE),
        },
    ],
)
def test_files_next_to_an_include_are_bounded(
    files: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo looks there as well, so that they count before a child is asked."""
    monkeypatch.setattr(mjcf, "run_in_child", None)
    main = {"arm/m.xml": mjcf_text('<include file="sub/a.xml"/>')}
    with pytest.raises(ConfigError, match="can be compiled"):
        compile_model(lay(tmp_path, main | files))
