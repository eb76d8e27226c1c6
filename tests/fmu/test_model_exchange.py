"""In model exchange the FMU gives a solver the law's own differential equation and events."""

import ctypes
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.fmi2 import FMU2Model
from registry_models import STUDIED
from scipy.integrate import DOP853, solve_ivp

from fmu_src.friction.friction_fmu import export_bare
from hesr_model.equations.functions import to_numpy_function
from hesr_model.equations.program import STEEP, Jumps
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw

SPEED, OMEGA = 0.5, 2.0 * np.pi  # of a sine with reversals at 0.25 s, 0.75 s, ..
END = 1.0
TIMES = np.linspace(0.0, END, 201)
NAMES = ("dq[1]", "q[1]", "tau_load[1]")


def motion(t):
    t = np.asarray(t)
    dq = SPEED * np.cos(OMEGA * t)
    return np.stack([dq, SPEED / OMEGA * np.sin(OMEGA * t), 6.0 + 4.0 * np.sin(5.0 * t)])


def parfam_hx() -> FrictionLaw:
    """The law with all optional parts, as written by its estimator."""
    structure = {
        "linear": ["1", "dq", "h", "h_load", "h_bump"],
        "units": [{"g": "tanh", "arguments": ["dq", "h"]}],
        "state": "generalised",
        "ripple": {"gear_ratio": 101.0, "orders": [2]},
    }
    form = estimator("parfam_hx").form(structure)
    values = {c.name: 0.5 + 0.1 * k for k, c in enumerate(form.coefficients)}
    values |= {"alpha": 11.0, "beta": 60.0, "kappa": 4.0, "v_0": 0.1, "v_s": 0.1}
    names = [c.name for c in form.coefficients]
    return FrictionLaw(
        name="parfam_hx", structure=structure, form=form, values={n: values[n] for n in names}
    )


LAWS = ("parfam_tanh", "lugre", "elements", "parfam_hx", "lugre without events")


@pytest.fixture(params=LAWS)
def chosen(request, make_law, make_model, load, tmp_path):
    """A law and its FMU."""
    name, _, none = request.param.partition(" without ")
    law = parfam_hx() if name == "parfam_hx" else make_law(name)
    return law, load(export_bare(make_model(law), tmp_path / "F.fmu", no_events=bool(none)))


def equations(law):
    """Drives and rates of the states as functions of the inputs, and the torque."""
    at = {c.symbol: law.values[c.name] for c in law.form.coefficients}
    parts = [e.subs(at) for r in law.form.relaxations for e in (r.drive, r.rate)]
    states = [s for r in law.form.relaxations for s in (r.state, r.derivative)]
    return to_numpy_function(INPUTS, tuple(parts)), to_numpy_function(
        (*INPUTS, *states), (law.form.output.subs(at),)
    )


def truth(law):
    """Torque by SciPy from the SymPy expressions, without an FMU, from reversal to reversal."""
    moving, torque = equations(law)

    def slope(t, x):
        parts = np.array(moving(*motion(t)))
        return parts[::2] - parts[1::2] * x

    n = len(law.form.relaxations)
    x = np.array(law.start or np.zeros(n))
    rows = []
    for first, last in ((0.0, 0.25), (0.25, 0.75), (0.75, END)):
        inside = TIMES[(first <= TIMES) & (last > TIMES)]
        result = solve_ivp(
            slope, (first, last), x, "Radau", t_eval=[*inside, last], rtol=1e-10, atol=1e-13
        )
        rows += list(result.y.T[: len(inside)])
        x = result.y[:, -1]
    rows.append(x)
    return np.array(
        [
            torque(*motion(t), *np.column_stack([x, slope(t, x)]).ravel())[0]
            for t, x in zip(TIMES, rows, strict=True)
        ]
    )


def relative(found, expected):
    return np.abs(found - expected).max() / np.abs(expected).max()


