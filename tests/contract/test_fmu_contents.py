"""Contents that every FMU of HESR has: a page, reference results, and described variables.

Each kind of FMU is a row of `KINDS`.
"""

import csv
import io
import re
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from adaptive_models import lugre, model, stops
from fmpy import read_model_description
from fmu_variables import is_boolean, is_integer, is_real

from fmu_src.arm.native import export_mjcf
from fmu_src.arm.python_arm.export import export_python_arm
from fmu_src.blocks.controller import controller, velocity
from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.blocks.trajectory import trajectory
from fmu_src.export.package import Content, Version, write_fmu
from fmu_src.friction.friction_fmu import export_fmu
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.reference_results import verify
from hesr.extras.adaptive.monitor import export_adaptive
from hesr.extras.drive.drive_fmu import export_drive
from hesr.extras.observer.observation import export_observer
from hesr_model.friction.band import Band
from hesr_model.friction.thermal import Thermal
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

UF850 = models_folder() / "uf850"
WARM = Thermal(coulomb=0.004, viscous=0.02, resistance=0.5, time_constant=30.0)
BAND = Band(
    floor=0.7, slow=1.3, slow_speed=0.02, rest=0.4, fast=0.5, load=0.05, tail=0.7, envelope=1.0
)


@cache
def robot() -> Robot:
    return Robot(RobotDescription.read(UF850 / "robot.toml"))


@cache
def plain() -> Any:
    """Two laws with and one without bristles, so that joints differ."""
    return replace(model(lugre(), stops(), lugre()), joints=robot().joints)


def warm() -> Any:
    return replace(plain(), thermal=(WARM,) * 3)


def banded() -> Any:
    return replace(plain(), laws=tuple(replace(law, band=BAND) for law in plain().laws))


def export_friction(path: Path, fmi: Version) -> Path:
    return export_fmu(banded(), path, power=True, band=True, low_pass=20.0, fmi=fmi)


def export_thermal(path: Path, fmi: Version) -> Path:
    return export_fmu(warm(), path, fmi=fmi)


def export_adapting(path: Path, fmi: Version) -> Path:
    return export_adaptive(plain(), path, fmi=fmi)


def export_warm(path: Path, fmi: Version) -> Path:
    return export_adaptive(warm(), path, fmi=fmi)


def export_motors(path: Path, fmi: Version) -> Path:
    three = {"inertia": [1.0] * 3, "stiffness": [1e4] * 3, "damping": [1.0] * 3}
    return export_drive(plain(), path, ratio=[100.0] * 3, fmi=fmi, **three)


def export_arm_plant(path: Path, fmi: Version) -> Path:
    return export_plant(plain(), path, plant_body=PlantBody.from_robot(robot()), tool=True, fmi=fmi)


def export_servo_plant(path: Path, fmi: Version) -> Path:
    gains = {"kv": [90.0] * 3, "ki": [900.0] * 3, "kp": [1.0] * 3}
    return export_plant(plain(), path, plant_body=PlantBody.from_robot(robot()), fmi=fmi, **gains)


def export_contact(path: Path, fmi: Version) -> Path:
    return export_observer(banded(), path, plant_body=PlantBody.from_robot(robot()), fmi=fmi)


SIX_JOINTS = (
    """<mujoco model="six"><compiler angle="radian"/><worldbody>{links}</worldbody></mujoco>"""
)
LINK = """<body pos="0 0 0.3"><joint name="j{k}" axis="{axis}" armature="0.5"/>
<geom size=".05 .2" type="capsule" pos=".1 0 .1" mass="2"/>"""


def export_wrench(path: Path, fmi: Version) -> Path:
    """Write the observer of a chain of six joints, which shows force and moment."""
    links = [LINK.format(k=k, axis="0 1 0" if k % 2 else "0 0 1") for k in range(1, 7)]
    file = path.with_suffix(".xml")
    file.write_text(SIX_JOINTS.format(links="".join(links) + "</body>" * 6), encoding="utf-8")
    names = tuple(f"j{k}" for k in range(1, 7))
    chain = Robot(RobotDescription(name="six", model=file, joints=names))
    laws = replace(model(*(replace(lugre(), band=BAND),) * 6), joints=names)
    return export_observer(laws, path, plant_body=PlantBody.from_robot(chain), fmi=fmi)


