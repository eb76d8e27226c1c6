"""The twin over a day with the adaptive FMU: warm-up, wear, payload and collisions.

Runs at 200 Hz with native FMUs around MuJoCo. The adaptive FMU observes the arm's motion and
torque. Its factors and offset go to a friction FMU of the same law, which looks ahead by the
servo's latency and is the feed-forward of the controller (servo inversion). The truth is known,
so errors are those of friction alone, without torque noise.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from oracles.arm import encoder_error, torque_error
from oracles.drifting_arm import DriftingArm

from cosim.loop.closed_loop import Gains, Scheme, preview
from cosim.systems.system import Value
from fmu_src.arm.plant import Plant
from fmu_src.blocks.controller import controller
from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.export.package import write_fmu
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.run.fmu import FmuInstance, build_mixed_buffer
from hesr.extras.adaptive.monitor import adaptive_content
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.thermal import Thermal
from hesr_model.motions.trajectories import Fourier
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

SCHEME = Scheme(compensation="servo_inversion")
LOAD = "payload"
"""Body of the twin that carries a payload."""

_LEARNED = ("level", "viscosity", "offset")
_WATCHED = ("tau", "drift", "shift", "health")


def _ones(_: float, n: int) -> Array:
    return np.ones(n)


def _zeros(_: float, n: int) -> Array:
    return np.zeros(n)


Course = Callable[[float, int], Array]
"""Function of time [s] and the number of joints: one value per joint."""


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Events during a run.

    Attributes
    ----------
    coulomb, viscous : factors on the true friction.
    torque_offset : offset of the torque sensors [N.m].
    push : external torque on the joints [N.m].
    payload : mass [kg], carried from `loaded` [s].
    """

    coulomb: Course = _ones
    viscous: Course = _ones
    torque_offset: Course = _zeros
    push: Course = _zeros
    payload: float = 0.0
    loaded: float = 0.0


def warm_up(begin: float = 0.0, *, seconds: float = 1200.0) -> Drift:
    """Return a warm-up that removes 30 % of viscous and 10 % of Coulomb friction in 20 minutes."""

    def left(share: float) -> Course:
        return lambda t, n: np.full(n, 1.0 - share * min((begin + t) / seconds, 1.0))

    return Drift(coulomb=left(0.1), viscous=left(0.3))


def wear(at: float, joint: int, share: float = 0.25) -> Drift:
    """Return a step in the friction of one joint (counted from 0) at a time [s]."""

    def course(t: float, n: int) -> Array:
        factors = np.ones(n)
        factors[joint] += share * (t >= at)
        return factors

    return Drift(coulomb=course, viscous=course)


def heated(thermal: Thermal, temperature: Callable[[float], float]) -> Drift:
    """Return a drift with temperature [degC] over time [s], the same in all joints."""

    def factor(which: int) -> Course:
        return lambda t, n: np.repeat(thermal.factors(np.array([temperature(t)]))[which], n)

    return Drift(coulomb=factor(0), viscous=factor(1))


