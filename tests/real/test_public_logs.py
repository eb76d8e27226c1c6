"""Studies of measured robots by name, and of public logs from a clone of their repository."""

import gzip
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from documents import ROOT

import hesr
from cosim.study.public_logs import list_sources
from cosim.study.shipped_studies import find_shipped_studies
from cosim.study.study import Study
from hesr_model.errors import ArgumentError, ConfigError, RobotError

SHARED = ROOT.parent / "shared"
RAW = SHARED / "raw" / "ur10e"
MEASURED = ("cylinder", "fretting", "ur10")
SOURCES = {source.name: source for source in list_sources()}
UR10E = SOURCES["ur10e"]

CONVERTED = {
    "panda": SHARED / "data" / "panda" / "panda_first.csv",
    "tiago": SHARED / "data" / "tiago_arm" / "tiago_excitation.csv",
}
"""Converted logs of sources whose raw files are not here; tests write them back."""

URDFS = {
    "panda": SHARED / "data" / "panda" / "panda.urdf",
    "tiago": SHARED / "examples" / "tiago" / "tiago.urdf",
}


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone of the UR10e's repository, from its raw files."""
    if not RAW.is_dir():
        pytest.skip("needs the logs in ../shared/raw")
    folder = tmp_path / "clone"
    for entry in UR10E.logs.values():
        path = folder / UR10E.folder / entry["file"]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(gzip.decompress((RAW / f"{path.name}.gz").read_bytes()))
    model_path = folder / UR10E.model
    model_path.parent.mkdir(parents=True)
    shutil.copyfile(SHARED / "data" / "ur10e" / "ur10e.urdf", model_path)
    return folder


def test_a_clone_becomes_the_logs_of_the_study(clone: Path, tmp_path: Path) -> None:
    project = hesr.new(tmp_path / "ur10e", public=clone)
    assert len(project.joints) == 6
    for name in UR10E.logs:
        written = (tmp_path / "ur10e" / name).read_bytes()
        assert written == (SHARED / "data" / "ur10e" / name).read_bytes()
    study = Study.read(tmp_path / "ur10e" / "study.toml")
    assert set(study.logs.identification) <= set(UR10E.logs)


def write_back(name: str, folder: Path) -> Path:
    """Write the raw files of a converted log, with further rows, as the repository has them."""
    if not CONVERTED[name].is_file():
        pytest.skip("needs the logs in ../shared/data")
    with CONVERTED[name].open(encoding="utf-8") as file:
        names = next(file).rstrip("\n").split(",")
        rows = [line.rstrip("\n").split(",") for line in file]
    rows.append(rows[-1])
    start = 0.0 if name == "panda" else 3.25
    for table in SOURCES[name].tables:
        path = folder / SOURCES[name].folder / table.file
        path.parent.mkdir(parents=True, exist_ok=True)
        cells = [[float(row[names.index(column)]) for column in table.columns] for row in rows]
        if "t" in table.columns:
            cells = [[start + row[0], *row[1:]] for row in cells]
        if table.is_stacked:
            texts = [f"{number:.6g}" for row in cells for number in row]
        else:
            # Another column, and other places than those of the converted log.
            header = ["other", *reversed(table.header)]
            texts = [",".join(header)]
            texts += [",".join(map(repr, [0.0, *reversed(row)])) for row in cells]
        path.write_text("\n".join(texts) + "\n", encoding="utf-8")
    return folder


@pytest.mark.parametrize("name", CONVERTED)
def test_raw_files_of_other_layouts_become_the_log(name: str, tmp_path: Path) -> None:
    clone = write_back(name, tmp_path / "clone")
    project = hesr.new(tmp_path / "new", URDFS[name], public=clone)
    (log,) = SOURCES[name].logs
    assert (tmp_path / "new" / log).read_bytes() == CONVERTED[name].read_bytes()
    assert project.joints == hesr.Robot(tmp_path / "new" / "robot.toml").joints
    study = Study.read(tmp_path / "new" / "study.toml")
    assert {part.log for part in study.logs.parts.values()} == {log}


@pytest.mark.parametrize("name", CONVERTED)
def test_a_source_without_a_model_needs_that_of_its_robot(name: str, tmp_path: Path) -> None:
    clone = write_back(name, tmp_path / "clone")
    with pytest.raises(ConfigError) as caught:
        hesr.new(tmp_path / "new", public=clone)
    assert (caught.value.code, caught.value.key) == ("public.model", "robot")
    other = next(URDFS[other] for other in URDFS if other != name)
    with pytest.raises(RobotError, match="has no joint"):
        hesr.new(tmp_path / "new", other, public=clone)
    assert not (tmp_path / "new").exists()


