"""Reading TOML files, and the error sentence for each mistake."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self

import pytest
from pydantic import Field, ValidationError, field_validator, model_validator

from hesr_model.errors import ConfigError
from hesr_model.support.typed_files import Config, RelativePath


class Inner(Config):
    unit: Literal["rad", "m"] = "rad"
    gain: float = Field(default=1.0, gt=0)


class Motion(Config):
    name: str


class Circle(Config):
    kind: Literal["circle"]
    radius: float = 1.0


class Square(Config):
    kind: Literal["square"]
    side: float = 1.0


class Pair(Config):
    low: int = 0
    high: int = 1

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low is {self.low}, more than high, which is {self.high}")
        return self


class Outer(Config):
    name: str
    count: int = 3
    model: RelativePath | None = None
    inner: Inner = Inner()
    motions: tuple[Motion, ...] = ()
    odd: int = 1
    pair: Pair = Pair()
    shapes: tuple[Annotated[Circle | Square, Field(discriminator="kind")], ...] = ()
    named: Mapping[str, Inner] = {}

    @field_validator("odd")
    @classmethod
    def _is_odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("an odd number is needed")
        return value

    @model_validator(mode="after")
    def _not_both(self) -> Self:
        if self.motions and self.model:
            raise ValueError("'motions' and 'model' exclude each other")
        return self


KEYS = "count, inner, model, motions, name, named, odd, pair, shapes"


def read(folder: Path, text: str) -> Outer:
    path = folder / "file.toml"
    path.write_text(text, encoding="utf-8")
    return Outer.read(path)


def sentence(folder: Path, text: str) -> str:
    """Error sentence for a text, without the leading file name."""
    with pytest.raises(ConfigError) as caught:
        read(folder, text)
    start = f"{folder / 'file.toml'}: "
    assert str(caught.value).startswith(start)
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix(start)


def test_a_file_is_read(tmp_path: Path) -> None:
    text = 'name = "é"\ncount = 4\n[inner]\nunit = "m"\n[[motions]]\nname = "sine"\n'
    found = read(tmp_path, text)
    assert (found.name, found.count, found.inner.unit, found.inner.gain) == ("é", 4, "m", 1.0)
    assert [motion.name for motion in found.motions] == ["sine"]


def test_a_path_is_relative_to_its_toml(tmp_path: Path) -> None:
    assert read(tmp_path, 'name = "x"\nmodel = "../a/b.xml"').model == (
        tmp_path.parent / "a" / "b.xml"
    )
    assert read(tmp_path, 'name = "x"\nmodel = "/opt/b.xml"').model == Path("/opt/b.xml")


def test_a_config_is_immutable(tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="frozen"):
        read(tmp_path, 'name = "x"').name = "y"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "key 'name' is missing."),
        (
            'name = "x"\nnmae = "y"',
            "unknown key 'nmae'; did you mean 'name' or 'named'?",
        ),
        ('name = "x"\nzzz = "y"', f"unknown key 'zzz'; allowed here: {KEYS}."),
        # A misspelt required key is not also reported as missing.
        (
            'nmae = "y"',
            "unknown key 'nmae'; did you mean 'name' or 'named'?",
        ),
        (
            'name = "x"\n[inner]\ngian = 2.0',
            "unknown key 'inner.gian'; did you mean 'inner.gain'?",
        ),
        (
            'name = "x"\n[[motions]]\nname = "a"\n[[motions]]\nname = "b"\nkind = "c"',
            "unknown key 'motions.1.kind'; allowed here: name.",
        ),
        (
            'name = "x"\ncount = "four"',
            "key 'count' is 'four': Input should be a valid integer, unable to parse string as an "
            "integer.",
        ),
        (
            'name = "x"\n[inner]\nunit = "deg"',
            "key 'inner.unit' is 'deg': Input should be 'rad' or 'm'.",
        ),
        (
            'name = "x"\n[inner]\ngain = -1.5',
            "key 'inner.gain' is -1.5: Input should be greater than 0.",
        ),
        (
            'name = "x"\n[inner]\ngain = inf',
            "key 'inner.gain' is inf: Input should be a finite number.",
        ),
        (
            'name = "x"\n[inner]\ngain = nan',
            "key 'inner.gain' is nan: Input should be a finite number.",
        ),
        ('name = "x"\nodd = 4', "key 'odd' is 4: an odd number is needed."),
        (
            'name = "x"\n[[shapes]]\nkind = "square"\nradius = 2.0',
            "unknown key 'shapes.0.square.radius'; allowed here: kind, side.",
        ),
        (
            'name = "x"\n[named.first]\ngain = 2.0\n[named.second]\ngian = 2.0',
            "unknown key 'named.second.gian'; did you mean 'named.second.gain'?",
        ),
        (
            'name = "x"\n[pair]\nlow = 3',
            "table 'pair': low is 3, more than high, which is 1.",
        ),
        (
            'name = "x"\nmodel = "m.xml"\n[[motions]]\nname = "a"',
            "'motions' and 'model' exclude each other.",
        ),
        (
            'name = "x"\n[[motions]]\n',
            "key 'motions.0.name' is missing.",
        ),
    ],
)
def test_each_mistake_is_reported_in_one_sentence(tmp_path: Path, text: str, expected: str) -> None:
    assert sentence(tmp_path, text) == expected


@pytest.mark.parametrize("text", ["name = ", 'name = "x"\nname = "y"', "[inner"])
def test_invalid_toml_is_refused_with_its_position(tmp_path: Path, text: str) -> None:
    said = sentence(tmp_path, text)
    assert said.startswith("not valid TOML (")
    assert "(at " in said
    assert said.endswith(").")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "none.toml"
    with pytest.raises(ConfigError) as caught:
        Outer.read(path)
    assert str(caught.value) == f"{path}: no such file."


def test_a_binary_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "file.toml"
    path.write_bytes(b"name = '\xff\xfe'")
    with pytest.raises(ConfigError) as caught:
        Outer.read(path)
    assert str(caught.value).startswith(f"{path}: cannot be read (")
    with pytest.raises(ConfigError) as caught:
        Outer.read(tmp_path)
    assert str(caught.value).startswith(f"{tmp_path}: cannot be read (")
