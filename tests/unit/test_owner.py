"""The owner of a model."""

from pathlib import Path

import pytest

from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.owner import OURS, Owner

ROBOT = 'name = "arm"\nmodel = "arm.urdf"\njoints = ["a"]\n'


def test_only_known_fields_are_listed() -> None:
    assert Owner().known == {}
    assert Owner(author="A", license="MIT").known == {"author": "A", "license": "MIT"}
    assert set(OURS.known) == {"author", "copyright", "license"}


def test_the_owner_is_part_of_the_provenance() -> None:
    assert Owner.from_provenance({}) == Owner()
    assert Owner.from_provenance({"owner": {"copyright": "(c) B"}}) == Owner(copyright="(c) B")
    for wrong in ({"author": 3}, {"name": "B"}, {"author": "a\nb"}, "B"):
        with pytest.raises(ArtifactError, match=r"the provenance's 'owner' is .*; expected texts"):
            Owner.from_provenance({"owner": wrong})


def test_a_robot_file_names_the_owner(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(f'{ROBOT}[owner]\nauthor = "A"\n', encoding="utf-8")
    assert RobotDescription.read(file).owner == Owner(author="A")
    file.write_text(f'{ROBOT}[owner]\nauthor = "A"\nname = "B"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match="owner"):
        RobotDescription.read(file)
