"""Friction motions against the sweep of the default study, on the twin with three truths.

Errors are those of the friction torque against the twin's own, on motions that no law has seen.
`pytest -m soak tests/benchmarks/test_motion_study.py -s` prints all figures.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.loop.excite import Recording, export_twin, load_arm, record, twin_plant
from cosim.loop.motions import Motions
from cosim.study.study import Twin
from hesr.extras.excite.motion import PlannedMotion, plan_move
from hesr.extras.excite.planner import Guard, MotionSettings, Planner
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.records import predict_record
from hesr_model.motions.limits import MotionLimits
from hesr_model.motions.trajectories import Trajectory
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

FOLDER = models_folder() / "uf850"
MOTIONS = models_folder() / "studies" / "uf850_motions.toml"
LAWS = ("lugre", "parfam_h", "parfam_s")
TRUTHS = (None, "strain_wave", "rate_and_state")
SECONDS = 42.0  # of the sweep
# Peaks of the sweep.
LIMITS = MotionLimits(velocity=(1.25,) * 3, acceleration=(3.4,) * 3)

pytestmark = pytest.mark.soak


class Twins:
    """A twin with one true friction, its identified body, and its unseen motions."""

    def __init__(self, truth: str | None, folder: Path) -> None:
        twin = Twin(
            plant=FOLDER / "plant.toml", signals=FOLDER / "arm.toml", motions=MOTIONS, truth=truth
        )
        self.plant, signals = twin_plant(twin, MOTIONS, folder)
        self.fmu = export_twin(self.plant, folder, signals)
        self.robot = Robot(RobotDescription.read(FOLDER / "robot.toml"))
        self.motions = {m.name: m.trajectory() for m in Motions.read(MOTIONS).motions}
        forward = self.motions["excitation"]
        both = {"forward": forward, "backward": forward.reverse_time()}
        logs = [self.log(motion, name, (20.0, 0.0)).log for name, motion in both.items()]
        self.body = identify(logs[:1], self.robot, reversed_logs=logs[1:])
        settings = MotionSettings(limits=LIMITS)
        self.planner = Planner(Guard(self.robot, settings), settings)
        self.unseen = [
            self.log(self.motions["chirp_20s"], "chirp"),
            self.log(self.point_to_point(), "point to point"),
        ]

    def log(
        self, motion: Trajectory, name: str, unlogged: tuple[float, float] = (0.0, 0.0)
    ) -> Recording:
        with load_arm(self.plant, fmu=self.fmu) as arm:
            return record(arm, motion, 1, name=name, unlogged=unlogged)

    def point_to_point(self) -> PlannedMotion:
        """Moves between random places with rests of half a second, for about 40 s."""
        start, rate, limits = self.planner.start, self.planner.rate, self.planner.guard.limits
        rng, rows = np.random.default_rng(5), [self.planner.start[None]]
        while sum(map(len, rows)) < 40.0 * rate:
            place = np.clip(start + rng.uniform(-0.6, 0.6, 3), limits.lower, limits.upper)
            rows += [
                plan_move(rows[-1][-1], place, limits, rate),
                np.tile(place, (round(0.5 * rate), 1)),
            ]
        rows.append(plan_move(rows[-1][-1], start, limits, rate))
        return PlannedMotion(rate=rate, rows=np.concatenate(rows))

    def records(self, log: Recording) -> list[FrictionRecord]:
        return friction_records(log.log, self.robot, self.body)

    def fitted(self, log: Recording) -> Mapping[str, FrictionModel]:
        rows = [[r] for r in self.records(log)]
        return fit_models(LAWS, rows, robot="uf850", seed=0, workers=1)

    def errors(self, model: FrictionModel) -> np.ndarray:
        """Return the RMSE [N.m] against the true friction, by unseen motion and joint."""
        return np.array(
            [
                np.sqrt(np.mean((predict_record(law, r) - true[-len(r.t) :]) ** 2))
                for log in self.unseen
                for law, r, true in zip(
                    model.laws, self.records(log), log.truth.tau_f_true.T, strict=True
                )
            ]
        )


def widths(law: FrictionLaw, records: Sequence[FrictionRecord]) -> np.ndarray:
    """Return the standard errors of a law's coefficients by equal noise on every row."""
    assert law.covariance is not None
    columns = []
    for name in law.covariance.names:
        step = 1e-4 * max(abs(law.values[name]), 1e-6)
        sides = [
            np.concatenate(
                [
                    predict(
                        replace(law, values={**law.values, name: law.values[name] + h}),
                        t=r.t,
                        dq=r.dq,
                        q=r.q,
                        tau_load=r.tau_load,
                    )
                    for r in records
                ]
            )
            for h in (step, -step)
        ]
        columns.append((sides[0] - sides[1]) / (2.0 * step))
    jacobian = np.column_stack(columns)
    size = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(size, size, 1.0)
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10, hermitian=True)
    return np.sqrt(np.maximum(np.diag(inverse), 1e-300)) / np.where(size, size, 1.0)


@pytest.mark.timeout(0)
def test_friction_motions_against_the_sweep(tmp_path: Path) -> None:
    ratios: dict[str, list[float]] = {"widths": [], "errors": []}
    for truth in TRUTHS:
        folder = tmp_path / str(truth)
        folder.mkdir()
        twin = Twins(truth, folder)
        sweep = twin.log(twin.motions["sweep"], "sweep")
        strokes = twin.log(twin.planner.plan("friction", SECONDS), "friction")
        before, after = twin.fitted(sweep), twin.fitted(strokes)
        for law in LAWS:
            pairs = zip(before[law].laws, twin.records(sweep), twin.records(strokes), strict=True)
            own = [np.log(widths(one, [b]) / widths(one, [a])) for one, a, b in pairs]
            wide = float(np.exp(np.mean(np.concatenate(own))))
            error = float(
                np.exp(np.mean(np.log(twin.errors(after[law]) / twin.errors(before[law]))))
            )
            print(f"{truth} {law}: widths {wide:.2f}, errors {error:.3f}")  # noqa: T201  # the study's table
            ratios["widths"].append(wide)
            ratios["errors"].append(error)
    found = {what: float(np.exp(np.mean(np.log(of)))) for what, of in ratios.items()}
    print(found)  # noqa: T201  # its summary
    assert found["widths"] <= 0.8
    assert found["errors"] <= 0.95
