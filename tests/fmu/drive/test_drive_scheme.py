"""One inner step of a drive is the first root of its residual, computed here in NumPy."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from drive_runs import Run, drive, reversals
from oracles.over_log import step_coefficients
from oracles.stepper import Stepper
from scipy.optimize import brentq

from fmu_src.run.fmu import FmuInstance
from hesr_model.equations.functions import to_numpy_function
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw, LawForm

AGREEMENT = 1e-9
LOAD = 3.0  # [N.m]
BESIDE_ZERO = 1e-200
LAWS = ("parfam_tanh", "parfam_sin", "bare", "viscous", "lugre", "elements", "gaussians")

Array = np.ndarray


@cache
def functions(form: LawForm) -> tuple[Any, Any]:
    arguments = (*(c.symbol for c in form.coefficients), *INPUTS)
    states = tuple(s for r in form.relaxations for s in (r.state, r.derivative))
    relaxations = tuple(e for r in form.relaxations for e in (r.drive, r.rate))
    return to_numpy_function(arguments, relaxations), to_numpy_function(
        (*arguments, *states), (form.output,)
    )


@dataclass(frozen=True, kw_only=True)
class Stepped:
    """Consequences of speeds at the end of a step: (N,) each, states (N,) in pairs x, x'."""

    residual: Array
    tau_f: Array
    tau_link: Array
    states: list[Array]


@dataclass(frozen=True, kw_only=True)
class Place:
    """State of a joint, torques on it, and its motor."""

    law: FrictionLaw
    inertia: float
    q: float = 0.0
    dq: float = 0.0
    x: tuple[float, ...] = ()
    tau_motor: float = 0.0
    ratio: float = 1.0
    link: Mapping[str, float] = field(default_factory=dict)

    def at(self, v: Array, step: float) -> Stepped:
        """Evaluate the residual at speeds of the motor."""
        inputs = (v / self.ratio, (self.q + step * v) / self.ratio, np.full(v.shape, LOAD))
        values = tuple(self.law.values.values())
        relaxations, output = functions(self.law.form)
        found = [np.broadcast_to(e, v.shape) for e in relaxations(*values, *inputs)]
        states: list[Array] = []
        for drives, rate, before in zip(found[::2], found[1::2], self.x, strict=True):
            a, c = step_coefficients(drives, rate, np.full(v.shape, step), self.law.discretisation)
            x = a * before + c
            states += [x, drives - rate * x]
        tau_f = np.broadcast_to(output(*values, *inputs, *states)[0], v.shape)
        k, d, q_link, dq_link = (
            self.link.get(n, 0.0) for n in ("stiffness", "damping", "q_link", "dq_link")
        )
        tau_link = k * (inputs[1] - q_link) + d * (inputs[0] - dq_link)
        inert = self.inertia * (v - self.dq) / step
        residual = inert - self.tau_motor + (tau_f + tau_link) / self.ratio
        return Stepped(residual=residual, tau_f=tau_f, tau_link=tau_link, states=states)

    def speed(self, step: float) -> tuple[float, bool, int]:
        """First root from the old speed outwards, whether the joint sticks there, and the number of
        roots."""
        first = self.at(np.array([self.dq]), step).residual[0]
        # For friction rising with speed the root lies within step / inertia * |first|.
        outward, reach = -np.sign(first), step / self.inertia * (abs(first) + 60.0)
        strides = np.union1d(np.geomspace(1e-9, 3.0, 600), np.linspace(0.0, 3.0, 2000))
        v = np.concatenate([self.dq + outward * reach * strides, [-BESIDE_ZERO, BESIDE_ZERO]])
        v = np.unique(v[outward * v >= outward * self.dq])[:: int(outward)]
        signs = np.sign(self.at(v, step).residual)
        places = np.flatnonzero(signs[1:] != signs[:-1])
        near, far = v[places[0]], v[places[0] + 1]
        if max(abs(near), abs(far)) <= BESIDE_ZERO:
            return 0.0, True, len(places)
        root = brentq(
            lambda s: self.at(np.array([s]), step).residual[0], near, far, xtol=1e-300, rtol=1e-15
        )
        return float(root), False, len(places)


