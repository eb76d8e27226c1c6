"""LuGre fitted by MuJoCo's own system identification to the same log of the twin.

Both use the friction of one joint along the sweep (measured torque minus the identified rigid body,
velocity from the smoothed position), have the same seven parameters with the same bounds, and
minimise the same sum of squares. Neither simulates an arm: the velocity is the measured one. In
`mujoco.sysid` this is its usual rollout with a joint so heavy that a motor, commanded with the
torque of the measured acceleration, moves it along the log under any friction. A rollout of the
measured torque with a comparison of positions would need an inertia and would integrate the noise
of the torque twice. The viscous torque is that of the motor, with the root of its constant as
parameter, since MuJoCo's actuator force sensor excludes the damping of the actuator.

Differences: MuJoCo relaxes the bristle with the velocity at the start of a step, the replay of a
log here with that at its end; each is scored as it was fitted. The peer searches locally from an
initial guess, the estimator here globally without one.

Needs the extra `peer`.
"""

import io
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco import sysid
from pytest_benchmark.fixture import BenchmarkFixture

from hesr_model.fitting.estimator import estimator
from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.laws.lugre import DEFLECTION_BOUNDS, STATIC_RATIO_BOUNDS
from hesr_model.laws.stribeck import VELOCITY_BOUNDS
from hesr_model.rigid_body.friction_record import FrictionRecord

if not hasattr(sysid, "optimize"):
    pytest.skip("mujoco.sysid needs the extra 'peer' of hesr", allow_module_level=True)

Records = dict[str, list[FrictionRecord]]

HEAVY = 1e9
"""Inertia of the joint [kg m2]: 100 N.m of friction change its velocity by 5e-10 per step."""

JOINT = f"""\
<mujoco>
  <option timestep="STEP" gravity="0 0 0">
    <flag contact="disable" constraint="disable" eulerdamp="disable"/>
  </option>
  <worldbody>
    <body>
      <inertial pos="0 0 0" mass="1" diaginertia="{HEAVY} {HEAVY} {HEAVY}"/>
      <joint name="joint" axis="0 0 1"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="drive" joint="joint"/>
    <dcmotor name="friction" joint="joint" input="none" resistance="1" motorconst="1 1"
      lugre="1000 1 1 1 0.1" cogging="0.1 0 {np.pi / 2}"/>
  </actuator>
  <sensor><actuatorfrc name="torque" actuator="friction"/></sensor>
</mujoco>
"""


@dataclass(frozen=True)
class Fit:
    law: FrictionLaw
    seconds: float
    early: bool
    """Whether a step uses the velocity at its start."""

    def error(self, record: FrictionRecord) -> float:
        """RMSE in the convention of the fit [N.m]."""
        t, dq, q, load = record.t, record.dq, record.q, record.tau_load
        if self.early:
            # A step with the velocity of the previous row, then a zero step to read the torque.
            t, dq, q, load = np.repeat(t, 2)[1:], *(np.repeat(u, 2)[:-1] for u in (dq, q, load))
        torque = predict(self.law, t=t, dq=dq, q=q, tau_load=load)
        return rmse((torque[::2] if self.early else torque) - record.tau)


def parameters(record: FrictionRecord) -> sysid.ParameterDict:
    """The seven parameters with an initial guess and our search's bounds; two as logarithms."""
    most, usual = float(np.max(np.abs(record.tau))), float(np.median(np.abs(record.tau)))
    rows = {
        "F_c": (usual, 1e-9, 2.0 * most),
        "log_deflection": (np.log(1e-3), *np.log(DEFLECTION_BOUNDS)),
        "ratio": (1.2, *STATIC_RATIO_BOUNDS),
        "log_v_s": (np.log(0.05), *np.log(VELOCITY_BOUNDS)),
        "sigma_1": (10.0, 0.0, 1e3),
        "sigma_2": (10.0, 0.0, 1e2),
        "tau_0": (0.0, -most, most),
    }
    found = sysid.ParameterDict()
    for name, (guess, low, high) in rows.items():
        found.add(sysid.Parameter(name, guess, low, high))
    return found


def law_of(found: sysid.ParameterDict) -> FrictionLaw:
    value = {name: float(p.value[0]) for name, p in found.items()}
    same = {name: value[name] for name in ("F_c", "sigma_1", "sigma_2", "tau_0")}
    return FrictionLaw(
        name="lugre",
        form=estimator("lugre").form({}),
        values=same
        | {
            "sigma_0": value["F_c"] / np.exp(value["log_deflection"]),
            "F_s": value["F_c"] * value["ratio"],
            "v_s": np.exp(value["log_v_s"]),
        },
    )


