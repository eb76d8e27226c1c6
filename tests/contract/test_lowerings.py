"""The contract of every form of a law: the same torque, on one motion, from all of them.

Tests are parametrised over the registry and the table `lowerings.LOWERINGS`: a law or a lowering
that is added is tested without a change here. The gate runs all laws through cheap lowerings and a
sample of each form through the others; `--nightly laws` runs the rest.
"""

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from _pytest.mark.structures import ParameterSet
from fmpy import read_model_description
from lowerings import LOWERINGS, PUBLISHED, Case, Lowering, Torques
from registry_models import SAMPLES, everyday, is_of_this_project

from fmu_src import export_fmu
from fmu_src.check.run import check
from hesr_model.fitting.estimator import registry
from hesr_model.friction.model import FrictionModel

GATE = (*SAMPLES, PUBLISHED)
"""Laws that the gate runs through all lowerings; Euler's integration is that of the published one.
"""

VDMCHECK2 = Path(__file__).parents[2] / ".tools" / "vdmcheck2"
needs_vdmcheck2 = pytest.mark.skipif(
    not VDMCHECK2.is_dir() or shutil.which("java") is None,
    reason="VDMCheck2 or Java is not there",
)

Compute = Callable[[str, str], Torques]


def marks_of(law: str, *, is_cheap: bool) -> list[pytest.MarkDecorator]:
    """Return when a law is tested; laws of other packages always are, by each lowering."""
    if law not in GATE and is_of_this_project(law) and not (is_cheap and law in everyday()):
        return [pytest.mark.nightly("laws")]
    return [] if is_cheap and law in GATE else [pytest.mark.ci]


LAWS = (*registry(), PUBLISHED)


def listed_laws(*, is_cheap: bool = False) -> list[ParameterSet]:
    return [pytest.param(n, id=n, marks=marks_of(n, is_cheap=is_cheap)) for n in LAWS]


def compared_pairs() -> Iterator[ParameterSet]:
    for name, lowering in LOWERINGS.items():
        if lowering.reference is not None:
            for law in LAWS:
                marks = marks_of(law, is_cheap=lowering.is_cheap)
                yield pytest.param(law, name, id=f"{law}-{name}", marks=marks)


@pytest.fixture(scope="session")
def case(shared: Callable[..., Path]) -> Callable[[str], Case]:
    """Return a law with its FMU, made once for all tests."""

    def read(law: str) -> Case:
        return Case.read(law, shared(f"law_{law}", lambda folder: Case.write(law, folder)))

    return read


@pytest.fixture(scope="session")
def compute(
    request: pytest.FixtureRequest, case: Callable[[str], Case], shared_now: Callable[..., Path]
) -> Compute:
    """Return the torques of a law by a lowering, computed once for all tests.

    Programs that are slow to start run all laws that this session tests at once.
    """

    def chosen_laws(name: str) -> list[str]:
        items = [item for item in request.session.items if item.path == Path(__file__)]
        params = [item.callspec.params for item in items if hasattr(item, "callspec")]
        chosen = {pair["law"] for pair in params if pair.get("name") == name}
        return [law for law in LAWS if law in chosen]

    def torques(law: str, name: str) -> Torques:
        lowering = LOWERINGS[name]
        together = chosen_laws(name) if lowering.run_all else [law]

        def fill(folder: Path) -> None:
            cases = [case(one) for one in together]
            motions = [lowering.choose_motion(one) for one in cases]
            results = lowering.compute(cases, motions, folder)
            for one, result in zip(together, results, strict=True):
                result.write(folder / f"torques_{one}.npz")

        folder = shared_now(f"{name}_{'laws' if lowering.run_all else law}", fill)
        return Torques.read(folder / f"torques_{law}.npz")

    return torques


def assert_equal(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    assert found.shape == expected.shape
    worst = np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)
    assert np.all(worst <= tolerance), worst


