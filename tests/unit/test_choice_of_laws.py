"""Choice of laws by their errors on left-out rows."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import pytest
from left_out_rows import make_errors

from hesr_model.inference.choice import (
    CONSTANT,
    NONE,
    PLAIN,
    PROVEN_LAWS,
    LawChoice,
    choose_laws,
    is_better,
)
from hesr_model.inference.left_out import LeftOutErrors
from hesr_model.support.arrays import Array

ROWS = 4000
PROVEN = {PLAIN, CONSTANT, NONE, *PROVEN_LAWS}
BASELINES = {PLAIN: 1.0, CONSTANT: 3.0, NONE: 10.0}


def make_table(
    sizes: Mapping[str, float | Sequence[float]], *, seconds: float = 40.0, seed: int = 0
) -> LeftOutErrors:
    """Errors of given sizes by law, for one joint or by joint; half of each is common to all."""
    all_sizes = {**BASELINES, **sizes}
    joints = max(np.size(size) for size in all_sizes.values())
    rng = np.random.default_rng(seed)
    rows = round(100.0 * seconds)
    common = rng.standard_normal((rows, joints))
    errors = {}
    for law_name, size in all_sizes.items():
        own_rng = np.random.default_rng([seed, *law_name.encode()])
        own = own_rng.standard_normal((rows, joints))
        mixed = np.sqrt(0.5) * (common + own)
        errors[law_name] = [np.asarray(size) * mixed / np.sqrt(np.mean(mixed**2, axis=0))]
    return make_errors(errors)


def choose(
    errors: LeftOutErrors,
    *,
    proven: Iterable[str] = PROVEN,
    can_join: Callable[[str, str], bool] = lambda *_: True,
) -> LawChoice:
    names = set(proven)
    return choose_laws(errors, is_proven=lambda law_name, _: law_name in names, can_join=can_join)


def test_the_base_has_the_lowest_mean_over_joints() -> None:
    """The first law is best on most joints, the second in the mean of logarithms."""
    table = make_table({"a": [0.90, 0.90, 0.90], "b": [0.91, 0.91, 0.80]})
    choice = choose(table)
    assert choice.base == "b"
    assert choice.laws == ("b", "b", "b")
    assert {one.reason for one in choice.joints} == {"base"}
    assert {one.known for one in choice.joints} == {"law"}
    for j, one in enumerate(choice.joints):
        assert one.ratio == pytest.approx(np.exp(table.log_ratio("b", PLAIN, j)))
        assert one.ratio == pytest.approx((0.91, 0.91, 0.80)[j])
        assert one.low is not None
        assert one.high is not None
        assert one.low < one.ratio < one.high < 1.0
        assert one.unexplained == pytest.approx(one.ratio / 10.0)
    assert (choice.fold_count, choice.seconds) == (5, pytest.approx(39.99))


@pytest.mark.parametrize(
    ("proven_size", "base", "guaranteed"),
    [
        (0.9001, "parfam_s", "a"),
        (0.95, "a", ""),  # beyond a standard error of the mean over folds
    ],
)
def test_a_proven_law_takes_the_place_of_the_base_within_a_standard_error(
    proven_size: float, base: str, guaranteed: str
) -> None:
    table = make_table({"a": [0.9, 0.9], "parfam_s": [proven_size] * 2})
    error = table.mean_standard_error("parfam_s", "a", [0, 1])
    assert np.log(0.9001 / 0.9) < error < np.log(0.95 / 0.9)
    choice = choose(table)
    assert (choice.base, choice.guaranteed) == (base, guaranteed)
    assert choice.laws == (base, base)
    assert all(one.proven == (base == "parfam_s") for one in choice.joints)


def explode_fold(errors: Array, factor: float) -> Array:
    exploded = errors.copy()
    exploded[: len(errors) // 5] *= factor
    return exploded


def test_a_proven_law_must_not_be_worse_than_coulomb_and_viscous_friction() -> None:
    """It is within a standard error of a base whose error is as uncertain as large."""
    rng = np.random.default_rng(1)
    plain = rng.standard_normal(ROWS)
    scales = np.repeat([1.6, 0.6, 1.6, 0.6, 0.6], ROWS // 5)
    table = make_errors(
        {
            PLAIN: [plain],
            CONSTANT: [3.0 * plain],
            NONE: [10.0 * plain],
            "a": [0.98 * plain],
            "parfam_s": [scales * plain],
        }
    )
    assert table.log_ratio("parfam_s", "a", 0) < table.mean_standard_error("parfam_s", "a", [0])
    assert table.log_ratio("parfam_s", PLAIN, 0) > 0.0
    choice = choose(table)
    assert (choice.base, choice.guaranteed) == ("a", "")


def test_a_proven_law_that_explodes_on_a_fold_does_not_take_the_place() -> None:
    rng = np.random.default_rng(1)
    plain = rng.standard_normal(ROWS)
    proven = np.repeat([1.6, 0.6, 0.6, 0.6, 0.6], ROWS // 5) * plain
    table = make_errors(
        {
            PLAIN: [plain],
            CONSTANT: [3.0 * plain],
            NONE: [10.0 * plain],
            "a": [0.8 * plain],
            "parfam_s": [proven],
        }
    )
    assert table.log_ratio("parfam_s", PLAIN, 0) < 0.0
    assert table.log_ratio("parfam_s", "a", 0) < table.mean_standard_error("parfam_s", "a", [0])
    assert choose(table).base == "a"
    calm = make_errors({**table.errors, "parfam_s": (0.9 * table.errors["parfam_s"][0],)})
    assert calm.worst_fold("parfam_s", PLAIN, 0) < 1.5
    assert choose(calm).base == "parfam_s"


def test_the_second_proven_law_is_taken_if_the_first_is_too_bad() -> None:
    table = make_table({"a": [0.9] * 2, "parfam_s": [0.97] * 2, "parfam_s_v": [0.9001] * 2})
    choice = choose(table)
    assert (choice.base, choice.guaranteed) == ("parfam_s_v", "a")


def test_a_proof_on_one_joint_alone_is_no_reason() -> None:
    table = make_table({"a": [0.9] * 2, "parfam_s": [0.9001] * 2})
    choice = choose_laws(
        table,
        is_proven=lambda law_name, j: law_name in PROVEN and j == 0,
        can_join=lambda *_: True,
    )
    assert (choice.base, choice.guaranteed) == ("a", "")
    assert [one.proven for one in choice.joints] == [False, False]


@pytest.mark.parametrize(("size", "law_name"), [(0.8999, "a"), (0.7, "b")])
def test_a_joint_leaves_the_base_by_two_standard_errors(size: float, law_name: str) -> None:
    table = make_table({"a": [0.7, 0.7, 0.9], "b": [0.9, 0.9, size]})
    assert is_better(table, "b", "a", 2) == (law_name == "b")
    choice = choose(table)
    assert choice.base == "a"
    assert choice.laws == ("a", "a", law_name)
    assert choice.joints[2].reason == ("better" if law_name == "b" else "base")


def test_a_joint_leaves_a_proven_base_for_proven_laws_only() -> None:
    sizes = {"a": [0.9, 0.9], "b": [1.5, 0.8]}
    choice = choose(make_table({**sizes, "parfam_s": [0.9001, 0.9001]}))
    assert choice.guaranteed == "a"
    assert choice.laws == ("parfam_s", "parfam_s")
    assert choose(make_table(sizes)).laws == ("a", "b")


def test_an_exploded_fold_gives_way_to_coulomb_and_viscous_friction() -> None:
    table = make_table({"a": [0.5, 0.5]})
    errors = {name: list(values) for name, values in table.errors.items()}
    exploded = errors["a"][0].copy()
    exploded[: ROWS // 5, 1] *= 4.0
    choice = choose(make_errors({**errors, "a": [exploded]}))
    assert choice.base == "a"
    assert choice.laws == ("a", PLAIN)
    joint_choice = choice.joints[1]
    assert (joint_choice.reason, joint_choice.replaced) == ("exploded", "a")
    assert joint_choice.worst_fold == pytest.approx(2.0, rel=0.1)
    assert (joint_choice.ratio, joint_choice.low, joint_choice.high) == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(("none", "law_name"), [(12.5, CONSTANT), (11.5, NONE)])
def test_a_law_worse_than_a_constant_is_not_recommended(none: float, law_name: str) -> None:
    """Friction has a standard deviation of 10."""
    table = make_table(
        {"a": [0.5, 11.0], PLAIN: [1.0, 12.0], CONSTANT: [3.0, 12.0], NONE: [10.0, none]}
    )
    joint_choice = choose(table).joints[1]
    assert (joint_choice.reason, joint_choice.law_name) == ("unexplained", law_name)
    assert joint_choice.replaced == "a"
    assert not joint_choice.is_recommended
    assert joint_choice.unexplained is not None
    assert joint_choice.unexplained > 1.0
    assert choose(table).joints[0].is_recommended


def test_too_little_motion_has_the_law_of_the_other_joints() -> None:
    counts = np.ones((5, 2), dtype=bool)
    counts[2:, 1] = False
    table = make_table({"a": [0.5, 2.0]})
    errors = {name: list(values) for name, values in table.errors.items()}
    choice = choose(make_errors(errors, counts=counts))
    assert choice.laws == ("a", "a")
    joint_choice = choice.joints[1]
    assert (joint_choice.reason, joint_choice.known) == ("short", "nothing")
    assert joint_choice.ratio is joint_choice.low is joint_choice.unexplained is None


@pytest.mark.parametrize("seconds", [2.5, 4.0, 7.5])
def test_short_logs_of_one_joint_have_coulomb_and_viscous_friction(seconds: float) -> None:
    choice = choose(make_table({"a": 0.999}, seconds=seconds))
    assert choice.laws == (PLAIN,)
    assert choice.joints[0].reason == ("short" if seconds < 3.0 else "base")
    assert choose(make_table({"a": 0.999}, seconds=8.5)).laws == ("a",)


def test_three_seconds_tell_a_much_better_law_of_one_joint() -> None:
    choice = choose(make_table({"a": 0.4}, seconds=5.0))
    assert choice.is_short
    assert (choice.base, choice.laws, choice.joints[0].reason) == (PLAIN, ("a",), "better")


def test_copies_and_variants_of_laws_change_nothing() -> None:
    """Neither five copies of a law, nor five worse ones, nor removal of a law not chosen."""
    sizes = {"a": [0.90, 0.93, 0.97], "b": [0.92, 0.90, 0.85], "parfam_s": [0.93, 0.92, 0.90]}
    table = make_table(sizes)
    choice = choose(table)
    rng = np.random.default_rng(2)
    for law_name in (*sizes, PLAIN, CONSTANT):
        copies = {f"{law_name}_{k}": table.errors[law_name] for k in range(5)}
        assert choose(make_errors({**table.errors, **copies})) == choice
    worse = {
        f"c{k}": (table.errors["a"][0] + 0.5 * rng.standard_normal((ROWS, 3)),) for k in range(5)
    }
    assert choose(make_errors({**table.errors, **worse})) == choice
    for law_name in set(sizes) - {*choice.laws, choice.guaranteed}:
        fewer = {name: errors for name, errors in table.errors.items() if name != law_name}
        assert choose(make_errors(fewer)) == choice


def test_a_law_that_cannot_share_the_fmu_of_the_base_is_not_taken() -> None:
    table = make_table({"a": [0.7, 0.7, 0.9], "b": [0.95, 0.95, 0.6]})
    assert choose(table).laws == ("a", "a", "b")
    apart = choose(table, can_join=lambda *names: set(names) != {"a", "b"})
    assert apart.laws == ("a", "a", "a")


def test_a_law_that_diverges_is_no_candidate() -> None:
    table = make_table({"a": 0.9})
    diverged = np.full((ROWS, 1), 0.1)
    diverged[17] = np.inf
    errors = make_errors({**table.errors, "b": [diverged]})
    assert choose(errors) == choose(table)


@pytest.mark.parametrize(
    ("sizes", "known"),
    [({"a": 0.9}, "law"), ({"a": 0.9999}, "level"), ({"a": 1.0, CONSTANT: 1.0001}, "nothing")],
)
def test_what_is_known_of_a_joint(sizes: dict[str, float], known: str) -> None:
    assert choose(make_table(sizes)).joints[0].known == known


def test_a_log_at_constant_speed_has_a_constant() -> None:
    choice = choose(make_table({"a": 1.2, PLAIN: 1.1, CONSTANT: 1.0, NONE: 8.0}))
    assert choice.laws == (CONSTANT,)


def test_several_logs_that_differ_do_not_tell_laws_apart() -> None:
    """A law is better by 10 % on two logs of four and worse by 8 % on the others."""
    rng = np.random.default_rng(5)
    factors = (0.90, 1.08, 0.90, 1.08)
    plain = [rng.standard_normal(ROWS) for _ in factors]
    errors = {
        PLAIN: plain,
        CONSTANT: [3.0 * log_errors for log_errors in plain],
        NONE: [10.0 * log_errors for log_errors in plain],
        "a": [factor * e for factor, e in zip(factors, plain, strict=True)],
    }
    one = choose(make_errors(errors)).joints[0]
    assert one.known == "level"
    assert one.low is not None
    assert one.high is not None
    assert one.low < 0.9
    assert one.high > 1.08
