"""What a log file holds and its reader does not use: irrelevant for a reason, or left over."""

from collections.abc import Iterator

from hesr_model.findings import Finding
from hesr_model.logs.log_format import OPTIONAL, column_names
from hesr_model.logs.log_table import find_same_kind
from hesr_model.logs.robot_log import Log
from hesr_model.support.ledger import MAX_NAME_LENGTH, format_suggestion, list_left_over
from hesr_model.support.text import count_noun, quote

_ROW_NUMBER = "counts the rows; time orders them"
_BOOKKEEPING = "belongs to the data set, not to the motion"
_OF_MESSAGE = "belongs to the transport of a message; its stamp counts"
_OF_ROS = "messages of ROS itself"

IRRELEVANT: dict[str, str] = {
    "index": _ROW_NUMBER,
    "row": _ROW_NUMBER,
    "sample": _ROW_NUMBER,
    "unnamed: 0": _ROW_NUMBER,
    "__index_level_0__": _ROW_NUMBER,
    "frame_index": _ROW_NUMBER,
    "episode_index": "stamps begin again with each episode",
    "task_index": _BOOKKEEPING,
    "next.done": _BOOKKEEPING,
    "next.success": _BOOKKEEPING,
    "next.reward": _BOOKKEEPING,
    "seq": _OF_MESSAGE,
    "header.seq": _OF_MESSAGE,
    "header.frame_id": _OF_MESSAGE,
    "/rosout": _OF_ROS,
    "/rosout_agg": _OF_ROS,
    "/parameter_events": _OF_ROS,
    "/events/write_split": _OF_ROS,
    "/clock": "simulated time; stamps of joint states count",
    "/tf": "poses follow from the joints",
    "/tf_static": "poses follow from the joints",
    "/robot_description": "the robot file names its model",
}
"""Reasons why a column, array or topic changes no result, by its name in lower case."""


def report_left_over(log: Log) -> Iterator[Finding]:
    """Yield one finding on what a log file holds and its reader left over, if anything."""
    names = [name for name in log.left_over if name.lower() not in IRRELEVANT]
    if not names:
        return
    suggestions = [_suggest_optional_name(log, name) for name in names]
    # What may have been meant stands first.
    order = sorted(range(len(names)), key=lambda k: not suggestions[k])
    texts = [f"{quote(names[k][:MAX_NAME_LENGTH])}{suggestions[k]}" for k in order]
    yield Finding(
        check="left-over",
        severity="warning" if any(suggestions) else "advice",
        logs=(log.name,),
        found=f"{count_noun(len(names), 'item')} of the file not used: "
        f"{list_left_over(log.where, texts)}",
        remedy="name what is needed in [log.columns] or [log.bag] of the robot file",
    )


def _suggest_optional_name(log: Log, name: str) -> str:
    """Return the optional column that a name resembles and that the log lacks, as a question."""
    if log.robot is None:
        return ""
    columns = log.robot.log.columns
    missing: list[str] = []
    for quantity in OPTIONAL:
        if getattr(log, quantity) is None:
            missing += column_names(getattr(columns, quantity), log.robot.joints)
    suggestion = format_suggestion(find_same_kind(name, missing))
    return f" ({suggestion})" if suggestion else ""
