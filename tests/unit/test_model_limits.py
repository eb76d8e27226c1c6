"""A model file of a stranger takes neither the machine nor the command: bounds, then a child."""

import os
import re
import resource
import time
from pathlib import Path

import pytest

from hesr_model.errors import ConfigError, RobotError
from hesr_model.robots import mjcf, mjcf_source
from hesr_model.robots.mjcf import compile_model, compile_robot, import_engine
from hesr_model.robots.mjcf_source import FILE_ATTRIBUTES

BODY = '<body name="b"><joint name="j"/><geom size="0.1"/>{more}</body>'
FLEX = '<flexcomp name="f" type="grid" count="{}" spacing="0.1 0.1 0.1" radius="0.01" mass="1"/>'
HUGE = {
    "field": ('<hfield name="h" nrow="40000" ncol="40000" size="1 1 1 1"/>', ""),
    "field of floats": ('<hfield name="h" nrow="4e4" ncol=" 40000 " size="1 1 1 1"/>', ""),
    "fields": ('<hfield name="h{k}" nrow="4000" ncol="4000" size="1 1 1 1"/>', ""),
    "texture": ('<texture name="t" type="2d" builtin="flat" width="50000" height="50000"/>', ""),
    "cube": ('<texture name="t" type="cube" builtin="flat" width="20000"/>', ""),
    "flexible": ("", FLEX.format("200 200 200")),
    "flexible line": ("", FLEX.format("99999999999999999999 1 1")),
    "composite": ("", '<composite type="cable" count="1000000 1 1"/>'),
    "copies": ("", '<replicate count="100000"><site/></replicate>'),
    "copies of copies": (
        "",
        '<replicate count="200"><replicate count="200"><site/></replicate></replicate>',
    ),
}
"""Assets and parts of a body of less than 400 bytes each."""


def write(folder: Path, asset: str = "", more: str = "", name: str = "model.xml") -> Path:
    path = folder / name
    assets = "".join(asset.replace("{k}", str(k)) for k in range(5))
    assets = assets if "{k}" in asset else asset
    path.write_text(
        f"<mujoco><asset>{assets}</asset><worldbody>{BODY.format(more=more)}</worldbody></mujoco>",
        encoding="utf-8",
    )
    return path


@pytest.mark.parametrize("place", ["file", "include", "attached"])
@pytest.mark.parametrize("huge", HUGE)
def test_a_small_file_of_huge_sizes_is_refused_before_it_is_compiled(
    huge: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mjcf, "run_in_child", None)
    monkeypatch.setattr(mjcf, "import_engine", None)
    path = write(tmp_path, *HUGE[huge])
    if place == "include":
        path = tmp_path / "outer.xml"
        path.write_text('<mujoco><include file="model.xml"/></mujoco>', encoding="utf-8")
    elif place == "attached":
        path = write(tmp_path, '<model name="m" file="model.xml"/>', name="outer.xml")
    for use in (compile_robot, compile_model):
        with pytest.raises((RobotError, ConfigError), match="can be compiled"):
            use(path)


@pytest.mark.parametrize("part", [300, 100_000])
def test_deep_models_are_refused(part: int, tmp_path: Path) -> None:
    """Files may be deep, or include each other at their innermost elements."""
    names = ["model.xml", "b.xml", "c.xml"]
    for name, included in zip(names, [*names[1:], ""], strict=True):
        inner = f'<include file="{included}"/>' if included else ""
        text = "<body>" * part + inner + "</body>" * part
        (tmp_path / name).write_text(f"<mujoco><worldbody>{text}</worldbody></mujoco>")
    with pytest.raises(RobotError, match="more than 500 elements"):
        compile_robot(tmp_path / "model.xml")


def test_attachments_of_copies_count(tmp_path: Path) -> None:
    write(tmp_path, "", "<site/>" * 100, "inner.xml")
    asset = '<model name="m" file="inner.xml"/>'
    attached = '<replicate count="200"><attach model="m" body="b" prefix="a"/></replicate>'
    with pytest.raises(ConfigError, match="can be compiled"):
        compile_model(write(tmp_path, asset, attached))


@pytest.mark.parametrize("name", ["m", None, "default"])
def test_copies_of_models_named_by_their_file_count(name: str | None, tmp_path: Path) -> None:
    """MuJoCo names an unnamed model as its file does, or by its default."""
    inner = write(tmp_path, "", "<site/>" * 100, "inner.xml")
    own_name = "" if name == "default" else ' model="hand"'
    text = inner.read_text(encoding="utf-8").replace("<mujoco>", f"<mujoco{own_name}>")
    inner.write_text(text, encoding="utf-8")
    attached_name = {"m": "m", None: "hand", "default": "MuJoCo Model"}[name]
    asset = '<model name="m" file="inner.xml"/>'
    if name != "m":
        asset = asset.replace(' name="m"', "")
    body = f'<attach model="{attached_name}" body="b" prefix="a"/>'
    outer = write(tmp_path, asset, f'<replicate count="200">{body}</replicate>')
    with pytest.raises(ConfigError, match="can be compiled"):
        compile_model(outer)
    outer = write(tmp_path, asset, f'<replicate count="20">{body}</replicate>')
    assert compile_model(outer).nsite == 2000


