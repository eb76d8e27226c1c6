"""A log is read from its own file: references to other files are refused by their name."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hesr_model.errors import LogError
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.readers.bag import read_bag
from hesr_model.logs.readers.hdf5 import FORMAT
from hesr_model.logs.readers.matlab import FORMAT as MATLAB_FORMAT
from hesr_model.robots.robot import RobotDescription

h5py = pytest.importorskip("h5py", reason="needs hesr[formats]")

N = 8
PLACES = [(".h5", "tau"), (".h5", "log/tau"), (".mat", "#refs#/tau")]


def store_outside(file: Any, name: str, other: str) -> None:
    file.create_dataset(name, (N,), dtype="f8", external=[(other, 0, 8 * N)])


def store_partly_outside(file: Any, name: str, other: str) -> None:
    parts = [(file.filename, 0, 8), (other, 0, h5py.h5f.UNLIMITED)]
    file.create_dataset(name, (N,), dtype="f8", external=parts)


def link(file: Any, name: str, other: str) -> None:
    file[name] = h5py.ExternalLink(other, "/tau")


def view(file: Any, name: str, other: str) -> None:
    layout = h5py.VirtualLayout((N,), dtype="f8")
    layout[:] = h5py.VirtualSource(other, "tau", (N,))
    file.create_virtual_dataset(name, layout)


def view_itself(file: Any, name: str, other: str) -> None:
    del other
    view(file, name, ".")


def view_without_end(file: Any, name: str, other: str) -> None:
    """Sources by number, which even the size depends on."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    space = h5py.h5s.create_simple((N,), (h5py.h5s.UNLIMITED,))
    source = h5py.h5s.create_simple((N,))
    space.select_hyperslab((0,), (h5py.h5s.UNLIMITED,), (N,), (N,))
    properties.set_virtual(space, other.removesuffix("0").encode() + b"%b", b"tau", source)
    folder, _, leaf = name.rpartition("/")
    group = file.require_group(folder or "/")
    h5py.h5d.create(group.id, leaf.encode(), h5py.h5t.IEEE_F64LE, space, properties)


REFERENCES: dict[str, Callable[[Any, str, str], None]] = {
    "storage": store_outside,
    "storage in parts": store_partly_outside,
    "link": link,
    "view": view,
    "view of itself": view_itself,
    "view without end": view_without_end,
}


@pytest.mark.parametrize(("suffix", "place"), PLACES)
@pytest.mark.parametrize("is_pipe", [False, True])
@pytest.mark.parametrize("reference", REFERENCES)
def test_a_reference_to_another_file_is_refused(
    tmp_path: Path, reference: str, is_pipe: bool, place: str, suffix: str
) -> None:
    """Whatever lies there: a secret is not read, and a pipe is not waited for."""
    other = tmp_path / "id_rsa0"
    if is_pipe:
        os.mkfifo(other)
    else:
        other.write_bytes(np.arange(2.0 * N).tobytes())
    path = tmp_path / f"run{suffix}"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"] = np.arange(float(N))
        REFERENCES[reference](file, place, str(other))
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(512, b"\0"))
    reader = {".h5": FORMAT.table, ".mat": MATLAB_FORMAT.table}[suffix]
    assert reader is not None
    with pytest.raises(LogError) as caught:
        reader(path, LogFormat())
    error = caught.value
    assert (error.code, error.where, error.key) == ("log.other_file", str(path), place)


@pytest.mark.parametrize("kind", ["link", "pipe"])
@pytest.mark.parametrize("name", ["a.db3", "a.mcap", "metadata.yaml-wal", "note", "inner/deep/a"])
def test_a_bag_has_no_links_and_pipes(tmp_path: Path, kind: str, name: str) -> None:
    bag = tmp_path / "bag"
    (bag / name).parent.mkdir(parents=True)
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}", encoding="utf-8")
    if kind == "pipe":
        os.mkfifo(bag / name)
    else:
        (bag / name).symlink_to("/etc/passwd")
    description = RobotDescription(name="r", model=Path("r.urdf"), joints=("a",))
    with pytest.raises(LogError) as caught:
        read_bag(bag, description)
    assert (caught.value.code, caught.value.key) == ("log.other_file", name)
