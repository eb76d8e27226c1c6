"""The native arm in any host: without Python and with any form of resource location."""

import subprocess

import mujoco
import numpy as np
import pytest
from c_hosts import build_host
from mjcf_models import STEP, UF850, Unpacked, names

from fmu_src.arm.native import export_mjcf
from fmu_src.check.run import check
from fmu_src.run.fmu import FmuInstance

MJCF, TABLE = UF850 / "uf850.xml", UF850 / "arm.toml"


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return export_mjcf(MJCF, tmp_path_factory.mktemp("arm") / "Arm.fmu", table=TABLE)


@pytest.fixture(scope="module")
def unpacked(fmu, tmp_path_factory):
    return Unpacked(fmu, tmp_path_factory.mktemp("a folder"))


@pytest.mark.parametrize(
    "form", ["{uri}", "file:{path}", "file://{path}", "file://localhost{path}", "{plain}"]
)
def test_every_form_of_resource_location_is_accepted(form, unpacked):
    uri = unpacked.resources.as_uri()
    path = uri.removeprefix("file://")
    assert "%20" in path
    location = form.format(uri=uri, path=path, plain=unpacked.resources)
    c = unpacked.at(location)
    assert c is not None
    unpacked("FreeInstance", c)


@pytest.mark.parametrize(
    ("location", "sentence"),
    [
        (None, "needed, as a file URI"),
        ("", "needed, as a file URI"),
        ("file://nothing", "needed, as a file URI"),
        ("file:///" + "x" * 5000, "resources is needed"),
        ("file:///nowhere%zz%2", "loaded from the FMU's resources"),
    ],
)
def test_missing_resources_are_reported_without_leaving_files(
    location, sentence, unpacked, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    assert unpacked.at(location) is None
    assert sentence in unpacked.messages[-1].text
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_a_damaged_model_is_reported(unpacked, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    data = (unpacked.resources / "model.mjb").read_bytes()
    folder = tmp_path / "r"
    folder.mkdir()
    for damaged in (b"", data[:100], data[: len(data) // 2], b"\0" * len(data)):
        (folder / "model.mjb").write_bytes(damaged)
        assert unpacked.at(folder.as_uri()) is None
        assert "model.mjb cannot be loaded" in unpacked.messages[-1].text
    assert [path.name for path in tmp_path.iterdir()] == ["r"]
    assert capfd.readouterr() == ("", "")


def test_the_arm_runs_without_python_in_an_empty_environment(fmu, unpacked, tmp_path):
    folder = tmp_path / "work"
    folder.mkdir()
    arguments = [unpacked.library, unpacked.about.guid, unpacked.resources.as_uri(), 3, 18, 200]
    result = subprocess.run(
        [str(a) for a in (build_host("mjcf_host.c", tmp_path), *arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={},
        cwd=folder,
    )
    assert result.returncode == 0, result.stderr
    rows = np.array([line.split() for line in result.stdout.splitlines()], dtype=float)
    assert rows.shape == (200, 18)
    assert result.stderr == ""
    assert list(folder.iterdir()) == []
    with FmuInstance(fmu) as arm:
        arm.initialise()
        inputs, outputs = arm.buffer(names(arm, "input")), arm.buffer(names(arm, "output"))
        for k, row in enumerate(rows):
            places = (k + 37 * np.arange(3)) % 400
            inputs.values[:] = 0.6 * (np.where(places < 200, places, 400 - places) / 100.0 - 1.0)
            inputs.write()
            arm.step(k * STEP, STEP)
            np.testing.assert_array_equal(outputs.read(), row)


def test_mujoco_is_found_next_to_the_binary(unpacked):
    import lief  # slow

    elf = lief.parse(str(unpacked.library))
    mujoco_name = f"libmujoco.so.{mujoco.__version__}"
    assert mujoco_name in elf.libraries
    run_paths = [entry.runpath for entry in elf.dynamic_entries if hasattr(entry, "runpath")]
    assert run_paths == ["$ORIGIN"]
    result = subprocess.run(
        ["ldd", str(unpacked.library)], capture_output=True, text=True, check=True, env={}
    )
    assert "not found" not in result.stdout
    assert f"{unpacked.library.parent / mujoco_name}" in result.stdout
    assert "python" not in result.stdout


def test_licences_of_all_parts_are_included(unpacked):
    folder = unpacked.resources.parent / "documentation/licenses"
    found = {path.name: path.read_text() for path in folder.iterdir()}
    assert "Apache License" in found["mujoco-LICENSE"]
    assert len(found["mujoco-LICENSES_THIRD_PARTY.md"]) > 10_000
    assert "license.txt" in found


def test_all_validators_pass(fmu):
    report = check(fmu)
    assert report.problems == ()
    assert any("libmujoco" in reason for reason in report.skipped)
