"""Size and power of the comparison of laws: equal laws, derived from real ones, on the twin.

The errors of every law are scaled to the same RMSE, over all motions or per motion. A table with
logs drawn from random motions is wrong if it calls any law worse than the best.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
import pytest

from cosim.loop.excite import recorded
from cosim.loop.motions import FourierMotion, Motions
from cosim.loop.twin import loaded_arm
from cosim.study.scores import by_joint, predict_models
from cosim.study.study import Study
from fmu_src.arm.plant import Plant, servo_signals
from hesr_model.errors import ConfigError
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.registry import registry
from hesr_model.inference.comparison import SIGNIFICANCE, LawErrors, holm, law_errors
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

MOTIONS, DRAWS, PERIOD = 60, 1000, 0.005
NINE = ("stribeck", "parfam_v", "lugre", "lugre_load", "lugre_load_ripple", "lugre_textbook",
        "lugre_passive", "dahl", "dahl_load")  # fmt: skip
Errors = Mapping[str, Sequence[Sequence[np.ndarray]]]  # [law][joint][motion]


@pytest.fixture(scope="module")
def errors() -> Errors:
    study = Study.read(models_folder() / "studies" / "default.toml")
    assert study.twin
    plant = Plant.read(study.twin.plant)
    logs, tests, rng = {}, [], np.random.default_rng(7)
    signals = servo_signals(plant, np.ones(3), np.ones(3))
    with loaded_arm(plant, signals=signals) as arm:
        for motion in Motions.read(study.twin.motions).motions:
            logs |= {found.log.name: found.log for found in recorded(arm, motion, 0)}
        while len(tests) < MOTIONS:
            own = FourierMotion(
                name="test", kind="fourier", seed=int(rng.integers(2**31)), harmonics=40,
                period=80.0, peak_velocity=(1.2, 1.0, 1.2), offset=(0.0, 0.3, -1.9),
            )  # fmt: skip
            try:
                tests += [found.log for found in recorded(arm, own, len(tests) + 1)]
            except ConfigError:
                continue  # exceeds the joint limits
    robot = Robot(RobotDescription.read(study.robot))
    body = identify(
        [logs[name] for name in study.logs.identification],
        robot,
        reversed_logs=[logs[name] for name in study.logs.reversed],
    )
    found = partial(friction_records, model=robot, rigid_body=body)
    training = by_joint([found(logs[name]) for name in study.logs.training])
    laws = [name for name, law in registry().items() if law.everyday]
    models = fit_models(laws, training, robot="uf850", seed=0)
    records = by_joint([found(log) for log in tests])
    return {
        law: [
            [p - r.tau for p, r in zip(*pair, strict=True)]
            for pair in zip(of, records, strict=True)
        ]
        for law, of in predict_models(models, records).items()
        if law in laws
    }


def tables(
    errors: Errors,
    laws: Sequence[str],
    seconds: float,
    logs: int,
    *,
    each: bool,
    ratio: float = 1.0,
) -> list[tuple[LawErrors, str]]:
    """Tables of equal laws; the errors of one law, which is returned, are divided by `ratio`."""
    rng, rows, found = np.random.default_rng(1), round(seconds / PERIOD), []
    size = {
        law: [[np.sqrt(np.mean(e**2)) for e in of_joint] for of_joint in errors[law]]
        for law in laws
    }
    whole = {law: np.sqrt(np.mean(np.square(size[law]), axis=1)) for law in laws}
    for k in range(DRAWS):
        j, better = k % 3, str(rng.choice(list(laws)))
        cut: dict[str, list[np.ndarray]] = {law: [] for law in laws}
        for _ in range(logs):
            m, start = int(rng.integers(MOTIONS)), int(rng.integers(16_000 - rows + 1))
            for law in laws:
                scale = size[law][j][m] if each else whole[law][j]
                part = errors[law][j][m][start : start + rows]
                cut[law].append(part / (scale * (ratio if law == better else 1.0)))
        found.append((law_errors(cut, [PERIOD] * logs), better))
    return found


def worse(table: LawErrors) -> set[str]:
    """Laws called worse than the best of the sample."""
    ratios = table.ratios(table.laws[table.best])
    adjusted = holm({law: r.p for law, r in ratios.items() if r.p is not None})
    return {law for law, p in adjusted.items() if p < SIGNIFICANCE}


@pytest.mark.parametrize(("seconds", "logs"), [(40, 1), (72, 1), (40, 2), (20, 4)])
def test_size_of_the_comparison(
    errors: Errors, seconds: float, logs: int, tell: Callable[[str], None]
) -> None:
    """At most 6.5 % of tables are wrong; 1,000 draws have a standard error of 0.7 %.

    Laws with rare large errors, such as networks beyond their training range, vary more between
    motions than one or two motions show: printed, not asserted.
    """
    laws = list(errors)
    share = {
        "9 laws, equal over all motions": tables(errors, NINE, seconds, logs, each=False),
        "17 laws, equal on each motion": tables(errors, laws, seconds, logs, each=True),
        "17 laws, equal over all motions": tables(errors, laws, seconds, logs, each=False),
    }
    sizes = {name: np.mean([bool(worse(t)) for t, _ in of]) for name, of in share.items()}
    for name, size in sizes.items():
        tell(f"{name}, {logs} x {seconds} s: {100 * size:.1f} % of tables are wrong")
    first, second, _ = sizes.values()
    assert first <= 0.065
    assert second <= (0.065 if logs > 1 or seconds > 60 else 0.1)


@pytest.mark.parametrize(("seconds", "logs"), [(40, 1), (72, 1), (40, 4)])
def test_power_of_the_comparison(
    errors: Errors, seconds: float, logs: int, tell: Callable[[str], None]
) -> None:
    """Share of true differences found, for several sizes and for the stated smallest difference."""
    for ratio in (1.05, 1.1, 1.2):
        found = tables(errors, NINE, seconds, logs, each=False, ratio=ratio)
        hits = [len(worse(t) - {better}) / (len(NINE) - 1) for t, better in found]
        tell(
            f"{logs} x {seconds} s: {100 * np.mean(hits):.0f} % of {100 * (ratio - 1):.0f} % found"
        )
    assert np.mean(hits) >= 0.4
