"""Texts that are small and grow in a parser, in each kind of file: refused, in bounded time.

Each bomb is the whole file, or a value within a valid one, so that later code is reached as well.
"""

import resource
import shutil
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from logs_and_robots import TWO
from readers import READERS

from hesr_model.errors import HesrError
from hesr_model.logs.robot_log import Log

pytestmark = pytest.mark.ci

MOST_MORE = 1 << 30  # bytes of memory that a bomb may take
SECRET = "the text of a private key"
DEEP = 100_000

Bombs = dict[str, str]

JSON_VALUES: Bombs = {
    "open lists": "[" * DEEP,
    "nested lists": "[" * DEEP + "]" * DEEP,
    "open objects": '{"a":' * DEEP,
    "nested objects": '{"a":' * DEEP + "1" + "}" * DEEP,
    "an integer": "9" * 1_000_000,
    "a negative integer": "-" + "9" * 4000,
    "an exponent": "1e999999999",
    "digits of a fraction": "0." + "1" * 1_000_000,
    "a number that is none": "[NaN, Infinity, -Infinity]",
    "half a character": '"\\ud800"',
    "a long text": '"' + "x" * 2_000_000 + '"',
    "many numbers": "[" + "0," * 2_000_000 + "0]",
    "equal keys": "{" + '"a":0,' * 500_000 + '"a":0}',
}

TOML_VALUES: Bombs = {
    "open lists": "[" * DEEP,
    "nested lists": "[" * DEEP + "]" * DEEP,
    "nested tables": "{a=" * DEEP + "1" + "}" * DEEP,
    "an integer": "9" * 1_000_000,
    "an integer to base 16": "0x" + "f" * 1_000_000,
    "an integer with gaps": "9_" * 100_000 + "9",
    "an exponent": "1e999999999",
    "a number that is none": "[nan, inf, -inf]",
    "a date": "9999-12-31T23:59:59.999999999999+23:59",
    "a long text": "'" + "x" * 2_000_000 + "'",
    "many numbers": "[" + "0," * 200_000 + "0]",
}

TOML_FILES: Bombs = {
    "a dotted key": "a." * DEEP + "a = 1\n",
    "a dotted table": "[" + "a." * DEEP + "a]\n",
    "quoted dots": '["a".' + '"b".' * DEEP + '"c"]\n',
    "deeper tables": "".join(f"[{'.'.join('a' * k)}]\n" for k in range(1, 400)),
    "many tables": "[[a]]\n" * 20_000,
    "many keys": "".join(f"k{k} = 1\n" for k in range(30_000)),
    "a comment": "#" + "x" * 2_000_000,
}

EXPANSION = '<!ENTITY a0 "ha">' + "".join(
    f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12)
)
DOCUMENT_TYPES: Bombs = {
    "a billion laughs": f"<!DOCTYPE r [{EXPANSION}]>",
    "a long entity": f'<!DOCTYPE r [<!ENTITY a11 "{"x" * 200_000}">]>',
    "a file": '<!DOCTYPE r [<!ENTITY a11 SYSTEM "file://SECRET">]>',
    "a file as a type": '<!DOCTYPE r SYSTEM "file://SECRET">',
    "a parameter": '<!DOCTYPE r [<!ENTITY % p SYSTEM "file://SECRET">%p;<!ENTITY a11 "x">]>',
    "an entity of itself": '<!DOCTYPE r [<!ENTITY a11 "&a11;">]>',
    "values of attributes": "<!DOCTYPE r [<!ATTLIST r "
    + " ".join(f'a{k} CDATA "x"' for k in range(20_000))
    + "> ]>",
}

XML_FILES: Bombs = {
    "open elements": "<a>" * DEEP,
    "nested elements": "<a>" * DEEP + "</a>" * DEEP,
    "many attributes": "<r " + " ".join(f'a{k}="1"' for k in range(200_000)) + "/>",
    "many namespaces": "<r>" + "".join(f'<a xmlns:n{k}="u{k}"/>' for k in range(50_000)) + "</r>",
    "nested namespaces": "".join(f'<a xmlns:n{k}="u{k}">' for k in range(5000)),
    "a long name": f"<{'r' * 5_000_000}/>",
    "an included file": '<r xmlns:xi="http://www.w3.org/2001/XInclude">'
    '<xi:include href="file://SECRET" parse="text"/></r>',
    "a comment": f"<r><!--{'x' * 5_000_000}--></r>",
    "references to characters": f"<r>{'&#120;' * 500_000}</r>",
}


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    path = tmp_path / "secret"
    path.write_text(SECRET, encoding="utf-8")
    return path


