"""Hand-written friction laws and their FMUs."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
from binary import Binary
from registry_models import STUDIED, everyday

from hesr_model.equations.functions import absolute, sgn
from hesr_model.equations.memory import Relaxation
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.parfam import family
from hesr_model.rigid_body.friction_record import FrictionRecord

FEATURES = ["1", "dq", "h", "dh"]


def law_of(form: LawForm, values: Sequence[float], **more: Any) -> FrictionLaw:
    names = [c.name for c in form.coefficients]
    return FrictionLaw(
        name="by_hand", form=form, values=dict(zip(names, values, strict=True)), **more
    )


def coefficients(**units: str) -> tuple[Coefficient, ...]:
    return tuple(Coefficient(name=n, unit=u, description=f"the {n}") for n, u in units.items())


def parfam(g: str) -> FrictionLaw:
    form = family.form({"linear": FEATURES, "units": [{"g": g, "arguments": FEATURES}]})
    # alpha is small enough for Euler at the longest step of `motion`
    return law_of(form, (-2.1, 1.4, 6.2, -0.16, 3.7, 0.06, 0.19, -0.6, 0.064, 11.37, 256.84))


def viscous() -> FrictionLaw:
    """No state, all inputs."""
    own = coefficients(F_c="N.m", sigma_2="N.m.s/rad", mu="1", a="N.m", n="1/rad")
    f_c, sigma_2, mu, a, n = (c.symbol for c in own)
    level = f_c + mu * absolute(TAU_LOAD)
    output = level * sgn(DQ) + sigma_2 * DQ**3 + a * sympy.cos(n * Q) ** 2
    return law_of(LawForm(coefficients=own, output=output), (4.5, 12.0, 0.1, 0.5, 200.0))


def lugre() -> FrictionLaw:
    own = coefficients(sigma_0="N.m/rad", sigma_1="N.m.s/rad", F_c="N.m", F_s="N.m", v_s="rad/s")
    sigma_0, sigma_1, f_c, f_s, v_s = (c.symbol for c in own)
    level = f_c + (f_s - f_c) * sympy.exp(-((DQ / v_s) ** 2))
    z = Relaxation(name="z", unit="rad", drive=DQ, rate=sigma_0 * absolute(DQ) / level)
    output = sigma_0 * z.state + sigma_1 * z.derivative
    form = LawForm(coefficients=own, memory=(z,), output=output)
    return law_of(form, (2.0e3, 1.5, 9.0, 12.0, 0.08))


def elements() -> FrictionLaw:
    """Several states with start values; the rate of one is zero at rest."""
    own = coefficients(k1="1/rad", k2="1/rad", c1="N.m", c2="N.m")
    k1, k2, c1, c2 = (c.symbol for c in own)
    x = [
        Relaxation(name=f"x{i}", unit="1", drive=k * DQ, rate=k * absolute(DQ))
        for i, k in enumerate((k1, k2), start=1)
    ]
    form = LawForm(
        coefficients=own,
        memory=tuple(x),
        output=c1 * x[0].state + c2 * x[1].state + sympy.pi * x[1].derivative / 1000,
    )
    return law_of(form, (60.0, 7.0, 3.0, 4.0), start=(0.3, -0.2))


def gaussians() -> FrictionLaw:
    """More coefficients than an FMU exposes."""
    names = [f"{kind}{i}" for i in range(30) for kind in ("w", "m", "s")]
    own = coefficients(**dict.fromkeys(names, "1"))
    w, m, s = (own[i::3] for i in range(3))
    output = sum(
        a.symbol * sympy.exp(-(((DQ - b.symbol) / c.symbol) ** 2))
        for a, b, c in zip(w, m, s, strict=True)
    )
    rng = np.random.default_rng(3)
    values = np.column_stack([rng.normal(size=30), rng.normal(size=30), rng.uniform(0.2, 1, 30)])
    return law_of(LawForm(coefficients=own, output=output), values.ravel().tolist())


def bare() -> FrictionLaw:
    """Neither coefficients nor states."""
    return law_of(LawForm(coefficients=(), output=3 * DQ), ())


HAND_MADE: Mapping[str, Callable[[], FrictionLaw]] = {
    **{f"parfam_{g}": (lambda g=g: parfam(g)) for g in family.FUNCTIONS},
    "bare": bare,
    "viscous": viscous,
    "lugre": lugre,
    "elements": elements,
    "gaussians": gaussians,
}


@pytest.fixture(params=list(HAND_MADE))
def law(request: pytest.FixtureRequest) -> FrictionLaw:
    return HAND_MADE[request.param]()


EVERY_LAW = (*HAND_MADE, *(f"fitted_{name}" for name in STUDIED))


@pytest.fixture(scope="session", params=EVERY_LAW)
def any_law(request: pytest.FixtureRequest) -> str:
    """Name of a hand-written law or of one in the registry."""
    return request.param


@pytest.fixture(scope="session")
def make_law() -> Callable[[str], FrictionLaw]:
    return lambda name: HAND_MADE[name]()


@pytest.fixture(scope="session")
def make_model() -> Callable[..., FrictionModel]:
    def make(*laws: FrictionLaw, **more: Any) -> FrictionModel:
        joints = tuple(f"axis_{i}" for i, _ in enumerate(laws, start=1))
        data: dict[str, Any] = {"law": "by_hand", "robot": "bench", "sample_time": 0.005} | more
        return FrictionModel(joints=joints, laws=laws, **data)

    return make


@pytest.fixture(scope="session")
def fitted(make_motion, shared) -> dict[str, FrictionLaw]:
    """Every law of the registry, fitted to the torque of a hand-written law."""
    t, dq, q, load = (np.squeeze(x) for x in make_motion(1))
    tau = 5.0 * np.tanh(50.0 * dq) + 3.0 * dq + np.random.default_rng(1).normal(0, 0.1, t.shape)
    record = FrictionRecord(log="made", joint="axis", t=t, dq=dq, q=q, tau_load=load, tau=tau)

    def fit(folder: Path) -> None:
        for name, estimator in everyday().items():
            law = estimator().fit([record], np.random.default_rng(0))
            model = FrictionModel(
                law=name, robot="bench", joints=("axis",), laws=(law,), sample_time=0.005
            )
            model.write(folder / f"{name}.json")

    folder = shared("fitted", fit)
    return {name: FrictionModel.read(folder / f"{name}.json").laws[0] for name in everyday()}


@pytest.fixture(scope="session")
def every_law(make_law, fitted) -> dict[str, FrictionLaw]:
    laws = {name: make_law(name) for name in HAND_MADE}
    return laws | {f"fitted_{name}": law for name, law in fitted.items()}


Motion = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture(scope="session")
def make_motion() -> Callable[[int], Motion]:
    """Time, velocity, position and load of a motion with rests, reversals and uneven steps."""

    def make(joints: int) -> Motion:
        rng = np.random.default_rng(7)
        t = 3.0 + np.cumsum(rng.uniform(0.001, 0.008, size=900))
        phase = rng.uniform(0, 2 * math.pi, size=joints)
        q = np.sin(2.0 * t[:, None] + phase) + 0.2 * np.sin(9.0 * t[:, None])
        dq = 2.0 * np.cos(2.0 * t[:, None] + phase) + 1.8 * np.cos(9.0 * t[:, None])
        dq[200:260] = 0.0
        dq[400:420] = 1e-9  # series branch of phi
        return t, dq, q, 20.0 * np.sin(t[:, None] + phase)

    return make


@pytest.fixture
def binary(table1_fmu: Path, tmp_path: Path) -> Iterator[Binary]:
    return Binary(table1_fmu, tmp_path)


@pytest.fixture(scope="session")
def load(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path], Binary]:
    return lambda fmu: Binary(fmu, tmp_path_factory.mktemp("binary"))