def start_of(places: list[Place]) -> dict[str, float]:
    start: dict[str, float] = {"start_mode": 2}
    for i, own in enumerate(places, start=1):
        start |= {
            f"inertia[{i}]": own.inertia, f"ratio[{i}]": own.ratio, f"tau_load[{i}]": LOAD,
            f"q_start[{i}]": own.q, f"dq_start[{i}]": own.dq, f"tau_motor[{i}]": own.tau_motor,
        }  # fmt: skip
        start |= {f"{name}[{i}]": value for name, value in own.link.items()}
        names = [f"{r.name}_start[{i}]" for r in own.law.form.relaxations]
        start |= dict(zip(names, own.x, strict=True))
    return start


def somewhere(law: FrictionLaw, rng: np.random.Generator, *, linked: bool) -> Place:
    """Fast, slow or at rest, forwards or backwards, with any gear ratio."""
    signs = rng.choice((-1.0, 1.0), 3)
    link = {"stiffness": 10.0 ** rng.uniform(1, 4), "damping": 10.0 ** rng.uniform(-1, 2),
            "q_link": rng.uniform(-0.01, 0.01), "dq_link": rng.uniform(-1, 1)}  # fmt: skip
    return Place(
        law=law,
        inertia=10.0 ** rng.uniform(-0.5, 0.5),
        q=rng.uniform(-0.01, 0.01),
        dq=signs[0] * 10.0 ** rng.uniform(-6, 0) * (rng.random() < 0.8),
        x=tuple(rng.uniform(-5e-3, 5e-3, len(law.form.relaxations))),
        tau_motor=signs[1] * 10.0 ** rng.uniform(-2, 2),
        ratio=signs[2] * rng.uniform(1, 3) if linked else 1.0,
        link=link if linked else {},
    )


@pytest.mark.parametrize("discretisation", ["exact", "euler"])
@pytest.mark.parametrize("linked", [False, True])
@pytest.mark.parametrize("step", [1e-4, 1e-3, 1e-2])
def test_a_step_balances_the_torques(
    make_law, tmp_path: Path, step: float, linked: bool, discretisation: str
) -> None:
    # Euler's condition rate * step < 1 does not hold for stiff bristles.
    names = LAWS if discretisation == "exact" else ("parfam_tanh", "parfam_sin", "viscous")
    laws = {name: replace(make_law(name), discretisation=discretisation) for name in names}
    fmu, rng, sticking = drive(laws, tmp_path, [1.0] * len(laws)), np.random.default_rng(1), 0
    with FmuInstance(fmu) as component:
        for _ in range(20):
            places = [somewhere(law, rng, linked=linked) for law in laws.values()]
            if component.used:
                component.reset()
            component.initialise(start={"substep": step} | start_of(places))
            component.step(0.0, step)
            for i, own in enumerate(places, start=1):
                sticking += assert_stepped(component, own, i, step)
    assert sticking >= 2  # `viscous` jumps at rest


def assert_stepped(component: FmuInstance, own: Place, i: int, step: float) -> bool:
    q, dq, ddq, tau_f, tau_link = component.get(
        [f"{n}[{i}]" for n in ("q", "dq", "ddq", "tau_f", "tau_link")]
    )
    speed, sticks, _ = own.speed(step)
    said = f"joint {i}: {own}"
    scale = max(abs(speed), 1e-3 * abs(own.dq), 1e-9)
    assert dq == pytest.approx(speed, rel=0, abs=AGREEMENT * scale), said
    assert q == pytest.approx(own.q + step * dq, rel=1e-13, abs=1e-18), said
    assert ddq == pytest.approx((dq - own.dq) / step, rel=1e-12, abs=0.0), said
    expected = own.at(np.array([dq]), step)
    inert = own.inertia * (dq - own.dq) / step
    friction = expected.tau_f[0]
    if sticks:
        assert dq == 0.0, said
        friction = own.ratio * (own.tau_motor - inert) - expected.tau_link[0]
    size = abs(friction) + abs(own.ratio) * (abs(own.tau_motor) + abs(inert))
    assert tau_f == pytest.approx(friction, rel=0, abs=AGREEMENT * size), said
    assert tau_link == pytest.approx(expected.tau_link[0], rel=1e-9, abs=1e-12), said
    names = [n for r in own.law.form.relaxations for n in (f"{r.name}[{i}]", f"der({r.name}[{i}])")]
    if names:
        np.testing.assert_allclose(
            component.get(names), [x[0] for x in expected.states], rtol=1e-7, atol=1e-12
        )
    return sticks


