"""Speed of the files for PyTorch and JAX with 10^5 joints on a CPU."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from fmu_src import model_file
from hesr.extras.one_file.tensors import export_jax, export_torch
from hesr_model.fitting.estimator import registry
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel

PYTHON = {"torch": Path("/usr/bin/python3"), "jax": Path(sys.executable)}
EXPORT = {"torch": export_torch, "jax": export_jax}
STEPS = 1000
RUN = {
    "torch": """
import time, torch, law
torch.set_num_threads(2)
n, dtype = 100002 // 3, torch.{dtype}
friction = law.Friction(dtype)
state, dq = friction.start((n,)), torch.linspace(-1, 1, 3 * n, dtype=dtype).reshape(n, 3)
q = 3 * dq
with torch.no_grad():
    friction(state, dq, q)
    began, used = time.perf_counter(), time.process_time()
    for _ in range({steps}):
        tau, state = friction(state, dq, q)
print(time.perf_counter() - began, time.process_time() - used)
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
        tau, state = law.step(c, state, dq, 3 * dq)
        return (state, dq - 1e-6 * tau, total + tau), None
    return jax.lax.scan(one, (state, dq, 0 * dq), None, length={steps})[0]
jax.block_until_ready(run(state, dq))
began, used = time.perf_counter(), time.process_time()
jax.block_until_ready(run(state, dq))
print(time.perf_counter() - began, time.process_time() - used)
""",
}


def rippling() -> FrictionModel:
    """Three joints with LuGre, load and ripple of two orders."""
    values = {"sigma_0": 3e3, "sigma_1": 15.0, "sigma_2": 6.0, "F_c": 9.0, "F_s": 12.0, "v_s": 0.1,
              "tau_0": 0.4, "mu": 0.02, "lag": 4e-3, "smoothing": 2e-3}  # fmt: skip
    waves = {f"ripple{k}_{part}": 0.3 for k in (2, 8) for part in ("cos", "sin")}
    structure = {"ripple": {"gear_ratio": 101.0, "orders": [2, 8]}}
    form = registry()["lugre_load_ripple"].form(structure)
    law = FrictionLaw(
        name="lugre_load_ripple", structure=structure, form=form, values=values | waves
    )
    return FrictionModel(
        law=law.name, robot="bench", joints=("a", "b", "c"), laws=(law,) * 3, sample_time=0.005
    )


MODELS = {"Table I": lambda: FrictionModel.read(model_file("uf850-table1")), "ripple": rippling}


@pytest.mark.parametrize("law", MODELS)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("library", ["torch", "jax"])
def test_many_joints(
    library: str, dtype: str, law: str, tmp_path: Path, tell: Callable[[str], None]
) -> None:
    """Targets on two cores: 10 s in PyTorch, 3 s in JAX, for 1000 steps."""
    python = PYTHON[library]
    ready = [python, "-c", f"import {library}"]
    if not python.exists() or subprocess.run(ready, capture_output=True, check=False).returncode:
        pytest.skip(f"{library} is not installed")
    EXPORT[library](MODELS[law](), tmp_path / "law.py")
    text = RUN[library].format(dtype=dtype, steps=STEPS)
    answer = subprocess.run(
        [python, "-c", text], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    wall, used = map(float, answer.stdout.split())
    tell(
        f"{library}, {dtype}, {law}: {wall:.1f} s, {used:.1f} s of the processor, "
        f"for {STEPS} steps of 100,002 joints"
    )
