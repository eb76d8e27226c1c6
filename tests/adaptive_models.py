"""Hand-made laws for adaptation, and motions with known truth."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hesr.extras.adaptive.component import Tuning, adaptive_component
from hesr_model.equations.recurrence import recurrence
from hesr_model.equations.stepping import Steps
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.lugre import LuGreLoad
from hesr_model.laws.stops.estimator import ParFamS
from hesr_model.rigid_body.friction_record import FrictionRecord

Array = NDArray[np.float64]

NOISE = 1.0
SPEED = 1.2
STEP = 0.01


def lugre() -> FrictionLaw:
    """LuGre with load; friction of 12 N.m."""
    values = {"sigma_0": 4e4, "sigma_1": 0.0, "sigma_2": 14.0, "F_c": 12.0, "F_s": 14.0,
              "v_s": 0.1, "tau_0": 0.3, "mu": 0.01}  # fmt: skip
    return FrictionLaw(name="lugre_load", form=LuGreLoad.form({}), values=values)


def stops(ripple: tuple[int, ...] = (200,)) -> FrictionLaw:
    """ParFam-S with load and ripple; friction of 12 N.m."""
    structure = {
        "stops": [["1", 0], ["1", 4], ["p", 0], ["load", 2]],
        "viscous": ["1", "b"],
        "ripple": list(ripple),
        "window": 0.01,
    }
    form = ParFamS.form(structure)
    values = {"F_1": 6.0, "F_5": 3.0, "F_p_1": 2.0, "F_load_3": 3.0, "sigma_1": 0.0,
              "sigma_2": 10.0, "sigma_b": 5.0, "tau_0": -0.2, "v_b": 0.2, "v_s": 0.1, "T": 0.1,
              "load_scale": 20.0, "lag": 0.003, "ripple200_cos": 0.3,
              "ripple200_sin": 0.2}  # fmt: skip
    return FrictionLaw(
        name="parfam_s",
        structure=structure,
        form=form,
        values={c.name: values[c.name] for c in form.coefficients},
    )


def model(*laws: FrictionLaw) -> FrictionModel:
    """A model with one joint per law."""
    seen = TrainedRange(
        sample_time=STEP, dq=(-SPEED, SPEED), q=(-3, 3), tau_load=(-30, 30), tau=(-40, 40)
    )
    names = tuple(f"j{i}" for i, _ in enumerate(laws, start=1))
    return FrictionModel(
        law="tried",
        robot="arm",
        joints=names,
        laws=laws,
        sample_time=STEP,
        trained=(seen,) * len(laws),
        training_rmse=(NOISE,) * len(laws),
    )


def motion(seconds: float, seed: int = 0, step: float = STEP) -> tuple[Array, Array, Array, Array]:
    """Return t, dq, q and load of a joint in steady work."""
    t = step * np.arange(round(seconds / step))
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 3)
    rates, sizes = np.array([0.7, 1.3, 2.9]), np.array([0.5, 0.4, 0.2])
    dq = np.sin(np.outer(t, rates) + phases) @ sizes
    q = -np.cos(np.outer(t, rates) + phases) @ (sizes / rates)
    return t, dq, q, 15.0 * np.sin(q) + 5.0


def truth(
    law: FrictionLaw,
    t: Array,
    dq: Array,
    q: Array,
    load: Array,
    *,
    level: Callable[[Array], Array],
    viscosity: Callable[[Array], Array],
    seed: int = 0,
    correlation: float = 0.1,
    noise: float = NOISE,
) -> FrictionRecord:
    """Return a record whose factors are known functions of time, with coloured noise.

    Friction follows the adaptive equations with the factors fixed to the truth at each row: they
    start there and do not adapt.
    """
    loose = Tuning(level=(0.1, 10.0), viscosity=(0.1, 10.0))
    component = adaptive_component(law, loose, noise=1.0, speed=SPEED)
    steps = Steps(component, ["tau"])
    values = law.values | {"noise": 1.0, "level_start": 1.0, "viscosity_start": 1.0}
    run = steps.run(values, law.start, ["dq", "q", "tau_load"])
    places = [[e.name for e in component.remembered].index(n) for n in ("level", "viscosity")]
    tau = [run.begin(dq[0], q[0], load[0])[0]]
    factors = np.stack([level(t), viscosity(t)], axis=1)
    for k in range(1, len(t)):
        held = list(run.remembered)
        for place, value in zip(places, factors[k], strict=True):
            held[place] = float(value)
        run.remembered = held
        tau.append(run.step(t[k] - t[k - 1], dq[k], q[k], load[k])[0])
    return FrictionRecord(
        log="true",
        joint="j1",
        t=t,
        dq=dq,
        q=q,
        tau_load=load,
        tau=np.array(tau) + coloured(len(t), t[1] - t[0], correlation, noise, seed),
    )


def coloured(rows: int, step: float, correlation: float, noise: float, seed: int) -> Array:
    """Return noise of the given standard deviation and correlation time [s]."""
    a = np.exp(-step / correlation)
    white = np.random.default_rng(seed).normal(size=rows) * noise
    return recurrence(np.full(rows, a), np.sqrt(1.0 - a**2) * white, float(white[0]))
