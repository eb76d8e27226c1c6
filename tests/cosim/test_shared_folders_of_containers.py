"""Processes in different PID and mount namespaces share folders, as those of containers do."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from processes import COMMAND, HANG
from small_study import contents, write_study

from hesr_model.support.result_folder import LIST

NAMESPACES = ("unshare", "--user", "--map-root-user", "--pid", "--fork", "--mount", "--mount-proc")


def has_namespaces() -> bool:
    if sys.platform != "linux" or not shutil.which("unshare"):
        return False
    return subprocess.run([*NAMESPACES, "true"], capture_output=True, check=False).returncode == 0


pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(not has_namespaces(), reason="this system permits no namespaces"),
]

WRITER = """
import sys
from pathlib import Path
from hesr_model.errors import HesrError
from hesr_model.support.files import scratch_folder, written_whole
from hesr_model.support.result_folder import folder_written_whole

name = sys.argv[1]
try:
    with (
        scratch_folder() as scratch,
        written_whole(Path(f"{name}.json")) as file,
        folder_written_whole(Path(sys.argv[2])) as results,
    ):
        print("ready", flush=True)
        sys.stdin.readline()
        for path in (scratch / "a", file, results / "a"):
            path.write_text(name)
except HesrError as error:
    print(error)
"""


@contextmanager
def writer(
    prefix: tuple[str, ...], folder: Path, *arguments: str
) -> Iterator["subprocess.Popen[str]"]:
    with subprocess.Popen(
        [*prefix, sys.executable, "-c", WRITER, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=folder,
        env=os.environ | {"TMPDIR": str(folder / "tmp")},
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def finish(process: "subprocess.Popen[str]") -> str:
    return process.communicate("go\n", timeout=HANG)[0]


@pytest.mark.parametrize(
    ("first", "second"), [((), NAMESPACES), (NAMESPACES, ())], ids=["into", "out of"]
)
def test_living_files_of_another_namespace_stay(
    first: tuple[str, ...], second: tuple[str, ...], tmp_path: Path
) -> None:
    """No process ID of the one says anything to the other."""
    (tmp_path / "tmp").mkdir()
    with writer(first, tmp_path, "one", "results") as one:
        assert one.stdout
        assert one.stdout.readline() == "ready\n"
        with writer(second, tmp_path, "two", "results") as two:
            assert "another run is writing here" in finish(two)
        with writer(second, tmp_path, "two", "other") as two:
            assert finish(two) == "ready\n"
        assert finish(one) == ""
        assert one.returncode == 0
    assert contents(tmp_path, without=[LIST]) == {
        "one.json": b"one",
        "results/a": b"one",
        "two.json": b"two",
        "other/a": b"two",
    }
    assert not list((tmp_path / "tmp").iterdir())


@pytest.mark.nightly("hostile")
def test_runs_in_two_namespaces_end_well_or_name_the_other(tmp_path: Path) -> None:
    study = write_study(tmp_path)
    (tmp_path / "tmp").mkdir()
    processes = [
        subprocess.Popen(
            [*NAMESPACES, sys.executable, *COMMAND, "run", study, "--quick", "-o", "results"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
            env=os.environ | {"TMPDIR": str(tmp_path / "tmp")},
        )
        for _ in range(2)
    ]
    ends = [(process.communicate(timeout=10 * HANG), process.returncode) for process in processes]
    codes = {code for _, code in ends}
    assert codes in ({0}, {0, 2}), ends
    for (_, error), code in ends:
        assert (code == 2) == ("another run is writing here" in error), ends
    assert (tmp_path / "results" / "run.json").is_file()
    assert not list((tmp_path / "tmp").iterdir())
