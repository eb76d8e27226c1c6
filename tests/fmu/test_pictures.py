"""The picture of an FMU: small, reproducible and correct."""

import struct
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import pytest

from fmu_src.pages.picture import model_png
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel

MOST = 25_000
"""Size limit [bytes]."""


def size(picture: bytes) -> tuple[int, int]:
    assert picture.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", picture[16:24])
    return width, height


def test_pictures_of_all_laws_are_valid(
    law: FrictionLaw, make_model: Callable[..., FrictionModel]
) -> None:
    picture = model_png(make_model(law))
    assert size(picture) == (400, 300)
    assert 1_000 < len(picture) <= MOST


@pytest.mark.parametrize("joints", [1, 2, 3, 6, 7])
def test_the_picture_of_many_joints_is_valid(joints: int, table1: FrictionModel) -> None:
    model = replace(
        table1,
        joints=tuple(f"axis {i}" for i in range(joints)),
        laws=(table1.laws * 3)[:joints],
    )
    picture = model_png(model)
    assert size(picture) == (400, 300)
    assert len(picture) <= MOST


@pytest.mark.ci
def test_the_picture_is_equal_in_every_process(table1: FrictionModel) -> None:
    code = (
        "import hashlib; from fmu_src import model_file; "
        "from fmu_src.pages.picture import model_png; "
        "from hesr_model.friction.model import FrictionModel; "
        "print(hashlib.sha256(model_png(FrictionModel.read(model_file('uf850-table1')))).hexdigest())"
    )
    runs = {
        subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout
        for _ in range(2)
    }
    assert len(runs) == 1


def test_the_picture_has_no_date_or_software_version(table1: FrictionModel) -> None:
    picture = model_png(table1)
    assert not [kind for kind in (b"tEXt", b"iTXt", b"zTXt", b"tIME") if kind in picture]
    assert b"atplotlib" not in picture


def test_the_picture_shows_the_law(table1: FrictionModel) -> None:
    other = replace(table1, laws=tuple(reversed(table1.laws)))
    assert model_png(other) != model_png(table1)
    # Names are not drawn: no font has all characters.
    assert model_png(replace(table1, robot="机器人 $x$", joints=("a", "b", "§"))) == model_png(
        table1
    )


def test_non_finite_torques_are_left_out(
    make_law: Callable[[str], FrictionLaw], make_model: Callable[..., FrictionModel]
) -> None:
    law = make_law("parfam_exp")
    law = replace(law, values={**law.values, "theta1_dq": 1e6})
    assert size(model_png(make_model(law, make_law("lugre")))) == (400, 300)


def test_drawing_is_loaded_only_to_draw() -> None:
    code = "import sys, fmu_src.pages.picture; sys.exit('PIL' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