@dataclass
class Importer:
    """A solver like those of importers: it locates sign changes of indicators."""

    fmu: object
    law: FrictionLaw
    events: int = 0
    asked: bool = False

    def __post_init__(self):
        self.n = len(self.law.form.relaxations)
        self.indicators = self.fmu.about.numberOfEventIndicators
        start = dict(zip(NAMES, motion(0.0), strict=True))
        self.c = self.fmu.continuous(start)

    def go_to(self, t, x):
        assert self.fmu("SetTime", self.c, float(t)) == 0
        assert self.fmu.set_all(self.c, dict(zip(NAMES, motion(t), strict=True))) == 0
        assert self.fmu("SetContinuousStates", self.c, (ctypes.c_double * self.n)(*x), self.n) == 0

    def slope(self, t, x):
        self.go_to(t, x)
        return np.array(self.fmu.numbers("GetDerivatives", self.c, self.n))

    def crossed(self, t, x):
        """Whether an indicator is no longer positive; queries after a step agree."""
        self.go_to(t, x)
        event, end = ctypes.c_int(7), ctypes.c_int(7)
        assert (
            self.fmu("CompletedIntegratorStep", self.c, 1, ctypes.byref(event), ctypes.byref(end))
            == 0
        )
        found = any(
            z <= 0.0 for z in self.fmu.numbers("GetEventIndicators", self.c, self.indicators)
        )
        assert end.value == 0
        assert bool(event.value) == found or not self.indicators
        self.asked = bool(event.value)
        return found

    def torque(self):
        x = np.array(self.fmu.numbers("GetContinuousStates", self.c, self.n))
        t, rows = 0.0, []
        for instant in TIMES:
            while t < instant:
                t, x = self.advance(t, x, instant)
            self.go_to(t, x)
            rows += self.fmu.get(self.c, "tau[1]")
        return np.array(rows)

    def advance(self, t, x, end):
        """Integrate to `end` or just beyond the first event."""
        solver = DOP853(self.slope, t, x, end, rtol=1e-10, atol=1e-13)
        while solver.status == "running":
            before = solver.t
            solver.step()
            if self.crossed(solver.t, solver.y):
                at, y = solver.dense_output(), solver.y
                left, right = before, solver.t
                while right - left > 1e-12:
                    middle = 0.5 * (left + right)
                    if self.crossed(middle, at(middle)):
                        right, y = middle, at(middle)
                    else:
                        left = middle
                self.go_to(right, y)
                self.fmu.event(self.c)
                self.events += 1
                assert not self.crossed(right, y)
                return right, y
            if self.asked:  # without indicators, the solver starts anew at the end of the step
                self.fmu.event(self.c)
                self.events += 1
                return solver.t, solver.y
        return solver.t, solver.y


def test_the_solver_of_an_importer_gives_the_law(chosen):
    law, fmu = chosen
    importer = Importer(fmu, law)
    assert relative(importer.torque(), truth(law)) <= 1e-6
    # Two sign changes of the velocity, to zero and from it, at each of two reversals; one of each
    # if they are seen at the end of a step only.
    bends = bool(Jumps(law.form.component).expressions)
    assert importer.events == (4 if importer.indicators else 2 * bends)


