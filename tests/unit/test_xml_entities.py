"""Entities in robots and workbooks of others expand to little, and open no file."""

import time
import tracemalloc
import zipfile
from pathlib import Path

import pytest

from hesr_model.errors import HesrError
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.readers.formats import find_format
from hesr_model.robots import mjcf
from hesr_model.robots.mjcf import compile_model, compile_robot
from hesr_model.robots.urdf import read_urdf

BOMB = '<!ENTITY a0 "ha">' + "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 11))
QUADRATIC = f'<!ENTITY a10 "{"x" * 100_000}">'
LINK = '<link name="{}"/>'


def read_mjcf(path: Path) -> None:
    compile_robot(path)


def read_mjcf_of_arm(path: Path) -> None:
    compile_model(path)


def read_included(path: Path) -> None:
    outer = path.with_name("outer.xml")
    outer.write_text('<mujoco><include file="a.xml"/></mujoco>', encoding="utf-8")
    compile_model(outer)


def read_robot(path: Path) -> None:
    read_urdf(path, path.read_bytes())


READERS = [read_mjcf, read_mjcf_of_arm, read_included, read_robot]


def write(folder: Path, entities: str, content: str) -> Path:
    path = folder / "a.xml"
    text = f"<!DOCTYPE r [{entities}]><robot><material name='{content}'/>{content}</robot>"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(
    ("entities", "content"), [(BOMB, "&a10;"), (QUADRATIC, "&a10;" * 5000)], ids=["bomb", "square"]
)
def test_entities_take_neither_time_nor_memory(
    read: object, entities: str, content: str, tmp_path: Path
) -> None:
    assert callable(read)
    path = write(tmp_path, entities, content)
    begin = time.process_time()
    tracemalloc.start()
    try:
        with pytest.raises(HesrError):
            read(path)
        assert tracemalloc.get_traced_memory()[1] < 100 << 20
    finally:
        tracemalloc.stop()
    assert time.process_time() < begin + 5.0


@pytest.mark.parametrize("read", READERS)
def test_external_entities_open_no_file(read: object, tmp_path: Path) -> None:
    assert callable(read)
    secret = tmp_path / "id_rsa"
    secret.write_text("secret", encoding="utf-8")
    path = write(tmp_path, f'<!ENTITY a SYSTEM "{secret.as_uri()}">', "&a;")
    with pytest.raises(HesrError) as caught:
        read(path)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("read", READERS[:3])
@pytest.mark.parametrize(
    ("before", "inside"),
    [
        ('<!DOCTYPE m [<!ENTITY a "><mujoco>{huge}</mujoco>">]>', ""),
        ("", '<text data="&b;"/>{huge}'),
        ("", '<text data="<!--"/>{huge}<text data="-->"/>'),
        ("", "<!-- -- -->{huge}<!-- -- -->"),
        ("", "<![CDATA[<!--]]>{huge}<![CDATA[-->]]>"),
        ("", "<?a <!-- ?>{huge}<?a --> ?>"),
    ],
)
def test_nothing_hides_elements_from_bounds(
    read: object, before: str, inside: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo and XML differ in what comments, entities and document types end at."""
    assert callable(read)
    monkeypatch.setattr(mjcf, "run_in_child", None)
    huge = '<worldbody><replicate count="100000"><site/></replicate></worldbody>'
    text = f"{before}<mujoco>{inside}</mujoco>".replace("{huge}", huge)
    (tmp_path / "a.xml").write_text(text, encoding="utf-8")
    with pytest.raises(HesrError):
        read(tmp_path / "a.xml")


@pytest.mark.parametrize("piece", ["<!--", "<a b='<", "<?", "<![CDATA[", "<", "<!", "-->", '"<'])
def test_broken_markup_takes_no_time(piece: str, tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text("<mujoco>" + piece * 200_000, encoding="utf-8")
    begin = time.process_time()
    with pytest.raises(HesrError):
        compile_model(path)
    assert time.process_time() < begin + 2.0


def test_dashes_in_comments_are_permitted(tmp_path: Path) -> None:
    """Many models have them, and MuJoCo reads these."""
    body = '<body name="b"><joint name="-->"/><geom size="0.1"/></body>'
    text = f"<!-- -- a -- --><mujoco><!----- b -----><worldbody>{body}</worldbody></mujoco>"
    (tmp_path / "a.xml").write_text(text, encoding="utf-8")
    assert compile_model(tmp_path / "a.xml").nbody == 2
    assert compile_robot(tmp_path / "a.xml")["check"]["joints"] == ["-->"]


def test_entities_of_a_workbook_take_neither_time_nor_memory(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="needs hesr[formats]")
    plain = tmp_path / "plain.xlsx"
    book = openpyxl.Workbook()
    for row in (["t"], [0.0], [1.0]):
        book.active.append(row)
    book.save(plain)
    path = tmp_path / "bomb.xlsx"
    with zipfile.ZipFile(plain) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            data = source.read(name).decode()
            if "sheet1" in name:
                head, mark, rest = data.partition("<worksheet")
                data = f"{head}<!DOCTYPE w [{BOMB}]>{mark}{rest}".replace(">t<", ">&a10;<")
                data = data.replace("<v>1</v>", "<v>&a10;</v>")
            target.writestr(name, data)
    file_format = find_format(path)
    assert file_format.table is not None
    begin = time.monotonic()
    with pytest.raises(HesrError):
        file_format.table(path, LogFormat()).numbers(["t"])
    assert time.monotonic() < begin + 60.0
