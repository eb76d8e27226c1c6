"""How fast the files for PyTorch and JAX step 10^5 joints on a CPU."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from fmu_src import model_file
from fmu_src.one_file.tensors import export_jax, export_torch
from hesr_model.artifacts import read_model

PYTHON = {
    "torch": Path("/usr/bin/python3"),
    "jax": Path(__file__).parents[2] / ".tools/jax/bin/python",
}
EXPORT = {"torch": export_torch, "jax": export_jax}
STEPS = 1000
RUN = {
    "torch": """
import time, torch, law
n, dtype = 100002 // 3, torch.{dtype}
friction = law.Friction(dtype)
state, dq = friction.start((n,)), torch.linspace(-1, 1, 3 * n, dtype=dtype).reshape(n, 3)
with torch.no_grad():
    friction(state, dq)
    began = time.perf_counter()
    for _ in range({steps}):
        tau, state = friction(state, dq)
print(time.perf_counter() - began)
""",
    "jax": """
import time, jax, jax.numpy as xp
jax.config.update("jax_enable_x64", True)
import law
n, dtype = 100002 // 3, xp.{dtype}
c, state = law.coefficients(dtype), law.start((n,), dtype)
dq = xp.linspace(-1, 1, 3 * n, dtype=dtype).reshape(n, 3)
@jax.jit
def run(state, dq):
    def one(carry, _):
        state, dq, total = carry
        tau, state = law.step(c, state, dq)
        return (state, dq - 1e-6 * tau, total + tau), None
    return jax.lax.scan(one, (state, dq, 0 * dq), None, length={steps})[0]
jax.block_until_ready(run(state, dq))
began = time.perf_counter()
jax.block_until_ready(run(state, dq))
print(time.perf_counter() - began)
""",
}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("library", ["torch", "jax"])
def test_many_joints(library: str, dtype: str, tmp_path: Path, tell: Callable[[str], None]) -> None:
    """Aims on two cores: 10 s in PyTorch, 3 s in JAX, for 1000 steps of Table I."""
    python = PYTHON[library]
    ready = [python, "-c", f"import {library}"]
    if not python.exists() or subprocess.run(ready, capture_output=True, check=False).returncode:
        pytest.skip(f"{library} is not installed")
    EXPORT[library](read_model(model_file("uf850-table1")), tmp_path / "law.py")
    text = RUN[library].format(dtype=dtype, steps=STEPS)
    answer = subprocess.run([python, "-c", text], cwd=tmp_path, capture_output=True, text=True,
                            check=True)  # fmt: skip
    tell(f"{library}, {dtype}: {float(answer.stdout):.1f} s for {STEPS} steps of 100,002 joints")