def survive(read: Callable[[Path], object], path: Path, bomb: str) -> None:
    """Check that a file is read or refused in one sentence that tells no secret."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    sentence = ""
    try:
        read(path)
    except HesrError as refusal:
        sentence = str(refusal)
    except BaseException as error:
        raise AssertionError(bomb) from error
    assert "\n" not in sentence, bomb
    assert SECRET not in sentence, bomb
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    assert used < before + MOST_MORE, bomb


def list_texts(content: str, suffix: str, secret: Path) -> Iterator[tuple[str, str]]:
    """Yield names and texts of bombs for a kind of file with a valid content."""
    if suffix == ".json":
        yield from JSON_VALUES.items()
        for name, value in JSON_VALUES.items():
            yield f"{name}, within", content.replace("{", f'{{"hostile": {value},', 1)
            yield f"{name}, as format", content.replace('"format": "', f'"format": {value}, "', 1)
    elif suffix == ".toml":
        yield from TOML_FILES.items()
        for name, text in TOML_FILES.items():
            yield f"{name}, behind", f"{content}\n{text}"
        for name, value in TOML_VALUES.items():
            yield name, f"hostile = {value}\n"
            yield f"{name}, within", f"hostile = {value}\n{content}"
            yield f"{name}, as name", f"name = {value}\n"
    else:
        for name, text in XML_FILES.items():
            yield name, text.replace("SECRET", str(secret))
        head, mark, rest = content.partition("?>")
        body = rest if mark else content
        for name, kind in DOCUMENT_TYPES.items():
            document_type = kind.replace("SECRET", str(secret))
            yield name, f"{document_type}<r>&a11;</r>"
            first, quote, others = body.partition('="')
            yield f"{name}, within", f"{head}{mark}{document_type}{first}{quote}&a11;{others}"


GATE = ("robot", "friction model", "urdf", "mjcf")
"""Kinds of files that are tried in every gate: one for each parser."""

TEXTS = [
    pytest.param(name, marks=() if name in GATE else pytest.mark.nightly("hostile"))
    for name, reader in READERS.items()
    if reader.suffix in (".json", ".toml", ".urdf") or name == "mjcf"
]


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", TEXTS)
def test_text_bombs_are_read_or_refused(name: str, secret: Path, tmp_path: Path) -> None:
    reader = READERS[name]
    path = tmp_path / f"file{reader.suffix}"
    reader.write(path)
    content = path.read_text(encoding="utf-8")
    for bomb, text in list_texts(content, reader.suffix, secret):
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        survive(reader.read, path, bomb)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", ["fmu", "ssp"])
def test_xml_bombs_in_archives_are_read_or_refused(name: str, secret: Path, tmp_path: Path) -> None:
    reader = READERS[name]
    valid = tmp_path / f"valid{reader.suffix}"
    path = tmp_path / f"file{reader.suffix}"
    reader.write(valid)
    with zipfile.ZipFile(valid) as archive:
        members = {member: archive.read(member) for member in archive.namelist()}
    for member in members:
        if not member.endswith((".xml", ".ssd", ".ssv", ".json")):
            continue
        suffix = ".json" if member.endswith(".json") else ".xml"
        for bomb, text in list_texts(members[member].decode(), suffix, secret):
            hostile = members | {member: text.encode("utf-8", "surrogatepass")}
            with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
                for name_of_member, data in hostile.items():
                    archive.writestr(name_of_member, data)
            survive(reader.read, path, f"{member}: {bomb}")


ALIASES = "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10) if k else 'x'}]\n" for k in range(10)
)
YAML_FILES: Bombs = {
    "aliases": ALIASES,
    "an alias of itself": "a: &a [*a]\n",
    "merged keys": "a0: &a0 {k: 1}\n"
    + "".join(f"a{k}: &a{k} {{<<: [{', '.join([f'*a{k - 1}'] * 10)}]}}\n" for k in range(1, 8)),
    "nested lists": "a: " + "[" * 5000 + "]" * 5000,
    "nested blocks": "".join(f"{' ' * k}a:\n" for k in range(3000)),
    "an integer": "a: " + "9" * 500_000,
    "an object": 'a: !!python/object/apply:os.system ["touch made"]\n',
    "a date": "a: 9999-99-99T99:99:99Z\n",
}


@pytest.mark.timeout(300)
@pytest.mark.parametrize("place", ["alone", "within"])
def test_yaml_bombs_of_bags_are_read_or_refused(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    import test_log_bag as bag

    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "bag"
    bag.write(folder, bag.messages(), storage="SQLITE3")
    shutil.copy(folder / "metadata.yaml", "valid.yaml")
    valid = Path("valid.yaml").read_text(encoding="utf-8")
    for bomb, text in YAML_FILES.items():
        lines = "".join(f"  {line}\n" for line in text.splitlines())
        content = text if place == "alone" else f"{valid.rstrip()}\n{lines}"
        (folder / "metadata.yaml").write_text(content, encoding="utf-8")
        survive(lambda path: Log.read(path, TWO), folder, bomb)
    assert not Path("made").exists()
