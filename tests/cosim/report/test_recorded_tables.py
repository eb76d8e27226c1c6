"""Recorded tables of known scores: one of each kind, as CSV.

After an intended change run `pytest tests/cosim/report/test_recorded_tables.py --regen-all` and
review it.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from containing import Containing
from pytest_regressions.file_regression import FileRegressionFixture
from rich.console import Console

from cosim.loop.closed_loop import Scheme, StandIn
from cosim.loop.traces import LoopOutcome, Overcompensation, Tracked
from cosim.report.tables import laws, loop, scores
from cosim.report.tables.table import (
    ResultTable,
    csv_text,
    decimals,
    fixed_cell,
    make_row,
    markdown,
    number,
)
from cosim.report.tables.terminal import TerminalTable
from cosim.study.position_errors import PositionErrors
from cosim.study.results import Seeds, SeedScores, Spread
from cosim.study.scores import Comparison, LawScores, Ratios
from cosim.workflow.run import build_draw_tables
from fmu_src.friction.convention import Convention
from fmu_src.friction.reference import Error
from hesr_model.audit.properties import (
    EXPECTATIONS,
    Figure,
    JointProperties,
    Properties,
    PropertyResult,
)
from hesr_model.friction.records import BandScore
from hesr_model.friction.trained_range import Excess
from hesr_model.inference.comparison import ErrorRatio
from hesr_model.rigid_body.elasticity import ElasticGear

Recorded = Callable[[Iterable[ResultTable]], None]


@pytest.fixture
def recorded(file_regression: FileRegressionFixture) -> Recorded:
    def check(tables: Iterable[ResultTable]) -> None:
        texts = [csv_text(table) for table in tables]
        file_regression.check("\n".join(texts), encoding="utf-8")

    return check


def on_terminal(table: ResultTable) -> str:
    text = StringIO()
    Console(
        file=text, width=78, force_terminal=True, color_system="standard", no_color=False
    ).print(TerminalTable(table))
    return text.getvalue()


def law(*rmse: float, moving: float | None = 0.5) -> LawScores:
    return LawScores(
        rmse=rmse, rmse_reversal=(None, 10.5), rmse_moving=(0.25, moving), r2=(0.5, None)
    )


def ratio(value: float) -> ErrorRatio:
    return ErrorRatio(value=value, low=0.9 * value, high=1.1 * value, p=0.01)


COMPARISON = Comparison(
    joints=("a", "b"),
    tau_std=(4.0, 30.0),
    laws={
        "true friction": law(0.5, 0.6),
        "lugre": law(1.0, 12.0),
        "parfam_h": law(0.9, 14.0, moving=None),
        "own + start": law(0.0321, 33.0),
        "stribeck": law(2.0, 15.0),
    },
    ratios=Ratios(
        reference="lugre",
        laws={
            "parfam_h": (ratio(0.9), ErrorRatio(value=1.2, low=None, high=None)),
            "stribeck": (ratio(2.0), ratio(1.25)),
        },
        by_joint={"parfam_h": ("lugre", "stribeck"), "stribeck": ("lugre", "lugre")},
    ),
    leading=(("own + start",), ("lugre", "parfam_h", "stribeck")),
    per_log=(),
    bands={
        law: (
            BandScore(held=0.9512, held_moving=0.5, held_reversal=None, least_log=0.4, width=0.75),
            BandScore(held=share, held_moving=None, held_reversal=0.25, least_log=0.4, width=None),
        )
        for law, share in (("stribeck", 1.0), ("lugre", 0.123))
    },
    detectable=({"lugre": 1.21, "parfam_h": 1.04}, {"parfam_h": 1.08, "stribeck": 1.3}),
    seconds=(12.4, 80.0),
)
SHORT = Comparison(
    joints=("a", "b"),
    tau_std=(4.0, 30.0),
    laws={"lugre": law(1.0, 12.0), "dahl": law(3.0, 9.0)},
    ratios=Ratios(reference="lugre", laws={"dahl": (ratio(3.0), ratio(0.75))}),
    leading=(("lugre", "dahl"), ("dahl", "lugre")),
    per_log=("tau_0", "offset"),
    detectable=({}, {}),
    seconds=(40.0, 50.0),
)


def test_numbers_of_a_gear_have_the_digits_of_their_errors() -> None:
    parameters = {"stiffness": (29876.5, 123.4), "damping": (12.34567, 0.6543)}
    gear = ElasticGear(joint="j1", zero=0.0, parameters=parameters, elements=())
    shown = "Gear of j1 [SI]: stiffness 29880 +- 240, damping 12.35 +- 1.3."
    assert laws._gear(gear) == shown
    vague = replace(gear, parameters={"stiffness": (100.0, 12.0), "damping": (1.0, 1.0)})
    assert "stiffness (100 +- 24 N.m/rad)" in laws._gear(vague)


def test_errors_of_predictions(recorded: Recorded) -> None:
    inputs = {
        "lugre": "v", "parfam_h": "v, q, load", "own + start": "v, load, start", "stribeck": "v",
    }  # fmt: skip
    recorded(
        [
            scores.errors("unseen", COMPARISON, "rmse", inputs, (False, True)),
            scores.errors("short", SHORT, "rmse_reversal"),
            *filter(None, [scores.separations("unseen", COMPARISON)]),
            scores.bands("unseen", COMPARISON),
        ]
    )


def test_errors_on_other_plants_and_of_positions(recorded: Recorded) -> None:
    other = {
        "unseen": {"lugre": (1.0, 2.0), "dahl": (0.5, 3.0), "true friction": (0.1, 0.1)},
        "second": {"lugre": (1.0, 2.0), "parfam_h": (0.9, 1.9)},
    }
    comparisons = {"unseen": COMPARISON, "second": SHORT}
    positions = PositionErrors(
        joints=("a", "b"),
        lengths=(0.2, 0.5),
        windows={"lugre": ((0.001, 0.02), (0.0035, None)), "dahl": ((0.002, 0.03), (0.3, 1.0))},
        open_loop={"lugre": (0.125, 0.5)},
    )
    recorded(
        [
            scores.compare_truths(comparisons, {"stiff": other, "soft": other}, "own"),
            scores.position_errors("unseen", positions, SHORT, (False, True)),
        ]
    )
    assert scores.find_leader({"unseen": {"dahl": (1.0, 9.0), "lugre": (2.0, 2.0)}}) == "lugre"
    assert scores.find_leader({"unseen": {"true friction": (0.1,), "dahl": (9.0,)}}) == "dahl"


def tracked(scheme: Scheme, name: str, scale: float, motions: int = 2) -> Tracked:
    rmse = scale * np.array([[0.001, 0.02], [0.003, 0.05]])[:motions]
    return Tracked(scheme=scheme, law=name, rmse=rmse, last=rmse / 8.0)


def test_errors_of_the_closed_loop(recorded: Recorded) -> None:
    first = Scheme(compensation="none")
    second = Scheme(compensation="servo_inversion", Kx=5.0, source="filtered", friction_gain=1.5)
    changed = Scheme(compensation="none", change="payload 5 kg")
    lost = Tracked(
        scheme=first, law="dahl", rmse=np.full((2, 2), np.nan), last=np.full((2, 2), np.nan)
    )
    rows = [
        tracked(first, "lugre", 1.0),
        tracked(second, "lugre", 0.7),
        lost,
        tracked(first, StandIn.ORACLE, 0.001),
        tracked(second, StandIn.BODY_ONLY, 9.0),
    ]
    found = LoopOutcome(
        tracking=rows,
        long=[tracked(first, "lugre", 1.0, motions=1), tracked(second, "dahl", 2.0, motions=1)],
        sweeps=[tracked(one, name, 3.0) for one in (first, changed) for name in ("lugre", "dahl")],
        overcompensation=[
            Overcompensation(law="lugre", scheme=first, factor=1.234),
            Overcompensation(law="dahl", scheme=second, factor=None),
        ],
    )
    recorded(loop.outcome(found))


def findings(values: list[float | None], verdicts: list[str]) -> Properties:
    def result(value: float | None, verdict: str) -> PropertyResult:
        figures = () if value is None else (Figure(name="x", value=value, unit="1"),)
        return PropertyResult(verdict=verdict, figures=figures, reason=f"it {verdict}s")  # type: ignore[arg-type]

    return Properties(
        law="x",
        robot="bench",
        tau_load=0.0,
        joints=tuple(
            JointProperties(
                joint=f"j{k}",
                speed=1.0,
                level=1.0,
                deflection=1e-3,
                inertia=None,
                findings={
                    key: result(values[(k + n) % len(values)], verdicts[(k + n) % len(verdicts)])
                    for n, key in enumerate(EXPECTATIONS)
                },
            )
            for k in range(2)
        ),
    )


def test_physics_checks(recorded: Recorded) -> None:
    values = [1.2345, 123456.7, 0.012345, -9.876, None, 1e-5, -99.96, 1e-12, 0.5]
    found = {
        "lugre": findings(values, ["pass", "fail"]),
        "dahl": findings([*values[::-1], 1e-4, 2e-3], ["pass", "not applicable", "fail"]),
    }
    recorded([laws.properties(found)])
    assert len(laws.legend((False, True)).rows) == len(EXPECTATIONS)
    reasons = csv_text(laws.reasons(found))
    assert "it fails" in reasons
    assert "it not applicables" in reasons


def test_conventions_and_draws(recorded: Recorded) -> None:
    def spread(mean: float) -> Spread:
        return Spread(mean=mean, low=0.8 * mean, high=1.3 * mean)

    error = [Error(rmse=0.1234, rmse_reversal=1.25), Error(rmse=2.0, rmse_reversal=3.0005)]
    convention = Convention(
        joints=("a", "b"),
        step=0.004,
        frequency=0.25,
        speeds=(0.5, 0.12345),
        replay={"direct": tuple(error)},
        continuous={"direct": tuple(error[::-1])},
    )
    seeds = Seeds(
        seeds=5,
        joints=("a", "b"),
        reference="lugre",
        tests={
            "unseen": SeedScores(
                rmse={"lugre": (spread(1.0), spread(2.5)), "dahl": (spread(3.0), spread(0.1))},
                ratios={"dahl": (spread(3.0), spread(0.04))},
            )
        },
    )
    recorded([laws.convention("Friction.fmu", convention), *build_draw_tables(seeds)])


def test_leaving_a_trained_range_is_told() -> None:
    found = [
        {"dq": Excess(rows=0.1234, below=0.5, above=0.25)},
        {},
        {"tau_load": Excess(rows=0.5, below=1.0, above=20.0)},
    ]
    assert laws.describe_excesses(("a", "b", "c"), found, (False, False, True)).splitlines() == [
        Containing("a: dq leaves", "12.3 %", "0.5 rad/s"),
        Containing("c: tau_load leaves", "50.0 %", "20 N"),
    ]


def test_numbers_are_rounded() -> None:
    values = (None, float("nan"), 1.0, 1.2345, -0.00012345, 1.2345e-5, 123456.7, 1.5e7, -20.0)
    found = [number(value).text for value in values]
    assert found == [
        "–", "–", "1.00", "1.23", "−0.000123", "1.23e−05", "123457", "1.50e+07", "−20.0",
    ]  # fmt: skip
    assert number(1.0, 1).text == "1"
    assert [fixed_cell(value, 2).text for value in values[:5]] == [
        "–",
        "–",
        "1.00",
        "1.23",
        "−0.00",
    ]
    assert fixed_cell(0.0, 0).value == 0.0
    assert decimals([None, 12.0, 0.5, float("nan"), 0.0]) == 3
    assert decimals([-12.0], 2) == 0
    assert decimals([100.0, 1000.0]) == 0
    assert decimals([]) == decimals([0.0]) == 0


def test_a_table_is_written_as_csv_markdown_and_on_a_terminal(
    file_regression: FileRegressionFixture,
) -> None:
    words = ResultTable(
        caption="Words", head=("a", "b"), rows=[make_row("x", "long words " * 20)], numeric=False
    )
    numbers = replace(scores.errors("unseen", COMPARISON), caption="Errors")
    texts = [
        text
        for table in (words, numbers)
        for text in (csv_text(table), markdown(table), on_terminal(table))
    ]
    lines = (line.rstrip() for line in "\n".join(texts).splitlines())
    file_regression.check("\n".join(lines) + "\n", encoding="utf-8")
