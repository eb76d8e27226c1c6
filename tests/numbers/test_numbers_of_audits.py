"""Audits, proofs and refutations of laws, with the numbers of proofs and cycles."""

from dataclasses import asdict, replace

import numpy as np
import pytest
import sympy
from joint_data import law
from unchanged import Unchanged

from hesr_model.audit import attack as attacks
from hesr_model.audit import audit, certificate
from hesr_model.audit import audit as audits
from hesr_model.equations.functions import absolute, positive, sgn
from hesr_model.equations.intervals import is_never_negative
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ArtifactError
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.trained_range import TrainedRange, find_excess
from hesr_model.laws.stops.form import SPEEDS
from hesr_model.rigid_body.friction_record import FrictionRecord

TRAINED = TrainedRange(
    sample_time=0.01, dq=(-1.0, 0.8), q=(-1.0, 2.0), tau_load=(-20.0, 30.0), tau=(-12.0, 20.0)
)
BRISTLE = Relaxation(
    name="x",
    unit="1",
    drive=300.0 * DQ,
    rate=300.0 * absolute(DQ) / (1.0 + 0.4 * sympy.exp(-((DQ / 0.1) ** 2))),
)
SLOW = Relaxation(name="y", unit="1", drive=30.0 * DQ, rate=30.0 * absolute(DQ))
LUGRE = {"sigma_0": 500.0, "sigma_1": 0.5, "sigma_2": 4.5, "F_c": 7.5, "F_s": 10.0, "v_s": 0.12,
         "tau_0": 0.4}  # fmt: skip
STOPS = {"stops": [["1", 0], ["p", 2], ["load", 4]], "viscous": ["1", "a"]}
STOP_VALUES = {"F_1": 2.0, "F_p_3": 1.0, "F_load_5": 3.0, "sigma_2": 1.0, "sigma_a": 20.0,
               "tau_0": 0.3, "v_a": 0.1, "v_s": 0.1, "T": 0.05, "load_scale": 20.0}  # fmt: skip
WAVES = {"ripple200_cos": 0.3, "ripple200_sin": -0.4, "lag": 0.004}


def own(output: sympy.Expr, *memory: Relaxation, how: str = "exact") -> FrictionLaw:
    form = LawForm(coefficients=(), memory=memory, output=output)
    return FrictionLaw(name="own", form=form, values={}, discretisation=how)


def laws() -> dict[str, FrictionLaw]:
    x, dx = BRISTLE.state, BRISTLE.derivative
    wave = sympy.cos(50.0 * Q - 0.15 * DQ)
    ripple = {**STOPS, "ripple": [200], "window": 0.015}
    return {
        "stops": law("parfam_s", STOPS, **STOP_VALUES),
        "rippled": law("parfam_s", ripple, **STOP_VALUES, **WAVES),
        "too much": law("parfam_s", ripple, **STOP_VALUES | WAVES | {"ripple200_cos": 30.0}),
        "lugre": law("lugre", {}, **LUGRE),
        "damped": law("lugre", {}, **LUGRE | {"sigma_1": 60.0}),
        "with load": law("lugre_load", {}, **LUGRE, mu=0.05),
        "bristle": own(6.0 * x + 3.0 * DQ + 0.2, BRISTLE),
        "euler": own(6.0 * SLOW.state + 3.0 * DQ + 0.2, SLOW, how="euler"),
        "of Barabanov": own(6.0 * x + 0.01 * dx + 3.0 * DQ, BRISTLE),
        "waves": own(6.0 * x + 9.0 * DQ + 0.5 * wave, BRISTLE),
        "smoothed": own(9.0 * DQ + 0.5 * wave / (1 + (0.02 * DQ) ** 2), BRISTLE),
        "steep waves": own(0.1 * DQ + 5.0 * wave),
        "negative": own(-2.0 * DQ + 4.0 * DQ * absolute(DQ)),
        "stribeck": own(sgn(DQ) * (5.0 + 6.0 * sympy.exp(-((DQ / 0.1) ** 2))) + 0.3 * DQ),
        "driving": own(3.0 * sgn(DQ) - 4.0 * sgn(DQ) * sympy.exp(-((DQ / 0.2) ** 2)) + 1.0 * DQ),
        "load itself": own(sgn(DQ) * (2.0 + 0.1 * absolute(TAU_LOAD)) + 0.5 * DQ),
        "load drives": own(sgn(DQ) * (3.0 - 0.2 * positive(TAU_LOAD)) + 0.5 * DQ),
        "swings": own(2.0 * DQ + 0.02 * TAU_LOAD * Q),
    }  # fmt: skip