def test_the_nearest_of_several_roots_is_used(table1, tmp_path: Path) -> None:
    """Table I, joint 2: friction that falls with speed, and a joint that it hardly holds."""
    law, step, several = replace(table1.laws[1], discretisation="exact"), 1e-3, 0
    fmu = drive({"j2": law}, tmp_path, [0.6])
    own = Place(law=law, inertia=0.6, x=law.start)
    with FmuInstance(fmu) as component:
        component.initialise(start={"substep": step})
        for k in range(400):
            own = replace(own, tau_motor=30.0 * np.sin(10.0 * np.pi * (k + 0.5) * step))
            component.set({"tau_motor[1]": own.tau_motor})
            component.step(k * step, step)
            q, dq, h = component.get(["q[1]", "dq[1]", "h[1]"])
            speed, _, found = own.speed(step)
            several += found > 1
            assert dq == pytest.approx(speed, rel=1e-8, abs=1e-12), k
            own = replace(own, q=q, dq=dq, x=(h,))
    assert several >= 10


@pytest.mark.parametrize("ratio", [1.0, 2.5, -2.0])
def test_a_flexspline_moves_the_link(make_law, tmp_path: Path, ratio: float) -> None:
    """Motor, gear, spring and link, friction 3 dq: a linear system in closed form."""
    inertia, own, k, d, torque, end = 0.4, 1.5, 900.0, 6.0, 2.0, 0.5
    fmu = drive(
        {"bare": make_law("bare")}, tmp_path, [inertia], stiffness=[k], damping=[d], ratio=[ratio]
    )
    # (motor angle, motor speed, link angle, link speed)
    spring = np.array([[-k / ratio, -d / ratio, k, d]])  # minus the torque on the link
    matrix = np.zeros((4, 4))
    matrix[0, 1] = matrix[2, 3] = 1.0
    matrix[1] = spring / (ratio * inertia)
    matrix[1, 1] -= 3.0 / (ratio**2 * inertia)
    matrix[3] = -spring / own
    forced = np.zeros((5, 5))
    forced[:4, :4], forced[1, 4] = matrix, torque / inertia
    truth = scipy.linalg.expm(end * forced)[:4, 4]
    errors = []
    for step in (1e-3, 1e-4):
        q_link = dq_link = 0.0
        with FmuInstance(fmu) as component:
            component.initialise(start={"tau_motor[1]": torque, "substep": step})
            for n in range(round(end / step)):
                component.set({"q_link[1]": q_link, "dq_link[1]": dq_link})
                component.step(n * step, step)
                dq_link += step * component.get(["tau_link[1]"])[0] / own
                q_link += step * dq_link
            found = [*component.get(["q[1]", "dq[1]"]), q_link, dq_link]
        errors.append(np.abs(found - truth) / np.abs(truth))
    assert errors[1].max() < 5e-3
    assert errors[1].max() < 0.2 * errors[0].max()


def test_a_drive_reverses_twice_without_chatter(table1, tmp_path: Path) -> None:
    """Table I on 0.6 kg.m2 at 1 ms, a slow torque cycle: one reversal each way."""
    step, inertia = 1e-3, 0.6
    tau = np.cos(0.1 * np.pi * np.arange(0.0, 20.0, step))[:, None] * (20.0, 30.0, 11.0)
    laws = [replace(law, discretisation="exact") for law in table1.laws]
    fmu = drive(dict(zip("abc", laws, strict=True)), tmp_path, [inertia] * 3)
    coarse, fine = (
        Run(fmu, tau, grid=step, step=step, substep=substep).dq for substep in (step, 1e-5)
    )
    for joint, law in enumerate(laws):
        stepper, v, explicit = Stepper(law), 0.0, []
        for torque in tau[:, joint]:
            v += step / inertia * (torque - stepper.step(step, v))
            explicit.append(v)
        assert reversals(np.array(explicit)) > 100
        assert reversals(coarse[:, joint]) == reversals(fine[:, joint]) == 2