def test_branches_without_attachments_do_not_count(tmp_path: Path) -> None:
    """A hundred branches, and one hand of 200 sites at one of them."""
    write(tmp_path, "", "<site/>" * 200, "hand.xml")
    bodies = [f'<body><geom size="0.1"/><body name="c{k}"><site/></body></body>' for k in range(99)]
    hand = '<body><geom size="0.1"/><attach model="m" body="b" prefix="a"/></body>'
    asset = '<model name="m" file="hand.xml"/>'
    assert compile_model(write(tmp_path, asset, "".join([*bodies, hand]))).nsite == 299


@pytest.mark.parametrize("copies", [2, 15_000])
def test_attachments_in_attachments_are_counted_at_once(
    copies: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counting each copy, or each way from file to file, would take hours."""
    monkeypatch.setattr(mjcf_source, "_MAX_PARTS", 500)
    last = 30
    for k in range(last):
        assets = "".join(f'<model name="m{i}" file="{k + 1}.xml"/>' for i in range(2))
        attached = (
            f'<replicate count="{copies}"><attach model="m0" body="b" prefix="a"/></replicate>'
        )
        write(tmp_path, assets, attached, f"{k}.xml")
    write(tmp_path, name=f"{last}.xml")
    begin = time.process_time()
    with pytest.raises(ConfigError, match="can be compiled"):
        compile_model(tmp_path / "0.xml")
    assert time.process_time() < begin + 5.0


@pytest.mark.parametrize("attribute", FILE_ATTRIBUTES)
@pytest.mark.parametrize("folder", ["", "textures"])
def test_no_attribute_names_a_pipe(attribute: str, folder: str, tmp_path: Path) -> None:
    """Nor a link to one, in whatever folder it is looked for."""
    (tmp_path / "textures").mkdir()
    os.mkfifo(tmp_path / folder / "fifo.png")
    (tmp_path / folder / "link.png").symlink_to(tmp_path / folder / "fifo.png")
    for name in ("fifo.png", "link.png"):
        asset = f'<texture name="t" type="cube" {attribute}="{name}"/>'
        path = write(tmp_path, asset)
        text = path.read_text(encoding="utf-8")
        compiler = '<mujoco><compiler texturedir="textures"/>'
        path.write_text(text.replace("<mujoco>", compiler), encoding="utf-8")
        with pytest.raises(ConfigError, match="which is not a regular file"):
            compile_model(path)


def test_all_attributes_of_files_are_known() -> None:
    """MuJoCo's schema names no others; `content_type` says how to read `file`."""
    schema = import_engine().mj_printSchema(False, False)
    names = set(re.findall(r"\b\w*file\w*\b", schema))
    assert names <= {*FILE_ATTRIBUTES, "modelfiledir"}
    assert set(FILE_ATTRIBUTES) <= names


@pytest.mark.skipif(os.name != "posix", reason="limits are those of POSIX")
@pytest.mark.parametrize("use", [compile_robot, compile_model])
def test_what_the_bounds_miss_ends_with_the_child(
    use: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A field of 12 GB ends by the limit of memory, and this process does not grow."""
    assert callable(use)
    monkeypatch.setattr(mjcf_source, "_MAX_CELLS", 1 << 60)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    asset = '<hfield name="h" nrow="40000" ncol="40000" size="1 1 1 1"/>'
    path = write(tmp_path, asset, '<geom type="hfield" hfield="h"/>')
    with pytest.raises((RobotError, ConfigError), match="cannot be compiled"):
        use(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before + (300 << 10)  # [KiB]


@pytest.mark.skipif(os.name != "posix", reason="limits are those of POSIX")
def test_a_compilation_without_end_ends_in_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compile_model(write(tmp_path))  # the modules are loaded
    monkeypatch.setattr(mjcf, "_SECONDS", 0.2)
    path = write(tmp_path, more='<replicate count="14000"><site/></replicate>')
    begin = time.monotonic()
    with pytest.raises(ConfigError, match=r"no answer within 0\.2 s"):
        compile_model(path)
    assert time.monotonic() < begin + 30.0


def test_answers_of_another_form_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path)
    monkeypatch.setattr(mjcf, "compute_once", lambda _kind, _key, make: make())
    for answer in ({}, {"urdf": 5}, {"urdf": "<robot/>", "gravity": [1, 2]}):
        monkeypatch.setattr(mjcf, "run_in_child", lambda *_, answer=answer, **__: answer)
        with pytest.raises(RobotError, match="invalid answer"):
            compile_robot(path)