def assert_agree(found: Torques, expected: Torques, lowering: Lowering, law: str) -> None:
    tolerance = lowering.tolerance_of(law)
    stepped = expected.stepped[: len(found.stepped)]
    if law == "none":  # there is no torque that a difference could be relative to
        assert not found.stepped.any()
        assert not stepped.any()
        return
    if law == "constant":
        assert np.ptp(stepped) == 0.0
    else:
        assert np.ptp(stepped, axis=0).min() > 0.5  # N.m
    assert_equal(found.stepped, stepped, tolerance)
    if found.first is not None and expected.first is not None:
        assert_equal(found.first, expected.first, tolerance)
    if lowering.single_tolerance is not None:
        assert found.single is not None
        assert found.single.dtype == np.float32
        assert_equal(found.single, stepped, lowering.single_tolerance)


@pytest.mark.parametrize(("law", "name"), tuple(compared_pairs()))
def test_a_lowering_gives_the_torque_of_the_law(
    law: str, name: str, case: Callable[[str], Case], compute: Compute
) -> None:
    lowering = LOWERINGS[name]
    if lowering.too_slow(case(law).model):
        pytest.skip("its solver takes minutes for this law: `make soak` runs it")
    assert_agree(compute(law, name), compute(law, str(lowering.reference)), lowering, law)


@pytest.mark.soak
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", [name for name, one in LOWERINGS.items() if one.reference])
def test_long_motions_and_stiff_laws_give_the_same_torque(
    law: str, name: str, case: Callable[[str], Case], tmp_path: Path
) -> None:
    lowering = LOWERINGS[name]
    reference = LOWERINGS[str(lowering.reference)]
    motion = lowering.long_motion(case(law))
    found, expected = (
        one.compute([case(law)], [motion], tmp_path / str(i))[0]
        for i, one in enumerate((lowering, reference))
    )
    assert_agree(found, expected, lowering, law)


# --- the FMU as a file ----------------------------------------------------------------------------


@pytest.mark.parametrize("law", listed_laws(is_cheap=True))
def test_all_laws_have_the_same_connectors(law: str, case: Callable[[str], Case]) -> None:
    about = read_model_description(str(case(law).fmu))
    connectors = [
        (v.name, v.causality, v.unit)
        for v in about.modelVariables
        if v.causality in ("input", "output")
    ]
    assert connectors == [
        (f"{name}[{i}]", kind, unit)
        for name, kind, unit in (
            ("dq", "input", "rad/s"),
            ("q", "input", "rad"),
            ("tau_load", "input", "N.m"),
            ("tau", "output", "N.m"),
            ("dtau_ddq", "output", "N.m.s/rad"),
        )
        for i in case(law).joints
    ]


@pytest.mark.parametrize("law", listed_laws())
def test_validators_find_no_problem(law: str, case: Callable[[str], Case], tmp_path: Path) -> None:
    """With its page, sources and reference results, and FMPy among the validators."""
    assert check(export_fmu(case(law).model, tmp_path / "F.fmu")).problems == ()


@pytest.mark.ci
@needs_vdmcheck2
@pytest.mark.parametrize(
    "names", [GATE, pytest.param(LAWS, marks=pytest.mark.nightly("laws"))], ids=["some", "all"]
)
def test_vdmcheck2_passes_the_variables_of_laws(
    names: Sequence[str], case: Callable[[str], Case], tmp_path: Path
) -> None:
    """It only reads descriptions: laws of one discretisation are joints of one FMU."""
    laws = [law for name in names for law in case(name).model.laws]
    for discretisation in ("exact", "euler"):
        own = tuple(law for law in laws if law.discretisation == discretisation)
        assert own
        model = FrictionModel(
            law="all",
            robot="bench",
            joints=tuple(f"j{i}" for i, _ in enumerate(own)),
            laws=own,
            sample_time=0.005,
        )
        report = check(export_fmu(model, tmp_path / f"{discretisation}.fmu"), vdmcheck=VDMCHECK2)
        assert (report.problems, report.skipped) == ((), ())
