"""The files for PyTorch and JAX compared with the FMU, if the libraries are available."""

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import sympy
from documents import blocks
from one_file_laws import STEP, first_torques_of, inputs, maxwell_slip, torques_of

from fmu_src.friction.friction_fmu import export_bare
from hesr.extras.one_file.tensors import export_jax, export_torch, tensor_code
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import DQ, Q
from hesr_model.friction.law import FrictionLaw, LawForm

pytestmark = pytest.mark.ci

HERE = Path(__file__).parent
DEBIAN = Path("/usr/bin/python3")
EXPORT = {"torch": export_torch, "jax": export_jax}
ROWS, SLOPES = 200, 40


def _runs(*command: object) -> bool:
    try:
        return not subprocess.run([*map(str, command)], capture_output=True, check=False).returncode
    except OSError:
        return False


@pytest.fixture(scope="module", params=["torch", "jax"])
def library(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def python(library: str) -> Path:
    """The Python interpreter that has the library."""
    if library == "torch" and not _runs(DEBIAN, "-c", "import torch"):
        pytest.skip("Debian's python3-torch is not installed")
    if library == "jax" and find_spec("jax") is None:
        pytest.skip("JAX is not installed: run `make jax` first")
    return DEBIAN if library == "torch" else Path(sys.executable)


def run(python: Path, library: str, model, folder: Path, rows, count: int = SLOPES):
    """Torques in double and single precision, and slopes as (found, finite differences)."""
    EXPORT[library](model, folder / "law.py")
    weights = np.random.default_rng(2).uniform(0.5, 1.5, size=(count, len(model.joints)))
    np.savez(
        folder / "rows.npz",
        **dict(zip(("dq", "q", "load"), rows, strict=True)),
        weights=weights,
        step=STEP,
    )
    answer = subprocess.run(
        [python, HERE / "run_tensors.py", library, folder],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert answer.returncode == 0, answer.stderr
    found = dict(np.load(folder / "found.npz"))
    return found.pop("double"), found.pop("single"), found


def assert_equal(found: np.ndarray, expected: np.ndarray, allowed: float) -> None:
    size = np.abs(expected).max(axis=0)
    # A law without friction has no torque that an error is relative to.
    worst = np.abs(found - expected).max(axis=0) / np.where(size > 0.0, size, 1.0)
    assert np.all(worst <= allowed), worst


@pytest.fixture(
    scope="module",
    params=["hand_made", pytest.param("every", marks=pytest.mark.nightly("laws"))],
)
def some_laws(request, every_law, make_model, shared):
    """Laws by hand, or those and all of the registry, as joints of one robot, and its FMU."""
    names = [n for n in every_law if request.param == "every" or not n.startswith("fitted_")]
    model = make_model(*(every_law[name] for name in names), maxwell_slip())

    def export(folder: Path) -> None:
        export_bare(model, folder / "F.fmu")

    return model, shared(f"{request.param}_fmu", export) / "F.fmu"


@pytest.fixture(scope="module")
def every(python, library, some_laws, tmp_path_factory):
    model, fmu = some_laws
    rows = inputs(len(model.joints), seconds=ROWS * STEP)
    return rows, run(python, library, model, tmp_path_factory.mktemp(library), rows), fmu


def test_laws_on_joints_of_one_robot_match_the_fmu(every) -> None:
    """Including forms that no law of the registry has."""
    rows, (double, single, found), fmu = every
    expected = torques_of(fmu, rows)
    assert_equal(double, expected, 1e-12)
    assert_equal(single, expected, 1e-4)
    for k, torque in enumerate(found["begun"]):
        first = first_torques_of(fmu, tuple(row[k] for row in rows))
        np.testing.assert_allclose(torque, first, rtol=1e-12, atol=1e-12)


def test_coefficient_slopes_match_finite_differences(every) -> None:
    """Each multiplied by its coefficient, relative to the largest of the same joint."""
    _, (_, _, slopes), _ = every
    slopes = {name: both for name, both in slopes.items() if name != "begun"}
    assert len(slopes) > 100
    for name, (found, finite) in slopes.items():
        assert np.all(np.abs(found - finite) <= 1e-6 * np.maximum(np.abs(finite), 1.0)), name


def test_ripple_far_from_zero_keeps_its_phase(python, library, make_model, tmp_path) -> None:
    """Sixteen times a gear of 160, some turns away: single precision alone has lost the phase."""
    law = FrictionLaw(
        name="ripple",
        form=LawForm(coefficients=(), output=DQ + sympy.cos(2560 * (Q - DQ / 500))),
        values={},
    )
    model = make_model(law)
    dq, q, load = inputs(1, seconds=2.0)
    rows = (dq, (q + 20.0).astype(np.float32).astype(float), load)
    double, single, _ = run(python, library, model, tmp_path, rows, 5)
    # With more digits than the FMU, whose own phase is off by 4e-12 rad at that angle.
    wide_dq, wide_q = (row.astype(np.longdouble) for row in rows[:2])
    exact = wide_dq + np.cos(2560 * (wide_q - wide_dq / 500))
    assert_equal(double, exact, 1e-13)
    assert_equal(single, torques_of(export_bare(model, tmp_path / "F.fmu"), rows), 1e-4)
    naive = np.cos(np.float32(2560) * rows[1].astype(np.float32))
    assert np.abs(naive - np.cos(2560 * rows[1])).max() > 1e-3


def test_a_file_checks_itself_against_its_data(python, library, table1, tmp_path) -> None:
    path = EXPORT[library](table1, tmp_path / "law.py")
    command = [python, path, path.with_suffix(".csv")]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.count("of the peak, allowed") == 2
    data = path.with_suffix(".csv")
    data.write_text(data.read_text().replace(",0.", ",0.1", 200))
    assert subprocess.run(command, capture_output=True, check=False).returncode == 1


MODULE = """
import torch, law
friction = law.Friction(torch.float64)
state = friction.start((4, 2))
dq = torch.linspace(-1, 1, 24, dtype=torch.float64).reshape(4, 2, 3)
tau, state = friction(state, dq)
assert tau.shape == (4, 2, 3) and all(x.shape[:2] == (4, 2) for x in state)
fresh = friction.reset(state, torch.tensor([1, 3]))
assert all((x[[1, 3]] == 0).all() and (x[[0, 2]] == y[[0, 2]]).all() for x, y in zip(fresh, state))
assert not any(p.requires_grad for p in friction.parameters())
friction.requires_grad_()
friction(state, dq)[0].sum().backward()
assert all(p.grad is not None for p in friction.parameters())
assert set(friction.state_dict()) >= {"coefficients.0.alpha", "coefficients.2.beta"}
"""


MANY = """
import torch, law
n, part = 40000, slice(25000, 25100)
dq = torch.linspace(-1, 1, 3 * n, dtype=torch.float64).reshape(n, 3)
assert dq.numel() > 2 * law._AT_ONCE > 2 * dq[part].numel()
whole = law.coefficients(torch.float64)  # each robot has coefficients of its own
own = [{k: (v * (1 + torch.arange(n)[:, None] / n)).requires_grad_() for k, v in c.items()}
       for c in whole]
state = law.start((n,), torch.float64)
tau, moved = law.step(own, state, dq, q=3 * dq)
some = [{k: v[part].detach().requires_grad_() for k, v in c.items()} for c in own]
tau_some, moved_some = law.step(some, [x[part] for x in state], dq[part], 3 * dq[part])
def alike(a, b):
    return torch.allclose(a, b, rtol=1e-14, atol=0.0)
assert alike(tau[part], tau_some) and all(map(alike, (x[part] for x in moved), moved_some))
tau.sum().backward(), tau_some.sum().backward()
for a, b in zip(own, some):
    assert all(alike(a[k].grad[part], b[k].grad) for k in a if b[k].grad is not None)
"""


@pytest.mark.parametrize("use", [MODULE, MANY], ids=["module", "many robots"])
def test_usual_torch_operations_work(table1, tmp_path, use) -> None:
    if not _runs(DEBIAN, "-c", "import torch"):
        pytest.skip("Debian's python3-torch is not installed")
    export_torch(table1, tmp_path / "law.py")
    answer = subprocess.run(
        [DEBIAN, "-c", use], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert answer.returncode == 0, answer.stderr


BASES = """
import sys, types, torch
class Pd:
    _device, _num_envs = "cpu", 4
    def __init__(self, cfg): self.cfg = cfg
    def initialize(self, mj_model, model, data, device): pass
    def compute(self, command, *motion):
        return command if motion else command.effort
def package(name, **members):
    sys.modules[name] = types.ModuleType(name)
    vars(sys.modules[name]).update(members)
package("isaaclab"), package("mjlab")
package("isaaclab.actuators", IdealPDActuator=Pd), package("mjlab.actuator", IdealPdActuator=Pd)
"""
ISAAC = """
actuator = FrictionActuator(types.SimpleNamespace(dt=0.005))
q, dq = torch.full((4, 3), 0.1), torch.full((4, 3), 0.5)
found = lambda: actuator.compute(types.SimpleNamespace(joint_efforts=10 * dq), q, dq).joint_efforts
"""
MJLAB = """
actuator = FrictionPdActuator(None)
space = types.SimpleNamespace
actuator.initialize(space(opt=space(timestep=0.005)), None, space(nworld=4), "cpu")
q, dq = torch.full((4, 3), 0.1), torch.full((4, 3), 0.5)
found = lambda: actuator.compute(space(effort=10 * dq, pos=q, vel=dq))
"""
TAUGHT = """
alone = Friction()
state = alone.start((4,))
for _ in range(2):
    tau, state = alone(state, dq, q, dt=0.005)
    assert torch.equal(found(), 10 * dq - tau)
actuator.reset(torch.tensor([2]))
tau, _ = alone(alone.reset(state, torch.tensor([2])), dq, q, dt=0.005)
again = found()
assert torch.equal(again, 10 * dq - tau) and not torch.equal(again[2], again[1])
"""


@pytest.mark.parametrize(
    ("name", "use"), [("FrictionActuator", ISAAC), ("FrictionPdActuator", MJLAB)]
)
def test_the_documented_actuators_work(table1, tmp_path, name, use) -> None:
    """The base classes here only pass the command on; the classes use it as documented."""
    if not _runs(DEBIAN, "-c", "import torch"):
        pytest.skip("Debian's python3-torch is not installed")
    export_torch(table1, tmp_path / "friction.py")
    [block] = (b for b in blocks("python") if f"class {name}(" in b.text)
    answer = subprocess.run(
        [DEBIAN, "-c", BASES + block.text + use + TAUGHT],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr


# --- without the libraries ----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["torch", "jax"])
def test_joints_of_one_form_are_one_function(make_model, make_law, name) -> None:
    text = tensor_code(make_model(*(make_law(n) for n in ("lugre", "bare", "lugre"))), name)
    functions = re.findall(r"\ndef (_law_\w+)", text)
    assert len(functions) == len(set(functions)) == 4  # a step of each form, and its start
    assert sum(name.startswith("_law_1") for name in functions) == 2
    assert "(0, 2)," in text
    compile(text, "law.py", "exec")


def test_texts_cannot_close_a_string(make_model, make_law) -> None:
    model = make_model(make_law("bare"), robot='a """ b\\')
    compile(tensor_code(model, "torch"), "law.py", "exec")


@pytest.mark.parametrize("name", ["torch", "jax"])
def test_the_suffix_must_be_py(table1, tmp_path, name) -> None:
    with pytest.raises(ExportError, match=r"a file for \w+ ends in .py."):
        EXPORT[name](table1, tmp_path / "law.c")
    assert not list(tmp_path.iterdir())


def test_functions_missing_for_tensors_are_refused(make_model) -> None:
    form = LawForm(coefficients=(), output=sympy.besselj(0, DQ))
    with pytest.raises(ExportError, match="has no counterpart in tensor code"):
        tensor_code(make_model(FrictionLaw(name="x", form=form, values={})), "torch")


def test_piecewise_laws_are_refused(make_model) -> None:
    form = LawForm(coefficients=(), output=sympy.Piecewise((DQ, DQ > 0), (0, True)))
    with pytest.raises(ExportError, match="has no counterpart in tensor code"):
        tensor_code(make_model(FrictionLaw(name="x", form=form, values={})), "jax")


def test_joints_must_have_the_same_integration(make_model) -> None:
    h = Relaxation(name="h", unit="1", drive=DQ, rate=sympy.Integer(1))
    form = LawForm(coefficients=(), memory=(h,), output=h.state)
    laws = (
        FrictionLaw(name="x", form=form, values={}, discretisation=d) for d in ("exact", "euler")
    )
    with pytest.raises(ExportError, match="joints use both exact and Euler"):
        tensor_code(make_model(*laws), "torch")