def export_block(block: Callable[[], Content], path: Path, fmi: Version) -> Path:
    return write_fmu(block(), path, fmi=fmi)


def rigid_body() -> Content:
    return inverse_dynamics(robot(), np.ones(len(robot().parameter_names)))


def export_twin(path: Path, _fmi: Version) -> Path:
    return export_mjcf(UF850 / "uf850.xml", path, table=UF850 / "arm.toml")


def export_python_twin(path: Path, _fmi: Version) -> Path:
    return export_python_arm(UF850 / "uf850.xml", UF850 / "arm.toml", path)


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of FMU.

    Attributes
    ----------
    export : writes it to a path, for a version of FMI.
    versions : of FMI.
    booleans, integers : all such variables, without indices; the second ones have choices or
        meanings in their description.
    """

    export: Callable[[Path, Version], Path]
    versions: tuple[Version, ...] = (2, 3)
    booleans: frozenset[str] = frozenset()
    integers: frozenset[str] = frozenset()


LAW = frozenset({"discretisation", "start_mode"})
LEARNED = frozenset({"start_mode", "health", "drift", "shift"})
SEED = frozenset({"noise_seed"})
KINDS = {
    "friction": Kind(export=export_friction, booleans=frozenset({"band_envelope"}), integers=LAW),
    "thermal": Kind(
        export=export_thermal,
        booleans=frozenset({"thermometer"}),
        integers=frozenset({"start_mode"}),
    ),
    "adaptive": Kind(export=export_adapting, booleans=frozenset({"adapt"}), integers=LEARNED),
    "warm adaptive": Kind(
        export=export_warm, booleans=frozenset({"adapt", "thermometer"}), integers=LEARNED
    ),
    "drive": Kind(export=export_motors, integers=LAW),
    "plant": Kind(export=export_arm_plant, integers=LAW),
    "plant with servo": Kind(export=export_servo_plant, integers=LAW),
    "observer": Kind(export=export_contact, booleans=frozenset({"contact"}), integers=LAW),
    "observer of six joints": Kind(
        export=export_wrench, booleans=frozenset({"contact"}), integers=LAW
    ),
    "controller": Kind(
        export=partial(export_block, partial(controller, 3)),
        integers=frozenset({"compensation"}),
    ),
    "velocity": Kind(export=partial(export_block, partial(velocity, 3))),
    "trajectory": Kind(
        export=partial(export_block, partial(trajectory, 3)), integers=frozenset({"kind"})
    ),
    "inverse dynamics": Kind(export=partial(export_block, rigid_body)),
    "arm": Kind(export=export_twin, versions=(2,), integers=SEED),
    "python arm": Kind(export=export_python_twin, versions=(2,), integers=SEED),
}

CASES = [
    pytest.param(name, version, marks=[] if version == 2 else pytest.mark.nightly("laws"))
    for name, kind in KINDS.items()
    for version in kind.versions
]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Version], Path]:
    @cache
    def write(name: str, version: Version) -> Path:
        return KINDS[name].export(tmp_path_factory.mktemp("fmu") / "It.fmu", version)

    return write


class Page(HTMLParser):
    """Headings, links and text of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.ids: list[str] = []
        self.text = ""

    def handle_starttag(self, _tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.links += [found["href"] or ""] if "href" in found else []
        self.ids += [found["id"] or ""] if "id" in found else []

    def handle_data(self, data: str) -> None:
        self.text += f"{data} "


def stem(name: str) -> str:
    """Return a variable's name without joint and indices."""
    return re.sub(r"\[[\d,]*\]", "", name.rpartition(".")[2])


def read_results(fmu: Path) -> dict[str, np.ndarray]:
    """Return the columns of the reference results in co-simulation."""
    with zipfile.ZipFile(fmu) as archive:
        [file] = [n for n in archive.namelist() if re.search(r"co_simulation/\w+_ref\.csv$", n)]
        rows = list(csv.DictReader(io.StringIO(archive.read(file).decode())))
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}


of_every_kind = pytest.mark.parametrize(("name", "version"), CASES)