def model_of(found: sysid.ParameterDict, spec: mujoco.MjSpec) -> mujoco.MjModel:
    value = law_of(found).values
    motor = spec.actuator("friction")
    motor.gainprm[1] = np.sqrt(value["sigma_2"])
    motor.dynprm[5:7] = value["sigma_0"], value["sigma_1"]
    motor.biasprm[0] = -value["tau_0"]
    motor.biasprm[3:6] = value["F_c"], value["F_s"], value["v_s"]
    return spec.compile()


def by_peer(record: FrictionRecord) -> tuple[Fit, float]:
    """The peer's fit, and the RMSE that it reports [N.m]."""
    step = float(np.median(np.diff(record.t)))
    spec = mujoco.MjSpec.from_string(JOINT.replace("STEP", repr(step)))
    model = spec.compile()
    rows = len(record.t)
    # A sensor of a rollout is read at the start of a step and stamped with its end.
    dated = step * np.arange(rows + 1)
    drive, torque = np.zeros((rows + 1, 1)), np.zeros((rows + 1, 1))
    drive[: rows - 1, 0] = HEAVY * np.diff(record.dq) / step
    torque[1:, 0] = -record.tau
    series: Any = sysid.TimeSeries
    sequences = sysid.ModelSequences(
        "joint",
        spec,
        record.log,
        sysid.create_initial_state(model, np.zeros(1), record.dq[:1], np.zeros(model.na)),
        series(dated, drive),
        series.from_names(dated, torque, model, ["torque"]),
    )
    residual = sysid.build_residual_fn(
        models_sequences=[sequences], build_model=model_of, resample_true=False
    )
    start = time.perf_counter()
    found, _ = sysid.optimize(parameters(record), residual, verbose=False, output=io.StringIO())
    seconds = time.perf_counter() - start
    # Residuals are relative to the size of the measured signal (normalize_residual).
    scaled = np.ravel(residual(found.as_vector(), found)[0][0])
    size = np.linalg.norm(torque) / np.sqrt(2.0)
    return Fit(law=law_of(found), seconds=seconds, early=True), size * rmse(scaled)


def by_us(record: FrictionRecord) -> Fit:
    start = time.perf_counter()
    law = fit_joint("lugre", [record], seed=0)
    return Fit(law=law, seconds=time.perf_counter() - start, early=False)


def row(name: str, fit: Fit, sweep: FrictionRecord, unseen: FrictionRecord) -> str:
    numbers = " ".join(f"{x:9.4g}" for x in fit.law.values.values())
    errors = f"{fit.error(sweep):8.4f} {fit.error(unseen):8.4f}"
    return f"{name:<22} {fit.seconds:6.2f} {numbers} {errors}"


def test_lugre_compared_with_mujoco_sysid(
    benchmark: BenchmarkFixture, records: Records, tell: Callable[[str], None]
) -> None:
    """Print seconds, parameters, RMSE in training and on the Fourier test [N.m]."""
    sweeps, unseen = records["sweep"], records["fourier_test"]
    # Earlier compilation of the law's expressions by SymPy must not affect the times.
    fit_joint("lugre", [short(sweeps[0])], seed=0)
    ours = [by_us(record) for record in sweeps]
    peers = benchmark.pedantic(
        lambda: [by_peer(record) for record in sweeps], rounds=1, iterations=1
    )
    names = " ".join(f"{name:>9}" for name in ours[0].law.values)
    lines = [f"{'':<22} {'s':>6} {names} {'sweep':>8} {'fourier':>8}"]
    for own, (peer, _), *logs in zip(ours, peers, sweeps, unseen, strict=True):
        lines.append(row(f"{logs[0].joint}  hesr", own, *logs))
        lines.append(row(f"{logs[0].joint}  mujoco.sysid", peer, *logs))
    tell("\n".join(lines))
    for own, (peer, said), sweep in zip(ours, peers, sweeps, strict=True):
        # The peer's rollout equals the law, so both RMSE values are comparable.
        assert peer.error(sweep) == pytest.approx(said, rel=1e-6)
        assert own.error(sweep) <= 1.002 * said


def short(record: FrictionRecord) -> FrictionRecord:
    columns = ("t", "dq", "q", "tau_load", "tau")
    return replace(record, **{name: getattr(record, name)[:2000] for name in columns})
