"""Reference motions and the simulation of the robot along them."""

from collections.abc import Callable

import numpy as np
from unchanged import Unchanged

from hesr_model.fitting.fit import fit_models
from hesr_model.forward.output_error import refine
from hesr_model.forward.simulation import Simulator, cut_windows, position_errors
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion, smooth
from hesr_model.motions.excitation import ExcitationSettings, random_motions
from hesr_model.motions.limits import Limits, MotionLimits, peak_torque
from hesr_model.motions.trajectories import Reversed, Sine, chirp
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot

MakeMotion = Callable[..., Motion]


def test_trajectories(arm_model: Robot, unchanged: Unchanged) -> None:
    start, amplitude = np.array([0.1, -0.2, 0.3]), np.array([0.5, 0.4, 0.3])
    sweep = chirp(start=start, amplitude=amplitude, first=0.2, last=1.5, length=6.0)
    sine = Sine(offset=start, amplitude=amplitude, frequency=0.7, periods=3)
    settings = ExcitationSettings(
        starts=2, harmonics=3, limits=MotionLimits(velocity=(2.0, 2.0, 2.0))
    )
    wild = random_motions(arm_model, settings, 2, 4)
    motions = {"sweep": sweep, "sine": sine, "back": Reversed(forward=sweep), "wild": wild[1]}
    limits = Limits.from_settings(arm_model, settings.limits)
    unchanged(
        {
            "samples": {
                name: each.sample(np.linspace(-0.2, 1.05 * each.duration, 24))
                for name, each in motions.items()
            },
            "limits": limits,
            "rest": limits.find_rest_position(arm_model),
            "peak": [peak_torque(arm_model, each) for each in wild],
            "shrunk": limits.shrink(wild[0], arm_model, limits.find_rest_position(arm_model)),
        },
        rtol=1e-2,
    )


def test_a_simulated_arm(make_motion: MakeMotion, arm_model: Robot, unchanged: Unchanged) -> None:
    log, longer = (noisy(make_motion(name="run", seconds=s, friction=2.0)) for s in (4.0, 10.0))
    body = identify([log], arm_model)
    records = friction_records(log, arm_model, body)
    model = fit_models(["stribeck"], [[r] for r in records], robot="a", seed=0, workers=1)[
        "stribeck"
    ]
    windows = cut_windows([records], 0.4)
    found = {}
    for as_plant in (False, True):
        simulator = Simulator(
            robot=arm_model, parameters=body.parameters, model=model, as_plant=as_plant
        )
        found[str(as_plant)] = position_errors(simulator.run(windows), windows)
    cutoff = arm_model.description.log.filter_cutoff
    refined = refine(arm_model, body, model, [smooth(longer, cutoff)], rounds=2)
    assert refined.ratio < 1.0
    assert refine(arm_model, body, model, [smooth(log, cutoff)]).ratio == 1.0  # none left out
    sizes = {name: getattr(refined, name) for name in ("ratio", "before", "left_out")}
    unchanged({"errors": found, "windows": windows, "refined": sizes}, rtol=1e-2)


def noisy(motion: Motion) -> Log:
    tau = motion.tau + 0.1 * np.random.default_rng(2).normal(size=motion.tau.shape)
    return Log(name=motion.name, t=motion.t, q=motion.q, dq=motion.dq, tau=tau)
