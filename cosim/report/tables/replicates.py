"""Tables and sentences of what repeats of the squared errors."""

from collections.abc import Mapping, Sequence

from cosim.report.tables.table import (
    ResultTable,
    TableCell,
    decimals,
    fixed_cell,
    joints,
    make_row,
    title,
)
from cosim.study.replicates import Replicates
from cosim.study.scores import is_usable
from hesr_model.inference.replicates import ErrorSplit
from hesr_model.units import unit_of_joints

NO_REPLICATE = "no motion occurs twice, so that the noise in its errors is unknown."


def split_of_laws(
    name: str, replicates: Replicates, laws: Sequence[str], sliding: Sequence[bool] = ()
) -> ResultTable:
    """Return the parts of the error that repeat or do not, and the gain left, by joint."""
    splits = [replicates.laws[law_name][j] for j, law_name in enumerate(laws)]
    places = decimals([split.rmse for split in splits])
    rows = []
    for j, short in enumerate(joints(len(replicates.joints))):
        split = splits[j]
        fast_splits = replicates.fast.get(laws[j])
        interval = f"{100.0 * split.low:.0f} to {100.0 * split.high:.0f}"
        cells = [
            TableCell(text=title(laws[j])),
            fixed_cell(split.rmse, places),
            fixed_cell(100.0 * split.repeats, 0, notes=(interval,)),
            fixed_cell(100.0 * split.smooth, 0),
            fixed_cell(100.0 * split.noise, 0),
            fixed_cell(split.left_to_gain, 2),
            _fast_cell(fast_splits[j] if fast_splits else None),
        ]
        rows.append(make_row(short, *cells))
    unit = unit_of_joints("N.m", sliding)
    return ResultTable(
        caption=f"{name}: parts of the squared error, from {_describe(replicates)}",
        head=(
            "joint",
            "law",
            f"RMSE [{unit}]",
            "repeats [%]",
            "between rows [%]",
            "noise [%]",
            "left to gain",
            "repeats above 5 Hz [%]",
        ),
        rows=rows,
        words=(1,),
        note="Repeats: equal in all replicates of a motion, with its 95 % interval. Noise: the "
        "rest. Left to gain: the smallest RMSE that a law of the motion can have, over this one. "
        "Between rows: repeats although it is interpolated; what changes faster than the rows is "
        "missing there. Small above 5 Hz: between rows.",
    )


def _fast_cell(split: ErrorSplit | None) -> TableCell:
    if split is None:
        return fixed_cell(None, 0)
    return fixed_cell(100.0 * split.repeats, 0, notes=(f"{100.0 * split.smooth:.0f}",))


def shares_of_laws(name: str, replicates: Replicates) -> ResultTable:
    """Return the share of the squared error that repeats, by law and joint."""
    rows = []
    for law_name, splits in replicates.laws.items():
        rows.append(make_row(title(law_name), *map(_share_cell, splits)))
    return ResultTable(
        caption=f"{name}: squared error that repeats [%]; small: RMSE that is left to gain at "
        f"most, over that of the law; from {_describe(replicates)}",
        head=("law", *joints(len(replicates.joints))),
        rows=rows,
    )


def _share_cell(split: ErrorSplit) -> TableCell:
    return fixed_cell(100.0 * split.repeats, 0, notes=(f"× {split.left_to_gain:.2f}",))


def describe_gains(replicates: Replicates, laws: Sequence[str]) -> list[str]:
    """Return one sentence per joint about the error of its law."""
    kind = "from period to period"
    if replicates.period is None:
        kind = "between replicates"
    sentences = []
    for j, (short, law_name) in enumerate(zip(joints(len(laws)), laws, strict=True)):
        split = replicates.laws[law_name][j]
        if split.low <= 0.0:
            sentences.append(
                f"{short}: no part of the squared error of {title(law_name)} repeats "
                "significantly; these logs show nothing that is left to gain."
            )
            continue
        sentences.append(
            f"{short}: {100.0 * split.repeats:.0f} % of the squared error of {title(law_name)} "
            f"repeats {kind}; at most a factor of {split.left_to_gain:.2f} is left to gain."
        )
    return sentences


def build_tables(
    replicates: Mapping[str, Replicates | None],
    name: str,
    laws: Sequence[str],
    sliding: Sequence[bool] = (),
) -> list[ResultTable | str]:
    """Return tables and sentences about logs with a name, for the terminal."""
    saved = replicates.get(name)
    tables: list[ResultTable | str] = []
    if saved is not None:
        tables = [split_of_laws(name, saved, choose_laws(saved, laws), sliding)]
        tables.append(shares_of_laws(name, saved))
    return [*tables, *describe_replicates(replicates, name, laws)]


def describe_replicates(
    replicates: Mapping[str, Replicates | None], name: str, laws: Sequence[str]
) -> list[str]:
    """Return the sentences about logs with a name; that nothing repeats, if nothing does."""
    if name not in replicates:  # results of earlier versions
        return []
    saved = replicates[name]
    if saved is None:
        return [f"'{name}': {NO_REPLICATE}"]
    return describe_gains(saved, choose_laws(saved, laws))


def choose_laws(replicates: Replicates, laws: Sequence[str]) -> list[str]:
    """Return the given law of each joint, or the one with the lowest error if it has no split."""
    candidates = list(filter(is_usable, replicates.laws))
    chosen_laws = []
    for j in range(len(replicates.joints)):
        errors = {law_name: replicates.laws[law_name][j].rmse for law_name in candidates}
        chosen_law = min(errors, key=lambda law_name: errors[law_name])
        if j < len(laws) and laws[j] in errors:
            chosen_law = laws[j]
        chosen_laws.append(chosen_law)
    return chosen_laws


def _describe(replicates: Replicates) -> str:
    share = 100.0 * replicates.rows / replicates.all_rows
    period = ""
    if replicates.period is not None:
        period = f", {replicates.period:.3g} s apart"
    return f"{replicates.count:g} replicates{period} ({share:.0f} % of the rows)"
