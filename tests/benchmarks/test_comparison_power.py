"""Size and power of the comparison: equal laws, derived from real ones, on twin and UR10e.

The errors of every law are scaled to the same RMSE, per motion or over all motions. A table with
logs drawn from random motions is wrong if it calls any law worse than the best. Statements about
logs of other days are checked on drawn errors.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from other_days import KINDS, calibrate_tables, draw_table, shows

from cosim.loop.excite import load_arm, record_directions
from cosim.loop.motions import FourierMotion, Motions
from cosim.study.scores import predict_models, transpose_records
from cosim.study.study import Study
from fmu_src.arm.plant import Plant, servo_signals
from hesr_model.errors import ConfigError
from hesr_model.fitting.estimator import registry
from hesr_model.fitting.fit import fit_models
from hesr_model.inference.comparison import LawErrors, law_errors
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

MOTIONS, DRAWS, PERIOD = 60, 1000, 0.005
OTHER_DRAWS = 400
NINE = ("lugre", "lugre_textbook", "lugre_load_ripple", "dahl", "dahl_load", "strain_wave",
        "parfam_hx", "parfam_s", "parfam_s_v")  # fmt: skip
"""Laws with memory: errors of laws without it vary by 8 % from motion to motion."""
UR10E = Path(__file__).parents[1] / "real" / "ur10e_study.toml"
FOURIER = ("test_fourier_40s_12harm", "test_fourier_20s_7harm", "test_fourier_20s_8harm")
Errors = Mapping[str, Sequence[Sequence[np.ndarray]]]  # [law][joint][motion]


@dataclass(frozen=True)
class ErrorsOnTests:
    """Errors [law][joint][motion] (N,) [N.m] on test motions, and their sample period [s]."""

    errors: Mapping[str, Sequence[Sequence[np.ndarray]]]
    period: float

    @classmethod
    def of(
        cls, training: Sequence[list[FrictionRecord]], tests: Sequence[list[FrictionRecord]]
    ) -> "ErrorsOnTests":
        """Fit all everyday laws and predict the tests."""
        laws = [name for name, law in registry().items() if law.everyday]
        models = fit_models(laws, transpose_records(training), robot="tested", seed=0)
        records = transpose_records(tests)
        errors = {
            law: [
                [p - r.tau for p, r in zip(*pair, strict=True)]
                for pair in zip(predicted, records, strict=True)
            ]
            for law, predicted in predict_models(models, records).items()
            if law in laws
        }
        return cls(errors, float(np.median(np.diff(records[0][0].t))))


@pytest.fixture(scope="module")
def twin() -> ErrorsOnTests:
    study = Study.read(models_folder() / "studies" / "default.toml")
    assert study.twin
    plant = Plant.read(study.twin.plant)
    logs: dict[str, Log] = {}
    tests: list[Log] = []
    rng = np.random.default_rng(7)
    signals = servo_signals(plant, np.ones(3), np.ones(3))
    with load_arm(plant, signals=signals) as arm:
        for motion in Motions.read(study.twin.motions).motions:
            logs |= {found.log.name: found.log for found in record_directions(arm, motion, 0)}
        while len(tests) < MOTIONS:
            own = FourierMotion(
                name="test",
                kind="fourier",
                seed=int(rng.integers(2**31)),
                harmonics=40,
                period=80.0,
                peak_velocity=(1.2, 1.0, 1.2),
                offset=(0.0, 0.3, -1.9),
            )
            try:
                tests += [found.log for found in record_directions(arm, own, len(tests) + 1)]
            except ConfigError:
                continue  # exceeds the joint limits
    robot = Robot(RobotDescription.read(study.robot))
    body = identify(
        [logs[name] for name in study.logs.identification],
        robot,
        reversed_logs=[logs[name] for name in study.logs.reversed],
    )
    found = partial(friction_records, robot=robot, body=body)
    return ErrorsOnTests.of(
        [found(logs[n]) for n in study.logs.training], [found(log) for log in tests]
    )


@pytest.fixture(scope="module")
def ur10e() -> ErrorsOnTests:
    study = Study.read(UR10E)
    files = [UR10E.parent / file for file in study.logs.identification]
    if not files[0].is_file():
        pytest.skip(f"the measured UR10e logs are not next to the repository, in {files[0].parent}")
    description = RobotDescription.read(study.robot)
    robot, logs = Robot(description), [Log.read(file, description) for file in files]
    tests = [Log.read(files[0].with_name(f"{name}.csv"), description) for name in FOURIER]
    found = partial(friction_records, robot=robot, body=identify(logs, robot))
    return ErrorsOnTests.of([found(log) for log in logs], [found(log) for log in tests])


def tables(
    tested: ErrorsOnTests,
    laws: Sequence[str],
    seconds: float,
    logs: int,
    *,
    each: bool,
    ratio: float = 1.0,
    draws: int = DRAWS,
) -> list[tuple[LawErrors, str]]:
    """Tables of equal laws; the errors of one law, which is returned, are divided by `ratio`."""
    rng, found = np.random.default_rng(1), []
    errors, period, rows = tested.errors, tested.period, round(seconds / tested.period)
    joints, motions = len(errors[laws[0]]), len(errors[laws[0]][0])
    size = {
        law: [[np.sqrt(np.mean(e**2)) for e in of_joint] for of_joint in errors[law]]
        for law in laws
    }
    whole = {law: np.sqrt(np.mean(np.square(size[law]), axis=1)) for law in laws}
    for k in range(draws):
        j, better = k % joints, str(rng.choice(list(laws)))
        cut: dict[str, list[np.ndarray]] = {law: [] for law in laws}
        for _ in range(logs):
            m = int(rng.integers(motions))
            start = int(rng.integers(max(0, len(errors[laws[0]][j][m]) - rows) + 1))
            for law in laws:
                scale = size[law][j][m] if each else whole[law][j]
                part = errors[law][j][m][start : start + rows]
                cut[law].append(part / (scale * (ratio if law == better else 1.0)))
        found.append((law_errors(cut, [period] * logs), better))
    return found


def worse(table: LawErrors) -> set[str]:
    """Laws called worse than the best of the sample."""
    ratios = table.ratios(table.laws[table.best])
    return {law for law, ratio in ratios.items() if ratio.verdict == "worse"}


def size(
    tested: ErrorsOnTests,
    laws: Sequence[str],
    seconds: float,
    logs: int,
    *,
    each: bool,
    draws: int = DRAWS,
) -> float:
    """Share of tables of equal laws that call any law worse."""
    found = tables(tested, laws, seconds, logs, each=each, draws=draws)
    return float(np.mean([bool(worse(table)) for table, _ in found]))


@pytest.mark.parametrize(
    ("seconds", "logs", "draws"),
    [(40, 1, 10 * DRAWS), (72, 1, DRAWS), (40, 2, DRAWS), (20, 4, DRAWS)],
)
def test_size_on_the_twin(
    twin: ErrorsOnTests, seconds: float, logs: int, draws: int, tell: Callable[[str], None]
) -> None:
    """At most 6.5 % of tables are wrong; 1,000 draws have a standard error of 0.7 %.

    Laws with rare large errors, such as networks beyond their training range, vary more between
    motions than one or two motions show: printed, not asserted.
    """
    for laws in (NINE, list(twin.errors)):
        equal, overall = (
            size(twin, laws, seconds, logs, each=each, draws=draws) for each in (True, False)
        )
        tell(
            f"{len(laws)} laws, {logs} x {seconds} s: {100 * equal:.1f} % of tables are wrong with "
            f"laws equal on each motion, {100 * overall:.1f} % with laws equal over all motions"
        )
        assert equal <= 0.065


@pytest.mark.parametrize("logs", [2, 3])
def test_size_on_the_ur10e(ur10e: ErrorsOnTests, logs: int, tell: Callable[[str], None]) -> None:
    for laws in (NINE, list(ur10e.errors)):
        equal = size(ur10e, laws, 20.0, logs, each=True)
        tell(f"UR10e, {len(laws)} laws, {logs} x 20 s: {100 * equal:.1f} % of tables are wrong")
        assert equal <= 0.065


@pytest.mark.parametrize(
    ("seconds", "logs", "shares"),
    [(40, 1, (27, 58, 88)), (72, 1, (43, 82, 94)), (40, 4, (79, 93, 95))],
)
def test_power_on_the_twin(
    twin: ErrorsOnTests,
    seconds: float,
    logs: int,
    shares: Sequence[int],
    tell: Callable[[str], None],
) -> None:
    """Share of true differences of 5, 10 and 20 % that are found."""
    for ratio, least in zip((1.05, 1.1, 1.2), shares, strict=True):
        found = tables(twin, NINE, seconds, logs, each=False, ratio=ratio)
        hits = [len(worse(t) - {better}) / (len(NINE) - 1) for t, better in found]
        tell(
            f"{logs} x {seconds} s: {100 * np.mean(hits):.0f} % of {100 * (ratio - 1):.0f} % found"
        )
        assert np.mean(hits) >= 0.01 * least


@pytest.mark.parametrize(("seconds", "logs"), [(40, 1), (72, 1), (40, 4)])
def test_the_stated_smallest_difference_is_found(
    twin: ErrorsOnTests, seconds: float, logs: int, tell: Callable[[str], None]
) -> None:
    """The stated difference of two laws is found in 70 to 90 % of other tables."""
    equal = [table for table, _ in tables(twin, NINE, seconds, logs, each=False)]
    rng, hits = np.random.default_rng(2), []
    for table, other in zip(equal, equal[3:], strict=False):  # same joint, other motions
        law, best = (str(name) for name in rng.choice(NINE, 2, replace=False))
        stated = table.ratios(best)[law].detectable
        assert stated
        hits.append(shows(other, law, best, stated))
    share = float(np.mean(hits))
    tell(f"{logs} x {seconds} s: the stated difference is found in {100 * share:.0f} %")
    assert 0.7 <= share <= 0.9


@pytest.mark.parametrize("common", [0.5, 0.95])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("logs", [2, 3, 4, 8])
def test_statements_hold_on_logs_of_other_days(
    logs: int, kind: str, common: float, tell: Callable[[str], None]
) -> None:
    """Laws that are equal on average and differ by 2 to 5 % from log to log.

    400 draws have a standard error of 1.1 % in sizes, 1.3 % in coverage: two of them are allowed.
    """
    for laws in (2, 6, 24):
        rng = np.random.default_rng([11, logs, laws])
        draws = [draw_table(rng, laws, logs, kind, common=common) for _ in range(OTHER_DRAWS)]
        found = calibrate_tables(draws)
        shown = "none stated" if found.found is None else f"{100 * found.found:.0f} %"
        tell(
            f"{logs} logs, {laws} laws, {kind}, {100 * common:.0f} % common: wrong "
            f"{100 * found.worse_than_best:.1f} % against the best, {100 * found.not_alike:.1f} % "
            f"against a given law; intervals hold {100 * found.coverage:.1f} %, width "
            f"{found.width:.2f}; stated differences found {shown}"
        )
        assert max(found.worse_than_best, found.not_alike) <= 0.05 + 0.022
        assert found.coverage >= 0.93 - 0.026
        if logs >= 4:
            assert found.width <= 1.5 + 0.05
            assert found.found is not None
            assert 0.7 <= found.found <= 0.95