@dataclass(frozen=True, kw_only=True, eq=False)
class DriftingLoop:
    """The parts of a run.

    Attributes
    ----------
    plant, robot : the twin and its rigid body.
    parameters : (P,) identified rigid-body parameters.
    model : fitted friction.
    motion : desired motion; one period is repeated.
    gains : gains of the controller.
    folder : folder of the FMUs, written by `build`.
    """

    plant: Plant
    robot: Robot
    parameters: Array
    model: FrictionModel
    motion: Fourier
    gains: Gains
    folder: Path

    @property
    def step(self) -> float:
        """Period of the commands [s]."""
        return 1.0 / self.plant.sample_rate

    def build(self) -> None:
        """Write the FMUs."""
        n, step = len(self.model.joints), self.step
        write_fmu(adaptive_content(self.model), self.folder / "Adaptive.fmu")
        export_bare(self.model, self.folder / "Friction.fmu")
        write_fmu(controller(n, step=step), self.folder / "Controller.fmu")
        body = inverse_dynamics(self.robot, self.parameters, step=step)
        write_fmu(body, self.folder / "Gravity.fmu")

    def desired(self, t: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and rigid-body torque (N, n) at times (N,)."""
        q, dq, ddq = self.motion.sample(np.mod(t, self.motion.duration))
        return q, dq, self.robot.torque(self.parameters, q, dq, ddq)


@dataclass(frozen=True, kw_only=True, eq=False)
class Drifted:
    """Results of a run, (N, n) at times (N,).

    Attributes
    ----------
    t : time [s].
    q_d, q : desired and true position [rad].
    dq_d, tau_rigid : desired velocity [rad/s] and rigid-body torque [N.m].
    tau_meas, tau_true : measured torque and true friction [N.m].
    learned : outputs of the adaptive FMU by name; empty without one.
    """

    t: Array
    q_d: Array
    q: Array
    dq_d: Array
    tau_rigid: Array
    tau_meas: Array
    tau_true: Array
    learned: Mapping[str, Array] = field(default_factory=dict)

    def records(self, joints: tuple[str, ...], rows: slice = slice(None)) -> list[FrictionRecord]:
        """Return the measurements as friction records."""
        return [
            FrictionRecord(
                log="loop",
                joint=name,
                t=self.t[rows],
                dq=self.dq_d[rows, k],
                q=self.q_d[rows, k],
                tau_load=self.tau_rigid[rows, k],
                tau=(self.tau_meas - self.tau_rigid)[rows, k],
            )
            for k, name in enumerate(joints)
        ]

    def fixed(self, model: FrictionModel) -> Array:
        """Return the torque (N, n) of a model without adaptation [N.m]."""
        return _predicted(model, self.t, self.q_d, self.dq_d, self.tau_rigid)


def _predicted(model: FrictionModel, t: Array, q: Array, dq: Array, tau_load: Array) -> Array:
    """Return the torque (N, n) of the laws alone [N.m]."""
    columns = zip(model.laws, dq.T, q.T, tau_load.T, strict=True)
    found = [predict(law, t=t, dq=v, q=x, tau_load=load) for law, v, x, load in columns]
    return np.column_stack(found)


FeedForward = Callable[[Drifted, int], FrictionModel]
"""Model used from a sample on, given the earlier measurements; see `run_drifting`."""


def run_drifting(
    loop: DriftingLoop,
    drift: Drift,
    seconds: float,
    *,
    adapt: bool = True,
    refitted: FeedForward | None = None,
    every: float = 60.0,
) -> Drifted:
    """Run the loop.

    Parameters
    ----------
    loop : loop with its FMUs built.
    drift : events during the run.
    seconds : length of the run [s].
    adapt : whether the feed-forward uses the learned factors.
    refitted : a law refitted every `every` seconds in place of the feed-forward.
    """
    n, step = len(loop.model.joints), loop.step
    count = round(seconds / step) + 1
    t = step * np.arange(count, dtype=float)
    q_d, dq_d, rigid = loop.desired(t)
    ahead = loop.desired(t + preview(SCHEME, loop.gains, step))
    arm = DriftingArm(loop.plant, LOAD)
    numbers = np.arange(count)
    noise = [error(loop.plant.noise, numbers) for error in (torque_error, encoder_error)]
    q, tau_meas, tau_true = (np.empty((count, n)) for _ in range(3))
    learned = {name: np.empty((count, n)) for name in (*_LEARNED, *_WATCHED)}
    so_far = Drifted(
        t=t,
        q_d=q_d,
        q=q,
        dq_d=dq_d,
        tau_rigid=rigid,
        tau_meas=tau_meas,
        tau_true=tau_true,
        learned=learned,
    )
    torques = np.empty((count, n)) if refitted else None
    period = round(every / step)

    def names(*stems: str) -> list[str]:
        return [f"{stem}[{i}]" for stem in stems for i in range(1, n + 1)]

    state = arm.reset(q_d[0])
    with (
        FmuInstance(loop.folder / "Adaptive.fmu", name="adaptive") as observer,
        FmuInstance(loop.folder / "Friction.fmu", name="friction") as friction,
        FmuInstance(loop.folder / "Gravity.fmu", name="gravity") as gravity,
        FmuInstance(loop.folder / "Controller.fmu", name="controller") as control,
    ):
        seen = observer.buffer(names("dq", "q", "tau_load", "tau_meas", "tau_rigid"))
        known = build_mixed_buffer(observer, names(*_LEARNED, *_WATCHED))
        given = friction.buffer(names("dq", "q", "tau_load", "coulomb_scale", "viscous_scale"))
        forward = friction.buffer(names("tau"))
        posture, weight = gravity.buffer(names("q")), gravity.buffer(names("tau"))
        wanted = control.buffer(names("q_d", "dq_d", "tau_rb", "tau_f", "tau_g", "tau_meas", "q"))
        command = control.buffer(names("dq_cmd"))
        for k in range(count):
            if k:
                state = arm.step(command.values, step)
            q[k], tau_true[k] = state.q, state.tau_f_true
            measured = state.q + noise[1][k]
            tau_meas[k] = state.tau_meas + noise[0][k] + drift.torque_offset(t[k], n)
            arm.scale(drift.coulomb(t[k], n), drift.viscous(t[k], n))
            arm.push(drift.push(t[k], n))
            if drift.payload and k == round(drift.loaded / step):
                arm.load(drift.payload)
            seen.values[:] = np.concatenate([dq_d[k], q_d[k], rigid[k], tau_meas[k], rigid[k]])
            _advance(observer, seen.write, k, step)
            for name, values in zip(learned, known.read().reshape(-1, n), strict=True):
                learned[name][k] = values
            level, thickness, offset = (
                (learned[name][k] for name in _LEARNED)
                if adapt
                else (np.ones(n), np.ones(n), np.zeros(n))
            )
            if torques is not None and refitted is not None:
                if k % period == 0:
                    model = refitted(so_far, k)
                    rows = slice(k, min(k + period, count))
                    torques[rows] = _torques(model, t, ahead, rows)
                tau_f = torques[k]
            else:
                given.values[:] = np.concatenate(
                    [ahead[1][k], ahead[0][k], ahead[2][k], level, thickness]
                )
                _advance(friction, given.write, k, step)
                tau_f = forward.read() + offset
            posture.values[:] = measured
            _advance(gravity, posture.write, k, step)
            wanted.values[:] = np.concatenate(
                [q_d[k], ahead[1][k], ahead[2][k], tau_f, weight.read(), tau_meas[k], measured]
            )
            _advance(control, wanted.write, k, step, start=_controller_start(loop))
            command.read()
    return so_far


def _advance(
    fmu: FmuInstance,
    write: Callable[[], None],
    k: int,
    step: float,
    *,
    start: Mapping[str, Value] | None = None,
) -> None:
    """Set the inputs of sample k and step to it; initialise before the first one."""
    if k == 0:
        fmu.enter_initialisation(start=fmu.variables.expand_values(start or {}))
        write()
        fmu.exit_initialisation()
        return
    write()
    fmu.step((k - 1) * step, step)


def _controller_start(loop: DriftingLoop) -> dict[str, Value]:
    gains = loop.gains
    own = {name: getattr(gains, name) for name in ("Kp", "Kd", "Kv", "Ki")}
    return own | {
        "compensation": SCHEME.compensation,
        "sample_time": loop.step,
        "lambda": gains.decay,
    }


def _torques(
    model: FrictionModel, t: Array, ahead: tuple[Array, Array, Array], rows: slice
) -> Array:
    """Return the torque of a model over some rows, including a short run-in."""
    before = max(rows.start - 400, 0)
    own = slice(before, rows.stop)
    return _predicted(model, t[own], *(values[own] for values in ahead))[rows.start - before :]


@dataclass(frozen=True, kw_only=True)
class DriftScore:
    """Benefit of adaptation to a drift, for each joint.

    Attributes
    ----------
    cut : removed share of the torque error caused by the drift.
    tracking, tracking_fixed : RMS position errors [rad] with and without adaptation.
    level, viscosity, offset : values at the end of the run.
    """

    cut: tuple[float, ...]
    tracking: tuple[float, ...]
    tracking_fixed: tuple[float, ...]
    level: tuple[float, ...]
    viscosity: tuple[float, ...]
    offset: tuple[float, ...]


def score(
    model: FrictionModel, followed: Drifted, fixed: Drifted, undrifted: Drifted, since: float
) -> DriftScore:
    """Compare runs of one motion from a time on [s].

    The error caused by a drift is the increase of the mean square over a run without drift.
    """

    def squares(run: Drifted, torque: Array) -> Array:
        late = run.t >= since
        return np.asarray(np.mean((torque - run.tau_true)[late] ** 2, axis=0))

    known = squares(undrifted, undrifted.fixed(model))
    drifted = squares(fixed, fixed.fixed(model)) - known
    left = np.maximum(squares(followed, followed.learned["tau"]) - known, 0.0)

    def rms(run: Drifted) -> tuple[float, ...]:
        late = run.t >= since
        return _numbers(np.sqrt(np.mean((run.q - run.q_d)[late] ** 2, axis=0)))

    return DriftScore(
        cut=_numbers(1.0 - np.sqrt(left / np.maximum(drifted, 1e-12))),
        tracking=rms(followed),
        tracking_fixed=rms(fixed),
        level=_numbers(followed.learned["level"][-1]),
        viscosity=_numbers(followed.learned["viscosity"][-1]),
        offset=_numbers(followed.learned["offset"][-1]),
    )


def _numbers(values: Array) -> tuple[float, ...]:
    return tuple(float(x) for x in values)


__all__ = ["Drift", "DriftScore", "Drifted", "DriftingLoop", "heated", "run_drifting", "score",
           "warm_up", "wear"]  # fmt: skip
