"""Robustness of the loop to changes of arm and controller."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
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
_REST_DURATION = 4.0  # [s]
_UNCHANGED = "as it is"

_MOTION_COUNT = 3


def run_robustness(
    loop: StudyLoop, robot: Robot, body: RigidBody, folder: Path, tracked: Sequence[Tracked]
) -> tuple[list[Tracked], list[Overcompensation]]:
    """Return the results of `run_sweeps` and `run_overcompensation`."""
    return run_sweeps(loop, robot, body, folder, tracked), run_overcompensation(loop)


def run_sweeps(
    loop: StudyLoop, robot: Robot, body: RigidBody, folder: Path, tracked: Sequence[Tracked]
) -> list[Tracked]:
    """Run the selected laws under every change, on a few motions.

    `tracked` rows provide the unchanged loops; `folder` receives the FMUs of identified payloads.
    """
    rows = list(_build_rows(loop, _export_payload_bodies(robot, body, folder, loop.step)))
    tracked_by_row = {}
    for tracked_row in tracked:
        if not tracked_row.failures:
            scheme = replace(tracked_row.scheme, change=_UNCHANGED)
            tracked_by_row[scheme, tracked_row.law] = replace(
                tracked_row,
                scheme=scheme,
                rmse=tracked_row.rmse[:_MOTION_COUNT],
                last=tracked_row.last[:_MOTION_COUNT],
                trace=None,
            )
    missing_rows = [row for row in rows if (row.scheme, row.law) not in tracked_by_row]
    new_rows = loop.track(
        missing_rows, motions(loop.tracking)[:_MOTION_COUNT], loop.tracking.duration, "robustness"
    )
    tracked_by_row |= {
        (tracked_row.scheme, tracked_row.law): tracked_row for tracked_row in new_rows
    }
    return [tracked_by_row[row.scheme, row.law] for row in rows]


def run_overcompensation(loop: StudyLoop) -> list[Overcompensation]:
    """Find the lowest factor on friction compensation that makes each loop cycle."""
    velocity_sources: tuple[VelocitySource, ...] = ("desired", "measured", "filtered")
    cases = [
        (law_name, Scheme(compensation="servo_inversion", source=velocity_source))
        for law_name, velocity_source in product(loop.tracking.sources, velocity_sources)
    ]
    offset = np.array(loop.tracking.offset)
    standstill = Sine(offset=offset, amplitude=np.zeros(len(offset)), frequency=1.0)
    rows = [
        loop.row(law_name, replace(scheme, friction_gain=factor))
        for (law_name, scheme), factor in product(cases, FACTORS)
    ]
    rest_motions = [LoopMotion.from_trajectory(standstill)]
    tracked = loop.track(rows, rest_motions, _REST_DURATION, "over-compensation")
    results = []
    for case_index, (law_name, scheme) in enumerate(cases):
        first_row = case_index * len(FACTORS)
        factor = _find_cycling_factor(tracked[first_row : first_row + len(FACTORS)])
        results.append(Overcompensation(law=law_name, scheme=scheme, factor=factor))
    return results


def _find_cycling_factor(tracked: Sequence[Tracked]) -> float | None:
    """Return the lowest of `FACTORS`, one for each row, whose loop cycles at rest."""
    for factor, tracked_row in zip(FACTORS, tracked, strict=True):
        if not np.all(tracked_row.rmse[0] < CYCLING):  # also NaN of a failed run
            return factor
    return None


def _build_rows(loop: StudyLoop, payloads: Mapping[float, Path]) -> Iterator[LoopRow]:
    schemes = (
        Scheme(compensation="torque_error"),
        Scheme(compensation="servo_inversion"),
        Scheme(compensation="servo_inversion", Kx=loop.tracking.Kx),
    )
    for scheme in schemes:
        for law_name in (StandIn.BODY_ONLY, *loop.tracking.sources, StandIn.ORACLE):
            for change, setting in _vary_setting(loop.setting(law_name, scheme), payloads):
                yield LoopRow(scheme=replace(scheme, change=change), law=law_name, setting=setting)


def _vary_setting(
    setting: Setting, payloads: Mapping[float, Path]
) -> Iterator[tuple[str, Setting]]:
    gains = setting.gains
    fmus = setting.fmus
    yield _UNCHANGED, setting
    for mass, body_fmu in payloads.items():
        arm = {"payload": mass}
        yield f"payload {mass:g} kg", replace(setting, arm=arm)
        # The servo compensates the gravity of the bare arm.
        identified_fmus = replace(fmus, body=body_fmu, gravity=fmus.body)
        yield f"payload {mass:g} kg, identified", replace(setting, arm=arm, fmus=identified_fmus)
    for scale in FRICTION_SCALES:
        yield f"friction x {scale:g}", replace(setting, arm={"friction_scale": scale})
    for latency in LATENCIES:
        changed_gains = gains.model_copy(update={"latency": latency})
        late_setting = replace(setting, arm={"latency": latency}, gains=changed_gains)
        yield f"latency {1e3 * latency:g} ms", late_setting
    for error in GAIN_ERRORS:
        wrong_values = {
            "Kv": tuple(error * gain for gain in gains.Kv),
            "Ki": tuple(error * gain for gain in gains.Ki),
        }
        wrong_gains = gains.model_copy(update=wrong_values)
        yield f"servo gains x {error:g}", replace(setting, gains=wrong_gains)
    noise = tuple(NOISE * sigma for sigma in setting.noise)
    yield f"torque noise x {NOISE:g}", replace(setting, arm={"tau_meas_noise": noise})


def _export_payload_bodies(
    robot: Robot, body: RigidBody, folder: Path, step_size: float
) -> dict[float, Path]:
    model_path = robot.description.model
    paths = {}
    for mass in PAYLOADS:
        payload_path = folder / f"payload_{mass:g}.xml"
        text = model_path.read_text(encoding="utf-8")
        payload_path.write_text(text.replace('pos="0 0 0" mass="0"', f'pos="0 0 0" mass="{mass}"'))
        description = robot.description.model_copy(update={"model": payload_path})
        parameter_change = Robot(description).nominal_parameters - robot.nominal_parameters
        content = inverse_dynamics(robot, body.parameters + parameter_change, step=step_size)
        paths[mass] = write_fmu(content, folder / f"InverseDynamics_{mass:g}kg.fmu")
        payload_path.unlink()
    return paths
