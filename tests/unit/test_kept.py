"""Checkpoints: a killed run reuses its finished fits."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hesr_model.fitting.fit import compute_key, fit_models
from hesr_model.rigid_body.friction_record import FrictionRecord

LAWS = ("stribeck", "lugre")


def records() -> list[list[FrictionRecord]]:
    t = np.arange(1500) * 0.01
    made = []
    for k in range(2):
        dq = np.sin(2.0 * t + k) + 0.4 * np.sin(5.3 * t)
        tau = 8.0 * np.tanh(30.0 * dq) + 3.0 * dq
        tau += np.random.default_rng(k).normal(0.0, 0.2, len(t))
        made.append(
            [FrictionRecord(log="a", joint=f"j/{k}", t=t, dq=dq, q=dq, tau_load=dq, tau=tau)]
        )
    return made


def fitted(kept: Path | None, **more: object) -> object:
    settings = {"robot": "r", "seed": 1, "workers": 1, "checkpoints": kept} | more
    models = fit_models(LAWS, records(), **settings)  # type: ignore[arg-type]
    return {law: model.laws for law, model in models.items()}


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_a_killed_fit_resumes(tmp_path: Path) -> None:
    kept = tmp_path / "laws"
    program = (
        "import os, signal, sys; from pathlib import Path\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from test_kept import fitted\n"
        "replace, kept = Path.replace, Path(sys.argv[1])\n"
        "def replace_or_die(path, target):\n"
        "    if len(list(kept.glob('[!.]*.json'))) == 2:\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return replace(path, target)\n"
        "Path.replace = replace_or_die\n"
        "fitted(kept)"
    )
    process = subprocess.run([sys.executable, "-c", program, str(kept)], check=False)
    assert process.returncode == -signal.SIGKILL
    files = {path: path.stat().st_mtime_ns for path in kept.glob("[!.]*.json")}
    assert len(files) == 2
    assert len(list(kept.iterdir())) > 2  # what the killed process was writing
    damaged = sorted(files)[0]
    damaged.write_text("{", encoding="utf-8")
    told: list[tuple[int, int]] = []
    found = fitted(kept, progress=lambda *now: told.append(now))
    assert found == fitted(None)
    untouched = set(files) - {damaged}
    assert all(path.stat().st_mtime_ns == files[path] for path in untouched)
    assert len(list(kept.glob("[!.]*.json"))) == 4
    assert damaged.stat().st_size > 2
    assert told[0] == (0, 400)
    assert told[-1] == (400, 400)
    assert told == sorted(told)


def test_a_checkpoint_belongs_to_one_fit() -> None:
    [[one], [other]] = records()
    key = compute_key("lugre", [one], 1, {"a": 1})
    assert key == compute_key("lugre", [replace(one)], 1, {"a": 1})
    others = {
        compute_key("stribeck", [one], 1, {"a": 1}),
        compute_key("lugre", [other], 1, {"a": 1}),
        compute_key("lugre", [one], 2, {"a": 1}),
        compute_key("lugre", [one], 1, {"a": 2}),
        compute_key("lugre", [one, one], 1, {"a": 1}),
        compute_key("lugre", [replace(one, tau=one.tau + 1e-12)], 1, {"a": 1}),
    }
    assert len(others) == 6
    assert key not in others
