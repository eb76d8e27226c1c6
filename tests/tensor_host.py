"""Run files for PyTorch or JAX with their library, which most test processes do not have.

python tensor_host.py torch|jax FOLDER..: each folder has law.py and rows.npz with (N, n) dq, q and
tau_load, the step, and the rows at which an instance begins in motion. The torques are written to
torques.npz: `stepped` in double and `single` in single precision (N, n), `first` (K, n).
"""

import importlib.util
import sys
from pathlib import Path

import numpy as np


def torch_torques(law, rows, begins, step):
    import torch

    def run(dtype):
        coefficients = law.coefficients(dtype)
        state, torques = law.start((), dtype), []
        for row in zip(*(torch.tensor(column, dtype=dtype) for column in rows), strict=True):
            tau, state = law.step(coefficients, state, *row, step)
            torques.append(tau)
        return torch.stack(torques).numpy()

    def begin(k):
        coefficients = law.coefficients(torch.float64)
        row = [torch.tensor(column[k]) for column in rows]
        return law.step(coefficients, law.begin(coefficients, *row), *row, 0.0)[0].numpy()

    with torch.no_grad():
        return run(torch.float64), run(torch.float32), np.array([begin(k) for k in begins])


def jax_torques(law, rows, begins, step):
    import jax
    import jax.numpy as xp

    jax.config.update("jax_enable_x64", True)

    def run(dtype):
        columns = [xp.array(column, dtype) for column in rows]
        return np.array(law.run(law.coefficients(dtype), law.start((), dtype), *columns, step)[0])

    def begin(k):
        coefficients = law.coefficients(xp.float64)
        row = [xp.array(column[k]) for column in rows]
        return np.array(law.step(coefficients, law.begin(coefficients, *row), *row, 0.0)[0])

    return run(xp.float64), run(xp.float32), np.array([begin(k) for k in begins])


def main(library, *folders):
    torques = {"torch": torch_torques, "jax": jax_torques}[library]
    for folder in map(Path, folders):
        spec = importlib.util.spec_from_file_location(f"law_{folder.name}", folder / "law.py")
        law = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(law)
        data = np.load(folder / "rows.npz")
        rows = [data[name] for name in ("dq", "q", "tau_load")]
        stepped, single, first = torques(law, rows, data["begins"], float(data["step"]))
        np.savez(folder / "torques.npz", stepped=stepped, single=single, first=first)


if __name__ == "__main__":
    main(*sys.argv[1:])