def stepped(fmu, step, *, followed, name="tau[1]"):
    """A variable in co-simulation at TIMES, with held inputs or input derivatives."""
    c = fmu.instantiate()
    inputs = fmu.references(NAMES)
    ones = (ctypes.c_int * 3)(1, 1, 1)
    fmu("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0)
    fmu("EnterInitializationMode", c)
    chosen = fmu.references(["discretisation", "start_mode"])  # exact, from the start values
    assert fmu("SetInteger", c, chosen, 2, (ctypes.c_int * 2)(1, 2)) == 0
    u = motion(step * np.arange(round(END / step) + 1)).T.copy()
    pointers = [(ctypes.c_double * 3).from_buffer(row) for row in u]
    fmu("SetReal", c, inputs, 3, pointers[0])
    assert fmu("ExitInitializationMode", c) == 0
    rows = fmu.get(c, name)
    each = round(TIMES[1] / step)
    for k in range(len(u) - 1):
        fmu("SetReal", c, inputs, 3, pointers[k + (not followed)])
        if followed:
            slope = (u[k + 1] - u[k]) / step
            fmu("SetRealInputDerivatives", c, inputs, 3, ones, (ctypes.c_double * 3)(*slope))
        assert fmu.step(c, k * step, step) == 0
        if (k + 1) % each == 0:
            rows += fmu.get(c, name)
    fmu("FreeInstance", c)
    return np.array(rows)


def test_co_simulation_converges_to_model_exchange(chosen):
    """Inputs are held over a step, a first-order error, unless derivatives are given."""
    law, fmu = chosen
    expected = truth(law)
    for followed, order in ((False, 1), (True, 2)):
        errors = [
            relative(stepped(fmu, step, followed=followed), expected)
            for step in (1e-3, 5e-4, 2.5e-4)
        ]
        ratios = [a / b for a, b in pairwise(errors)]
        assert min(ratios) >= 0.95 * 2**order, errors
    assert relative(stepped(fmu, 2.5e-5, followed=True), expected) <= 1e-6


def signals(t, u):
    rows = [tuple(row) for row in np.column_stack([t, *u])]
    return np.array(rows, dtype=[(name, float) for name in ("time", *NAMES)])


def steps():
    """The motion as steps at TIMES; importers need two samples at each of them."""
    t = np.repeat(TIMES, 2)[1:-1]
    return signals(t, np.repeat(motion(TIMES)[:, 1:], 2, axis=1))


def test_cvode_of_fmpy_matches_exact_steps(chosen, tmp_path):
    """FMPy's CVode holds the inputs between outputs, so it is exact only for these steps."""
    law, fmu = chosen
    for relaxation in law.form.relaxations:
        name = f"{relaxation.name}[1]"
        result = simulate_fmu(
            str(tmp_path / "F.fmu"),
            fmi_type="ModelExchange",
            solver="CVode",
            start_values={"start_mode": 2},
            stop_time=END,
            output_interval=TIMES[1],
            relative_tolerance=1e-9,
            input=steps(),
            output=[name],
            record_events=False,
        )
        expected = stepped(fmu, TIMES[1], followed=False, name=name)
        assert relative(result[name], expected) <= 1e-6


def test_euler_of_fmpy_converges(chosen, tmp_path):
    law, _ = chosen
    t = np.linspace(0.0, END, 10 * len(TIMES) - 9)
    result = simulate_fmu(
        str(tmp_path / "F.fmu"),
        fmi_type="ModelExchange",
        solver="Euler",
        start_values={"start_mode": 2},  # start mode of the truth
        stop_time=END,
        step_size=t[1],
        output_interval=t[1],
        input=signals(t, motion(t)),
        output=["tau[1]"],
        record_events=False,
    )
    assert relative(result["tau[1]"][::10], truth(law)) <= 0.05  # first order


@pytest.mark.parametrize("solver", ["CVode", "Euler"])
def test_laws_without_states_run(solver, make_law, make_model, tmp_path):
    law = make_law("viscous")
    moving, torque = equations(law)
    assert moving(0.0, 0.0, 0.0) == []
    result = simulate_fmu(
        str(export_bare(make_model(law), tmp_path / "F.fmu")),
        fmi_type="ModelExchange",
        solver=solver,
        stop_time=END,
        step_size=TIMES[1],
        output_interval=TIMES[1],
        input=signals(TIMES, motion(TIMES)),
        output=["tau[1]"],
        record_events=False,
    )
    moving = np.abs(motion(TIMES)[0]) > 1e-9
    expected = np.array([torque(*motion(t))[0] for t in TIMES])
    assert relative(result["tau[1]"][moving], expected[moving]) <= 1e-9


def frozen(path, kind, step):
    """Torque, and evaluations, by FMPy with inputs frozen at the last communication point."""
    t = np.arange(0.0, 2.0 + step / 2.0, step)
    dq = SPEED * np.cos(0.5 * np.pi * t)
    u = (dq, 2.0 * SPEED / np.pi * np.sin(0.5 * np.pi * t), 6.0 + 4.0 * np.sin(5.0 * t))
    extra = {"solver": "CVode"} if kind == "ModelExchange" else {"step_size": step}
    calls = 0

    def counted(model, *arguments):
        nonlocal calls
        calls += 1
        return evaluated(model, *arguments)

    with pytest.MonkeyPatch.context() as patch:
        evaluated = FMU2Model.getDerivatives
        patch.setattr(FMU2Model, "getDerivatives", counted)
        result = simulate_fmu(
            str(path),
            fmi_type=kind,
            stop_time=2.0,
            output_interval=step,
            relative_tolerance=1e-6,
            input=signals(t, np.array(u)),
            output=["tau[1]"],
            record_events=False,
            **extra,
        )
    return result["tau[1]"], calls


@pytest.mark.ci
@pytest.mark.parametrize("name", STUDIED)
def test_hosts_with_stale_inputs_need_no_events(name, registry_models, tmp_path):
    model, step = registry_models[name], 5e-4
    no = export_bare(model, tmp_path / "no.fmu", no_events=True)
    torque, calls = frozen(no, "ModelExchange", step)
    exact = export_bare(model, tmp_path / "exact.fmu")
    _, calls_exact = frozen(exact, "ModelExchange", step)
    assert calls <= 20 * calls_exact
    steps, _ = frozen(no, "CoSimulation", step)
    # An input counts from its step on (held states) or from the step before (its direct part).
    peak = np.abs(steps).max()
    apart = [np.abs(torque[: len(steps) - k] - steps[k:]).max() for k in (0, 1)]
    assert min(apart) <= 0.02 * peak


@pytest.mark.parametrize("events", [False, True])
def test_a_jump_is_an_event_or_steep(events, make_law, make_model, load, tmp_path):
    fmu = load(
        export_bare(make_model(make_law("viscous")), tmp_path / "F.fmu", no_events=not events)
    )
    assert fmu.about.numberOfEventIndicators == events
    c = fmu.instantiate()
    fmu("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0)
    fmu("EnterInitializationMode", c)
    fmu("ExitInitializationMode", c)
    for k, dq in enumerate((0.5 * STEEP, STEEP, -2.0 * STEEP, 0.0)):
        fmu.set_all(c, {"dq[1]": dq})
        assert fmu.step(c, k * 1e-3, 1e-3) == 0
        way = np.sign(dq) if events else np.clip(dq / STEEP, -1.0, 1.0)
        expected = 4.5 * way + 12.0 * dq**3 + 0.5  # at q = 0 without load
        assert fmu.get(c, "tau[1]") == pytest.approx([expected], abs=1e-12)
    fmu("FreeInstance", c)