@pytest.mark.ci
@of_every_kind
def test_the_page_names_every_variable(
    name: str, version: Version, written: Callable[[str, Version], Path]
) -> None:
    """Its links lead to members of the FMU or to itself."""
    path = written(name, version)
    page = Page()
    with zipfile.ZipFile(path) as archive:
        members = archive.namelist()
        page.feed(archive.read("documentation/index.html").decode())
    for link in page.links:
        if link.startswith("#"):
            assert link[1:] in page.ids
        elif not link.startswith(("http", "data:")):
            assert f"documentation/{link}" in members, link
    words = set(re.findall(r"[\w.()]+", re.sub(r"\[[\w,]*\]", "", page.text)))
    for v in read_model_description(path).modelVariables:
        if v.causality != "independent" and v.name != "event_indicator":
            assert re.sub(r"\[[\d,]*\]", "", v.name) in words, v.name


@pytest.mark.ci
@of_every_kind
def test_reference_results_are_those_of_the_fmu(
    name: str, version: Version, written: Callable[[str, Version], Path]
) -> None:
    """Something moves in them, and the FMU's own run agrees."""
    path = written(name, version)
    columns = read_results(path)
    moving = [key for key, values in columns.items() if key != "time" and np.ptp(values) > 1e-9]
    assert len(columns["time"]) >= 100
    assert moving
    found = verify(path)
    assert found.problems == []
    assert [text for text in found.skipped if "for a solver" not in text] == []
    assert len(found.passed) >= 2


@pytest.mark.ci
@of_every_kind
def test_variables_have_description_unit_and_type(
    name: str, version: Version, written: Callable[[str, Version], Path]
) -> None:
    description = read_model_description(written(name, version))
    variables = [v for v in description.modelVariables if v.causality != "independent"]
    units = {unit.name for unit in description.unitDefinitions}
    for v in variables:
        assert v.description, v.name
        if is_real(v) and v.name != "event_indicator":
            unit = v.unit or v.declaredType.unit
            assert unit in units, v.name
        if is_integer(v) and stem(v.name) not in SEED:
            assert re.search(r": (-?\d+ = \w+(, )?){2,}$", v.description), v.name
            assert v.min is not None, v.name
            assert v.max is not None, v.name
    assert {stem(v.name) for v in variables if is_boolean(v)} == KINDS[name].booleans
    assert {stem(v.name) for v in variables if is_integer(v)} == KINDS[name].integers


@pytest.mark.ci
@of_every_kind
def test_outputs_have_different_descriptions(
    name: str, version: Version, written: Callable[[str, Version], Path]
) -> None:
    description = read_model_description(written(name, version))
    outputs = [v for v in description.modelVariables if v.causality == "output"]
    texts: dict[str, set[str]] = {}
    for v in outputs:
        texts.setdefault(v.description, set()).add(stem(v.name))
    assert [stems for stems in texts.values() if len(stems) > 1] == []


# Words that describe a count or a switch instead of a measured quantity.
COUNTED = re.compile(
    r"\bwhether\b|\bnumber of\b|\bcount of\b|-?\d+ = |\(-?1\)|\belse [01]\b|^1 if\b"
)


@pytest.mark.ci
@of_every_kind
def test_no_real_is_a_count_or_a_switch(
    name: str, version: Version, written: Callable[[str, Version], Path]
) -> None:
    """Neither by its description, nor by its values in the reference results."""
    path = written(name, version)
    for v in read_model_description(path).modelVariables:
        assert not (is_real(v) and COUNTED.search(v.description or "")), v.name
    for column, values in read_results(path).items():
        is_whole = np.array_equal(values, np.round(values))
        assert not (is_whole and np.ptp(values) > 0.0), column


def test_integers_of_an_adaptive_fmu_take_their_values(
    written: Callable[[str, Version], Path],
) -> None:
    """Health is 1 without adaptation, and 2 at rest."""
    with FmuInstance(written("adaptive", 2)) as component:
        moving = {f"dq[{i}]": 1.0 for i in (1, 2, 3)}
        component.initialise(start=moving)
        component.set({"adapt": False})
        component.step(0.0, 0.01)
        switched_off = component._instance.get("Integer", health(component))
        component.set({"adapt": True, "dq[1]": 0.0})
        component.step(0.01, 0.01)
        assert switched_off == [1, 1, 1]
        assert component._instance.get("Integer", health(component))[0] == 2


def health(component: FmuInstance) -> list[int]:
    names = [f"health[{i}]" for i in (1, 2, 3)]
    return component.variables.references(names, "Integer")
