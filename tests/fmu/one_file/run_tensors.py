"""Run a generated file with its library: torques in both precisions and slopes of a sum.

python run_tensors.py torch|jax FOLDER: the file is FOLDER/law.py; rows.npz next to it has (N, n)
dq, q and load, `weights` (M, n) of the sum over the first M rows, and the step. Results are
written to found.npz.
"""

import sys
from pathlib import Path

import numpy as np

CHANGES = 1e-4 * np.array([-2.0, -1.0, 1.0, 2.0])
"""Relative changes of a coefficient, and weights of the sums for a fourth-order slope."""
RULE = np.array([1.0, -8.0, 8.0, -1.0]) / 12e-4


def of_torch(law, step):
    import torch

    def torques(c, rows, dtype, batch=()):
        state, found = law.start(batch, dtype), []
        for row in zip(*(torch.tensor(r, dtype=dtype) for r in rows), strict=True):
            tau, state = law.step(c, state, *(u.expand(*batch, -1) for u in row), step)
            found.append(tau)
        return torch.stack(found)

    def slopes(rows, weights):
        c = [
            {k: v.requires_grad_() for k, v in of.items()} for of in law.coefficients(torch.float64)
        ]
        (torques(c, rows, torch.float64) * torch.tensor(weights)).sum().backward()
        return [{k: v.grad.numpy() for k, v in of.items()} for of in c]

    def run(c, rows, single=False, batch=()):
        dtype = torch.float32 if single else torch.float64
        c = [{k: torch.tensor(v, dtype=dtype) for k, v in of.items()} for of in c]
        with torch.no_grad():
            return torques(c, rows, dtype, batch).numpy()

    def begun(row):
        c = law.coefficients(torch.float64)
        row = [torch.tensor(r) for r in row]
        return law.step(c, law.begin(c, *row), *row, 0.0)[0].numpy()

    return run, slopes, begun


def of_jax(law, step):
    import jax
    import jax.numpy as xp

    jax.config.update("jax_enable_x64", True)

    def torques(c, rows, dtype, batch=()):
        n = rows[0].shape[-1]
        rows = (xp.array(r, dtype).reshape(-1, *(1 for _ in batch), n) for r in rows)
        rows = (xp.broadcast_to(r, (len(r), *batch, n)) for r in rows)
        return law.run(c, law.start(batch, dtype), *rows, step)[0]

    def slopes(rows, weights):
        of = jax.grad(lambda c: (torques(c, rows, xp.float64) * weights).sum())
        return jax.tree.map(np.array, of(law.coefficients(xp.float64)))

    def run(c, rows, single=False, batch=()):
        dtype = xp.float32 if single else xp.float64
        c = [{k: xp.array(v, dtype) for k, v in of.items()} for of in c]
        return np.array(torques(c, rows, dtype, batch))

    def begun(row):
        c = law.coefficients(xp.float64)
        row = [xp.array(r) for r in row]
        return np.array(law.step(c, law.begin(c, *row), *row, 0.0)[0])

    return run, slopes, begun


def changed(law):
    """Coefficients of a batch of robots: row (i, k) has the i-th of each law changed."""
    most = max(len(values) for _, _, _, values, _ in law._LAWS)
    for _, _, joints, values, _ in law._LAWS:
        own = {}
        for i, (name, value) in enumerate(values.items()):
            factor = np.ones((most, len(CHANGES), 1))
            factor[i, :, 0] += CHANGES
            own[name] = (factor * np.array(value)).reshape(-1, len(joints))
        yield own


if __name__ == "__main__":
    folder = Path(sys.argv[2])
    sys.path.insert(0, str(folder))
    import law

    data = np.load(folder / "rows.npz")
    run, slopes, begun = {"torch": of_torch, "jax": of_jax}[sys.argv[1]](law, float(data["step"]))
    rows, weights = [data[name] for name in ("dq", "q", "load")], data["weights"]
    first = [r[: len(weights)] for r in rows]
    plain = [{k: np.array(v) for k, v in values.items()} for _, _, _, values, _ in law._LAWS]
    every = {"double": run(plain, rows), "single": run(plain, rows, single=True)}
    every["begun"] = begun([r[:3] for r in rows])
    if any(plain):
        found = slopes(first, weights)
        batch = max(map(len, plain)) * len(CHANGES)
        sums = np.einsum("tbn,tn->bn", run([*changed(law)], first, batch=(batch,)), weights)
        finite = np.einsum("ikn,k->in", sums.reshape(-1, len(CHANGES), sums.shape[-1]), RULE)
        for n, (_, _, joints, values, _) in enumerate(law._LAWS):
            for i, (name, value) in enumerate(values.items()):
                share = found[n][name] * np.array(value)
                every[f"{n} {name}"] = np.stack([share, finite[i][list(joints)]])
    np.savez(folder / "found.npz", **every)