@pytest.mark.parametrize("name", laws())
def test_proofs_and_audits(name: str, unchanged: Unchanged) -> None:
    of = laws()[name]
    found = certificate.certify(of, TRAINED)
    text = {"text": found.cycle.text} if found.cycle else {}
    proven = {"storage": certificate.find_storage_factors(of)} if found.verdict == "proven" else {}
    unchanged(
        {
            "verdict": sum(map(ord, found.verdict)),
            "rests on": [sum(map(ord, said)) for said in found.rests_on],
            "said": list(found.rests_on),
            "length": len(found.storage),
            "function": found.storage,
            "step": -1.0 if found.largest_step is None else min(found.largest_step, 1e9),
            "least": certificate.find_min_viscous_scale(of),
            "cycle": asdict(found.cycle) if found.cycle else {},
            **text,
            **proven,
            "audit": audits.audit(of, TRAINED),
            "outside": audits._extrapolate_largest_torque(of, TRAINED),
        },
        rtol=1e-5,
    )


def test_waves_need_viscous_friction(unchanged: Unchanged) -> None:
    groups = [(0.5, 50.0, 0.003, 0.0, -1.0), (0.3, 200.0, 0.001, 0.02, 0.015)]
    need, longer = (
        certificate._compute_required_viscosity(groups, step, SPEEDS[1:]) for step in (0.01, 0.05)
    )
    unchanged({"need": need, "longer": longer, "speeds": SPEEDS})


@pytest.mark.parametrize(("less", "verdict"), [(0.9e-6, "proven"), (1.1e-6, "tested")])
def test_slack_of_ripple(less: float, verdict: str) -> None:
    wave = 0.5 * sympy.cos(50.0 * Q - 0.15 * DQ)  # A n c = 0.5 * 50 * 0.003 with steps up to 6 ms
    found = certificate.certify(own(0.075 * (1.0 - less) * DQ + wave), TRAINED)
    assert (found.verdict == "proven") == (verdict == "proven")


def test_examined_steps() -> None:
    steps = certificate._STEP_CANDIDATES
    assert (steps[0], steps[-1], len(steps)) == (1e-6, 10.0, 141)


def test_signs_of_expressions() -> None:
    shown = is_never_negative
    assert shown(sympy.Integer(0))
    assert not shown(sympy.Integer(-1))
    assert shown(sympy.exp(DQ) * absolute(Q) + positive(DQ))
    assert shown(DQ**2)
    assert shown(absolute(DQ) ** 3)
    assert not shown(DQ**3)
    assert not shown(DQ + 1)
    assert not shown(absolute(DQ) - 1)
    assert not shown(sympy.sin(DQ))


# --- cycles -----------------------------------------------------------------------------------


def test_closed_motions(unchanged: Unchanged) -> None:
    found = {}
    for wanted in (0.05, 1.0, 30.0):
        motions = audit.closed_motions(TRAINED, np.array([0.2, 0.9]), wanted)
        torque = 0.3 * np.sign(motions.dq) - 0.2 * motions.dq + 1e-12
        found[str(wanted)] = {
            "motions": motions,
            "cycles": list(audit.measure_cycles(motions, 4.0, torque)),
            "shape": motions.dq.shape,
        }
    dq, q, settling = audit.encoder_noise(TRAINED)
    unchanged({**found, "noise": {"dq": dq, "q": q, "rows": [len(q), settling]}})


def test_round_off_work_counts_as_zero() -> None:
    motions = audit.closed_motions(TRAINED, np.array([1.0]), 1.0)
    turned = np.sin(
        np.arccos(np.clip(motions.dq, -1.0, 1.0))
    )  # a function of position alone, except for signs
    for share, counts in ((0.9e-9, False), (1.1e-9, True)):
        moved = np.abs(turned * motions.dq)[:, -motions.rows :].sum()
        own_work = (motions.dq**2)[:, -motions.rows :].sum()
        tau = turned + share * moved / own_work * motions.dq
        [cycle] = audit.measure_cycles(motions, 0.0, tau)
        assert (cycle.work != 0.0) == counts
    [still] = audit.measure_cycles(motions, 0.0, 0.0 * motions.dq)
    assert (still.work, still.share) == (0.0, 0.0)


