"""A sweep on two real workers of dask.distributed, one of them killed during the sweep."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from containing import Containing
from small_fmus import LAGS
from small_study import hesr_here
from test_sweep import STUDY, files, written

from hesr.extras.sweep import cluster
from hesr.extras.sweep.job import run_sweep
from hesr_model.errors import ConfigError, WorkerError

pytestmark = pytest.mark.ci

LOCAL = """
import sys
from distributed import LocalCluster, Security

if __name__ == "__main__":
    workers, protocol = int(sys.argv[1]), sys.argv[2]
    encrypted = Security(require_encryption=True) if protocol == "tls" else None
    with LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs=50,
        security=encrypted, protocol=protocol,
    ) as local:
        print(local.scheduler_address, *(w.pid for w in local.workers.values()), flush=True)
        sys.stdin.read()
"""


@contextmanager
def local(
    folder: Path, workers: int, protocol: str = "tcp", **environment: str
) -> Iterator[tuple[str, list[int]]]:
    """A scheduler with workers: its address and the PIDs of the workers."""
    pytest.importorskip("distributed", reason="dask.distributed is not installed")
    script = written(folder, LOCAL, "local.py")
    command = (sys.executable, script, str(workers), protocol)
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | environment,
    ) as process:
        assert process.stdout is not None
        address, *numbers = process.stdout.readline().split()
        yield address, list(map(int, numbers))
        process.communicate("")


@pytest.fixture
def study(lag_fmu: Path, tmp_path: Path) -> Path:
    system = LAGS.replace("FMU", str(lag_fmu)).replace("step = 0.2", "start = { T = 0.3 }")
    written(tmp_path, system.replace("stop = 1.0", "stop = 100.0"), "lags.toml")
    return written(tmp_path, STUDY.replace("runs = 12", "runs = 200"))


def test_a_lost_worker_loses_no_runs(study: Path, tmp_path: Path):
    with local(tmp_path, 2) as (address, workers):
        assert len(workers) == 2
        killed = []

        def kill(_what: str, done: int, count: int) -> None:
            if 0 < done < count and not killed:
                killed.append(done)
                os.kill(workers[0], signal.SIGKILL)

        run_sweep(study, tmp_path / "cluster", cluster=address, progress=kill)
    assert killed
    run_sweep(study, tmp_path / "here", workers=1)
    assert files(tmp_path / "cluster") == files(tmp_path / "here")


def test_invalid_clusters_are_refused(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cluster, "_TIME_LIMIT", 1)
    with (
        local(tmp_path, 0) as (address, _),
        pytest.raises(ConfigError, match=r"the scheduler at .* has no worker\."),
    ):
        run_sweep(study, tmp_path / "out", cluster=address)
    with pytest.raises(ConfigError, match=r"found no scheduler at tcp://127\.0\.0\.1:9\."):
        run_sweep(study, tmp_path / "out", cluster="tcp://127.0.0.1:9")
    with pytest.raises(ConfigError, match=r"found no scheduler at nonsense\."):
        run_sweep(study, tmp_path / "out", cluster="nonsense")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"'cluster' needs: pip install"):
        run_sweep(study, tmp_path / "out", cluster="tcp://127.0.0.1:9")


def test_workers_that_keep_dying_end_the_sweep(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(cluster, "_MAX_ROUNDS", 0)
    with local(tmp_path, 1) as (address, _), pytest.raises(WorkerError) as error:
        run_sweep(study, tmp_path / "out", cluster=address)
    assert str(error.value) == Containing("died 0 times", "40 chunks")


def tls_settings(folder: Path) -> dict[str, str]:
    """Settings of Dask with a new certificate of this machine, for all roles."""
    if (openssl := shutil.which("openssl")) is None:
        pytest.skip("needs openssl")
    key, certificate = folder / "key.pem", folder / "certificate.pem"
    command = (openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2")
    names = ("-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1")
    subprocess.run(
        [*command, "-keyout", key, "-out", certificate, *names], check=True, capture_output=True
    )
    files = {"CA_FILE": certificate}
    for role in ("CLIENT", "SCHEDULER", "WORKER"):
        files |= {f"{role}__CERT": certificate, f"{role}__KEY": key}
    return {f"DASK_DISTRIBUTED__COMM__TLS__{name}": str(file) for name, file in files.items()}


def swept(*arguments: object, **environment: str) -> "subprocess.CompletedProcess[str]":
    """Run `hesr simulate`, which reads the settings of Dask at its start."""
    command = (sys.executable, "-c", "from hesr.cli import main; main()", "simulate")
    own = {name: text for name, text in os.environ.items() if not name.startswith("DASK_")}
    return subprocess.run(
        [*command, *map(str, arguments)], env=own | environment, capture_output=True, text=True
    )


def test_a_sweep_runs_on_an_encrypted_cluster(study: Path, tmp_path: Path):
    settings = tls_settings(tmp_path)
    with local(tmp_path, 1, "tls", **settings) as (address, _):
        assert address.startswith("tls://")
        out = tmp_path / "cluster"
        done = swept(study, "-o", out, "--cluster", address, **settings)
        assert done.returncode == 0, done.stderr
        for changed, sentence in (
            ({}, "TLS settings are not usable"),
            (settings | {next(iter(settings)): "none.pem"}, "Dask's TLS settings are not usable ("),
            (settings | {next(iter(settings)): str(study)}, "Dask's TLS settings are not usable ("),
        ):
            refused = swept(study, "-o", tmp_path / "x", "--cluster", address, **changed)
            assert refused.returncode == 2
            assert sentence in refused.stderr
            assert len(refused.stderr.splitlines()) == 1
    run_sweep(study, tmp_path / "here", workers=1)
    assert files(out) == files(tmp_path / "here")


@pytest.mark.parametrize(
    ("address", "is_refused"),
    [
        ("tcp://10.0.0.7:8786", True),
        ("tcp://cluster.example:8786", True),
        ("tcp://localhost.example:8786", True),
        ("10.0.0.7:8786", True),
        ("ws://[2001:db8::1]:8786", True),
        ("tls://10.0.0.7:8786", False),
        ("tcp://localhost:8786", False),
        ("tcp://127.0.0.1:8786", False),
        ("tcp://[::1]:8786", False),
    ],
)
def test_addresses_of_other_machines_need_encryption(address: str, is_refused: bool):
    cluster.require_encryption(address, insecure=True)
    if is_refused:
        with pytest.raises(ConfigError, match="use tls:// with the TLS settings"):
            cluster.require_encryption(address, insecure=False)
    else:
        cluster.require_encryption(address, insecure=False)


def test_the_command_refuses_an_unencrypted_cluster(
    study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    refused = hesr_here(capsys, monkeypatch)("simulate", study, "--cluster", "tcp://192.0.2.1:1")
    assert refused.code == 2
    assert refused.err.startswith("hesr: --cluster: tcp://192.0.2.1:1 is not encrypted;")
