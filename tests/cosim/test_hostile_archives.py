"""FMUs and SSPs as hostile or damaged archives: every command refuses them in one sentence."""

import re
import resource
import stat
import time
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from damage import damaged_archive
from hostile import archived
from small_fmus import LAGS
from small_study import Hesr, contents, hesr_here

from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec, open_system
from fmu_src.friction.embedded_model import read_embedded_model
from fmu_src.run.archive import Archive
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.variables import model_description
from hesr.extras.ssp.contents import read_contents
from hesr.extras.ssp.ssp import write_ssp
from hesr_model.errors import ArtifactError, HesrError

FEW, MANY = 200, 2000
LONGEST = 60.0  # [s] after which reading or running one input has hung
MOST_MORE = 500 << 20  # bytes of memory, and 20 times the input


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture(scope="module")
def members(lag_fmu: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(lag_fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.fixture(scope="module")
def lags_ssp(lag_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ssp")
    path = folder / "lags.toml"
    text = LAGS.replace("step = 0.2\n", "").replace("FMU", str(lag_fmu))
    path.write_text(text, encoding="utf-8")
    return write_ssp(read_contents(SystemSpec.read(path), path), folder / "lags.ssp")


def commands(fmu: Path) -> list[tuple[object, ...]]:
    """All commands that open FMUs, with an output that must not be created."""
    folder = fmu.parent
    system = folder / "system.toml"
    system.write_text(LAGS.replace("FMU", str(fmu)), encoding="utf-8")
    return [
        ("simulate", system, "-o", folder / "out.csv"),
        ("export", system, "-o", folder / "out.ssp"),
        ("test", fmu, "--kind", "properties", "--json", folder / "out.json"),
        ("check", fmu, "--kind", "convention", "--json", folder / "out.json"),
    ]


def refuse(fmu: Path, hesr: Hesr, said: str, *, known_to_check: bool = False) -> None:
    """Check that every command refuses an FMU in one sentence and leaves no files."""
    for command in commands(fmu):
        before = contents(fmu.parent)
        ended = hesr(*command)
        assert ended.code == 2, (command, ended)
        assert "Traceback" not in ended.err
        assert re.search(said, ended.err.splitlines()[-1]), (command, ended.err)
        assert contents(fmu.parent) == before


NAMES = ("../evil.txt", "/tmp/evil.txt", "C:evil.txt", "a/../../evil", "a\\..\\..\\evil", "a\nb")


@pytest.mark.parametrize("name", NAMES)
def test_names_outside_the_archive_are_refused(
    members: dict[str, bytes], tmp_path: Path, hesr: Hesr, name: str
) -> None:
    fmu = archived(members | {name: b"evil"}, tmp_path / "Evil.fmu")
    refuse(fmu, hesr, r"Evil\.fmu: not a readable FMU \(the entry '.*' (leads out|has control)")


def test_a_decompression_bomb_is_refused(
    members: dict[str, bytes], tmp_path: Path, hesr: Hesr
) -> None:
    """6 MB that decompress to 6 GB."""
    fmu = tmp_path / "Bomb.fmu"
    with zipfile.ZipFile(fmu, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
        with archive.open("resources/zeros", "w", force_zip64=True) as entry:
            for _ in range(6 << 4):
                entry.write(bytes(64 << 20 >> 4))
    refuse(fmu, hesr, r"Bomb\.fmu: not a readable FMU \(the entry 'resources/zeros' claims")


def test_a_symbolic_link_is_refused(members: dict[str, bytes], tmp_path: Path, hesr: Hesr) -> None:
    fmu = archived(members, tmp_path / "Link.fmu")
    link = zipfile.ZipInfo("resources/link")
    link.create_system, link.external_attr = 3, (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(fmu, "a") as archive:
        archive.writestr(link, "/etc")
    refuse(fmu, hesr, "'resources/link' is a symbolic link")


@pytest.mark.parametrize("second", ["modelDescription.xml", "MODELDescription.xml"])
def test_two_descriptions_are_refused(
    members: dict[str, bytes], tmp_path: Path, hesr: Hesr, second: str
) -> None:
    fmu = tmp_path / "Lag.fmu"
    with warnings.catch_warnings(), zipfile.ZipFile(fmu, "w") as archive:
        warnings.simplefilter("ignore")  # of a duplicate name
        for name, content in members.items():
            archive.writestr(name, content)
        archive.writestr(second, members["modelDescription.xml"])
    (tmp_path / "lags.toml").write_text(LAGS.replace("FMU", str(fmu)), encoding="utf-8")
    answer = hesr("simulate", tmp_path / "lags.toml", "-o", tmp_path / "a.csv")
    assert answer.code == 2
    assert "it has 2 entries named 'modeldescription.xml'" in answer.err


@pytest.mark.parametrize(
    "identifier", ["../../evil", "/tmp/evil", "a b", "", "1a", "a\u202eb", "l" * 1000, "lag&#10;"]
)
def test_paths_as_identifiers_are_refused(
    members: dict[str, bytes], tmp_path: Path, hesr: Hesr, identifier: str
) -> None:
    text = members["modelDescription.xml"].decode()
    changed = text.replace('modelIdentifier="lag"', f'modelIdentifier="{identifier}"')
    assert changed != text
    fmu = archived(
        members
        | {
            "modelDescription.xml": changed.encode(),
            "binaries/linux64/a b.so": members["binaries/linux64/lag.so"],
        },
        tmp_path / "Evil.fmu",
    )
    said = r"Evil\.fmu: its modelIdentifier is '.*'; expected"
    for command in commands(fmu)[:-2]:
        ended = hesr(*command)
        assert ended.code == 2, (command, ended)
        assert re.search(said, ended.err), (command, ended.err)


def test_sizes_are_measured_on_the_content(members: dict[str, bytes], tmp_path: Path) -> None:
    """A file larger than stated in the table of contents."""
    fmu = archived(members, tmp_path / "Lag.fmu")
    data = bytearray(fmu.read_bytes())
    place = data.rindex(b"binaries/linux64/lag.so") - 46  # its entry in the table of contents
    assert data[place : place + 4] == b"PK\1\2"
    data[place + 24 : place + 28] = (100).to_bytes(4, "little")
    fmu.write_bytes(data)
    said = r"its binaries/linux64/lag\.so cannot be read"
    with Archive(fmu) as archive, pytest.raises(ArtifactError, match=said):
        archive.unpack(tmp_path / "out")
    assert not any(f.stat().st_size > 100 for f in (tmp_path / "out").rglob("*.so"))


@pytest.mark.parametrize(
    ("limit", "value", "said"),
    [
        ("MAX_ENTRIES", 3, r"\d+ entries; at most 3"),
        ("MAX_TOTAL_BYTES", 1000, r"claims \d+ bytes unpacked; at most 1000"),
        ("MAX_DIRECTORY_BYTES", 100, r"its table of contents has \d+ bytes"),
        ("MAX_ENTRY_BYTES", 100, r"claims \d+ bytes; more than 100"),
    ],
)
def test_size_limits_are_enforced(
    lag_fmu: Path, monkeypatch: pytest.MonkeyPatch, limit: str, value: int, said: str
) -> None:
    monkeypatch.setattr(f"fmu_src.run.archive.{limit}", value)
    with pytest.raises(ArtifactError, match=said), Archive(lag_fmu):
        pass


def test_as_many_entries_as_allowed_are_read(
    lag_fmu: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with zipfile.ZipFile(lag_fmu) as archive:
        names = archive.namelist()
    monkeypatch.setattr("fmu_src.run.archive.MAX_ENTRIES", len(names))
    with Archive(lag_fmu) as found:
        assert set(found.names) <= set(names)


def read_fmu(path: Path, folder: Path, *, run: bool) -> None:
    model_description(path)
    read_embedded_model(path)
    with Archive(path) as archive:
        archive.unpack(folder)
    if run:
        with FmuInstance(path, seconds=5.0) as component:
            component.initialise()
            component.step(0.0, 0.1)
            component.get(["y"])


def read_ssp(path: Path, folder: Path, *, run: bool) -> None:
    with open_system(path) as spec:
        read_contents(spec, path)
        if run:
            short = spec.model_copy(update={"stop": 2 * spec.step})
            with Master(short, path) as master:
                master.run().require_success()


def survive(real: Path, folder: Path, count: int, runs: int) -> None:
    """Read damaged copies of a file and run the first few readable ones."""
    read = read_ssp if real.suffix == ".ssp" else read_fmu
    refused, original = 0, real.read_bytes()
    for seed in range(count):
        path = folder / f"{seed}{real.suffix}"
        content = damaged_archive(original, np.random.default_rng(seed))
        path.write_bytes(content)
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 + MOST_MORE
        begin = time.monotonic()
        said = ""
        try:
            read(path, folder / str(seed), run=seed - refused < runs)
        except HesrError as error:
            refused += 1
            said = str(error)
        except BaseException as error:
            raise AssertionError(f"seed {seed} of {real.name}") from error
        assert len(said) < 2000, f"seed {seed}: {said}"
        assert "\n" not in said, f"seed {seed}: {said}"
        assert time.monotonic() - begin < LONGEST, f"seed {seed}"
        used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        assert used < most + 20 * len(content), f"seed {seed}"
        path.unlink()
    assert 0.2 * count < refused < count


def test_damaged_fmus_are_handled(lag_fmu: Path, tmp_path: Path) -> None:
    survive(lag_fmu, tmp_path, FEW, 5)


def test_damaged_ssps_are_handled(lags_ssp: Path, tmp_path: Path) -> None:
    survive(lags_ssp, tmp_path, FEW, 3)


@pytest.mark.soak
def test_many_damaged_fmus_are_handled(lag_fmu: Path, tmp_path: Path) -> None:
    survive(lag_fmu, tmp_path, MANY, 200)


@pytest.mark.soak
def test_many_damaged_ssps_are_handled(lags_ssp: Path, tmp_path: Path) -> None:
    survive(lags_ssp, tmp_path, MANY, 100)
