"""Robustness of the loop to changes of arm and controller."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cosim.loop.closed_loop import Scheme, Setting, StandIn, VelocitySource
from cosim.loop.loops import LoopMotion, LoopRow, StudyLoop, motions
from cosim.loop.traces import Overcompensation, Tracked
from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.export.package import write_fmu
from hesr_model.motions.trajectories import Sine
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot

PAYLOADS = (1.0, 2.5, 5.0)  # [kg] unknown or identified
FRICTION_SCALES = (0.5, 0.75, 1.5, 2.0)  # arm over training
LATENCIES = (0.0, 0.02, 0.04)  # [s] known to the controller
GAIN_ERRORS = (0.8, 1.2)  # assumed over true servo gains
NOISE = 3.0  # factor on the torque noise
FACTORS = tuple(float(f) for f in np.round(np.arange(0.2, 3.01, 0.2), 1))
"""Factors on the friction torque in the search for limit cycles."""
CYCLING = 2e-4
"""RMS motion of an arm at rest [rad] that counts as cycling: ten times the encoder noise."""
_REST = 4.0  # [s]
_AS_IT_IS = "as it is"

_MOTIONS = 3


def run_robustness(
    loop: StudyLoop, robot: Robot, body: RigidBody, folder: Path, known: Sequence[Tracked]
) -> tuple[list[Tracked], list[Overcompensation]]:
    """Return the results of `run_sweeps` and `run_overcompensation`."""
    return run_sweeps(loop, robot, body, folder, known), run_overcompensation(loop)


def run_sweeps(
    loop: StudyLoop, robot: Robot, body: RigidBody, folder: Path, known: Sequence[Tracked]
) -> list[Tracked]:
    """Run the selected laws under every change, on a few motions.

    `known` rows provide the unchanged loops; `folder` receives the FMUs of identified payloads.
    """
    rows = list(_rows(loop, _payload_bodies(robot, body, folder, loop.step)))
    found = {}
    for t in known:
        if not t.failures:
            scheme = replace(t.scheme, change=_AS_IT_IS)
            rmse = t.rmse
            last = t.last
            few = replace(t, scheme=scheme, rmse=rmse[:_MOTIONS], last=last[:_MOTIONS], trace=None)
            found[scheme, t.law] = few
    left = [row for row in rows if (row.scheme, row.law) not in found]
    run = loop.track(left, motions(loop.tracking)[:_MOTIONS], loop.tracking.duration, "robustness")
    found |= {(t.scheme, t.law): t for t in run}
    return [found[row.scheme, row.law] for row in rows]


def run_overcompensation(loop: StudyLoop) -> list[Overcompensation]:
    """Find the lowest factor on friction compensation that makes each loop cycle."""
    sources: tuple[VelocitySource, ...] = ("desired", "measured", "filtered")
    cases = [
        (law, Scheme(compensation="servo_inversion", source=source))
        for law in loop.tracking.sources
        for source in sources
    ]
    offset = np.array(loop.tracking.offset)
    still = LoopMotion.of(Sine(offset=offset, amplitude=np.zeros(len(offset)), frequency=1.0))
    rows = [
        loop.row(law, replace(scheme, friction_gain=factor))
        for law, scheme in cases
        for factor in FACTORS
    ]
    found = loop.track(rows, [still], _REST, "over-compensation")
    results = []
    for k, (law, scheme) in enumerate(cases):
        errors = [t.rmse[0] for t in found[k * len(FACTORS) : (k + 1) * len(FACTORS)]]
        beyond = (
            factor
            for factor, error in zip(FACTORS, errors, strict=True)
            if not np.all(error < CYCLING)  # also NaN of a failed run
        )
        results.append(Overcompensation(law=law, scheme=scheme, factor=next(beyond, None)))
    return results


def _rows(loop: StudyLoop, payloads: Mapping[float, Path]) -> Iterator[LoopRow]:
    schemes = (
        Scheme(compensation="torque_error"),
        Scheme(compensation="servo_inversion"),
        Scheme(compensation="servo_inversion", Kx=loop.tracking.Kx),
    )
    for scheme in schemes:
        for law in (StandIn.BODY_ONLY, *loop.tracking.sources, StandIn.ORACLE):
            for change, setting in _changed(loop.setting(law, scheme), payloads):
                yield LoopRow(scheme=replace(scheme, change=change), law=law, setting=setting)


def _changed(setting: Setting, payloads: Mapping[float, Path]) -> Iterator[tuple[str, Setting]]:
    gains = setting.gains
    fmus = setting.fmus
    yield _AS_IT_IS, setting
    for mass, body in payloads.items():
        arm = {"payload": mass}
        yield f"payload {mass:g} kg", replace(setting, arm=arm)
        # The servo compensates the gravity of the bare arm.
        known = replace(fmus, body=body, gravity=fmus.body)
        yield f"payload {mass:g} kg, identified", replace(setting, arm=arm, fmus=known)
    for scale in FRICTION_SCALES:
        yield f"friction x {scale:g}", replace(setting, arm={"friction_scale": scale})
    for latency in LATENCIES:
        changed = gains.model_copy(update={"latency": latency})
        late = replace(setting, arm={"latency": latency}, gains=changed)
        yield f"latency {1e3 * latency:g} ms", late
    for error in GAIN_ERRORS:
        wrong = {name: tuple(error * g for g in getattr(gains, name)) for name in ("Kv", "Ki")}
        yield f"servo gains x {error:g}", replace(setting, gains=gains.model_copy(update=wrong))
    noise = tuple(NOISE * sigma for sigma in setting.noise)
    yield f"torque noise x {NOISE:g}", replace(setting, arm={"tau_meas_noise": noise})


def _payload_bodies(robot: Robot, body: RigidBody, folder: Path, step: float) -> dict[float, Path]:
    source = robot.description.model
    paths = {}
    for mass in PAYLOADS:
        loaded = folder / f"payload_{mass:g}.xml"
        text = source.read_text(encoding="utf-8")
        loaded.write_text(text.replace('pos="0 0 0" mass="0"', f'pos="0 0 0" mass="{mass}"'))
        description = robot.description.model_copy(update={"model": loaded})
        change = Robot(description).nominal_parameters - robot.nominal_parameters
        content = inverse_dynamics(robot, body.parameters + change, step=step)
        paths[mass] = write_fmu(content, folder / f"InverseDynamics_{mass:g}kg.fmu")
        loaded.unlink()
    return paths