def test_motions_with_an_oscillating_load(unchanged: Unchanged) -> None:
    found = list(
        attacks.loaded_motions(TRAINED, angles=(1e-3, 1e-2), phases=(0.0, 1.0), cycle_count=3)
    )
    given = [m.compute_generated_energy(-0.1 * m.dq + 0.01 * m.load * np.sign(m.dq)) for m in found]
    unchanged({
        "first": found[0], "last": found[-1], "count": len(found), "given": given,
        "phases": attacks.PHASES, "angles": attacks.ANGLES,
        "settled": len(next(attacks.loaded_motions(TRAINED)).dq),
    })  # fmt: skip


def test_energy_counts_if_cycles_agree() -> None:
    motion = next(attacks.loaded_motions(TRAINED, cycle_count=3))
    rows = motion.rows
    for ratio, counts in ((0.96, True), (0.94, False), (1.04, True), (1.06, False)):
        tau = -np.sign(motion.dq)
        tau[-2 * rows : -rows] *= ratio
        assert (motion.compute_generated_energy(tau) > 0.0) == counts
    level = np.full(len(motion.dq), 1.0)
    drives = -1e-5 * np.sign(motion.dq)
    assert motion.compute_generated_energy(level + drives) > 0.0
    assert motion.compute_generated_energy(level + drives / 20.0) == 0.0
    assert motion.compute_generated_energy(np.sign(motion.dq)) == 0.0


# --- parts of an audit ------------------------------------------------------------------------


def test_loads_of_an_audit() -> None:
    of = laws()["with load"]
    assert audits.choose_loads(of, TRAINED) == (-20.0, 0.0, 30.0)
    assert audits.choose_loads(of, TRAINED, 1.5) == (-32.5, 0.0, 42.5)
    only = replace(TRAINED, tau_load=(5.0, 30.0))
    assert audits.choose_loads(of, only) == (5.0, 30.0)
    assert audits.choose_loads(laws()["lugre"], only) == (5.0,)
    assert audits.choose_loads(laws()["lugre"], replace(only, tau_load=(-9.0, -3.0))) == (-3.0,)


def test_ranges_of_negative_power() -> None:
    v = np.array([-2.0, -1.0, 1.0, 2.0, 3.0])
    negative = audits._find_negative_ranges
    assert negative(v, np.array([1.0, 1.0, 1.0, 1.0, 1.0])) == ()
    assert negative(v, np.array([-1.0, 1.0, 1.0, 1.0, -1.0])) == ((-2.0, -1.5), (2.5, 3.0))
    assert negative(v, np.array([1.0, -3.0, 1.0, 1.0, 1.0])) == ((-1.75, 0.0),)
    assert negative(v, np.array([1.0, 1.0, -1.0, -1.0, 3.0])) == ((0.0, 2.25),)
    assert negative(v[2:], np.array([-1.0, 1.0, 1.0])) == ((0.0, 1.5),)
    assert negative(v, np.zeros(5)) == ()


def test_exploding_torque() -> None:
    """The limit is two and a half times the largest torque in training."""
    for size, refused in ((2.5, False), (2.501, True)):
        cubic = own(20.0 * size * sgn(DQ))
        assert audits.explodes(cubic, TRAINED) == refused
    assert not audits.explodes(own(20.0 * DQ), TRAINED)
    assert audits._is_too_large(float("nan"), TRAINED)


def test_ranges_and_excess() -> None:
    t = 0.01 * np.arange(5)
    dq = np.array([-1.5, 0.0, 0.8, 0.9, 0.0])
    one = FrictionRecord(log="a", joint="j1", t=t, dq=dq, q=dq, tau_load=30.0 + 0.0 * dq, tau=dq)
    found = find_excess(TRAINED, [one])
    assert list(found) == ["dq", "q"]
    assert (found["dq"].rows, found["dq"].below) == (0.4, 0.5)
    assert found["dq"].above == pytest.approx(0.1)
    assert (found["q"].rows, found["q"].above) == (0.2, 0.0)
    seen = TrainedRange.from_records([one, replace(one, t=3.0 * t, q=dq + 4.0)])
    assert (seen.q, seen.dq, seen.speed) == ((-1.5, 4.9), (-1.5, 0.9), 1.5)
    assert seen.middle == pytest.approx(1.7)
    assert seen.sample_time == pytest.approx(0.02)


def test_coefficients_have_an_upper_limit() -> None:
    form = LawForm(
        coefficients=(Coefficient(name="k", unit="1", description="any"),),
        output=sympy.Symbol("k", real=True) * DQ,
    )
    assert FrictionLaw(name="own", form=form, values={"k": -1e100}).values["k"] == -1e100
    with pytest.raises(ArtifactError, match="can be used"):
        FrictionLaw(name="own", form=form, values={"k": 1.01e100})