def test_a_source_with_a_model_takes_no_other(clone: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        hesr.new(tmp_path / "new", URDFS["tiago"], public=clone)
    assert (caught.value.code, caught.value.key) == ("public.model", "robot")


@pytest.mark.parametrize("change", ["row", "text", "bytes", "missing"])
def test_another_commit_is_refused(clone: Path, tmp_path: Path, change: str) -> None:
    path = clone / UR10E.folder / UR10E.logs["id_fourier_20s_5harm.csv"]["file"]
    text = path.read_text(encoding="utf-8")
    if change == "missing":
        path.unlink()
    elif change == "bytes":
        path.write_bytes(bytes([255, 254, 0]))
    else:
        path.write_text(f"{text.splitlines()[0]}\n{text}" if change == "row" else "no log\n")
    with pytest.raises(ConfigError) as caught:
        hesr.new(tmp_path / "ur10e", public=clone)
    assert caught.value.code == ("public.missing" if change == "missing" else "public.changed")
    assert not (tmp_path / "ur10e").exists()


def test_other_folders_are_no_clone(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        hesr.new(tmp_path / "ur10e", public=tmp_path)
    assert caught.value.code == "public.unknown"


@pytest.mark.parametrize("other", [{"twin": True}, {"bench": "rotary"}, {"joints": "a"}])
def test_a_clone_excludes_other_robots(tmp_path: Path, other: dict[str, Any]) -> None:
    with pytest.raises(ArgumentError, match="public"):
        hesr.new(tmp_path / "ur10e", public=tmp_path, **other)


@pytest.mark.parametrize("robot", [{"public": "clone"}, {"twin": True}, {"robot": "arm.urdf"}])
@pytest.mark.parametrize(
    "option",
    [
        {"inertia": 0.1}, {"gravity": True}, {"moment": 1.0}, {"phase": 0.0}, {"gear_ratio": 100.0},
        {"log": {"rate": 100}}, {"source": "datasheet"},
    ],
)  # fmt: skip
def test_options_of_a_bench_are_refused_next_to_other_robots(
    tmp_path: Path, robot: dict[str, Any], option: dict[str, Any]
) -> None:
    with pytest.raises(ArgumentError) as caught:
        hesr.new(tmp_path / "new", **robot, **option)
    assert (caught.value.code, caught.value.key) == ("new.bench_option", *option)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", SOURCES)
def test_the_page_has_the_recorded_sources(name: str) -> None:
    page = (ROOT / "docs" / "data.md").read_text(encoding="utf-8")
    source = SOURCES[name]
    assert source.commit in page
    assert source.folder in page
    for log, entry in source.logs.items():
        assert entry["sha256"] in page
        if "file" in entry:
            first_row, end_row = entry["rows"]
            line = f"`{log}` | `{entry['file']}` | {first_row} to {end_row - 1} |"
            assert f"| {line} `{entry['sha256']}` |" in page


@pytest.mark.parametrize("name", SOURCES)
def test_the_study_of_a_clone_is_that_of_the_readme(name: str) -> None:
    def without_folders(path: Path) -> str:
        text = re.sub(r"^(#.*\n)+", "", path.read_text(encoding="utf-8"))
        text = re.sub(r'model = ".*"', "", text)
        text = text.replace(f"{name}.toml", "robot.toml")
        return re.sub(r"\.\./\.\./\.\./shared/data/\w+/", "", text)

    shipped = ROOT / "models" / "public" / name
    real = ROOT / "tests" / "real"
    assert without_folders(shipped / "study.toml") == without_folders(real / f"{name}_study.toml")
    assert without_folders(shipped / "robot.toml") == without_folders(real / f"{name}.toml")


@pytest.mark.parametrize("name", MEASURED)
def test_measured_robots_ship_with_sources(name: str) -> None:
    folder = find_shipped_studies()[name].parent
    assert list(folder.glob("LICENSE*"))
    assert re.search(r"commit `[0-9a-f]{40}`", (folder / "README.md").read_text(encoding="utf-8"))
    logs = Study.read(folder / "study.toml").logs
    parts = {name: part.log for name, part in logs.parts.items()}
    for log in logs.identification:
        assert (folder / parts.get(log, log)).is_file()
