"""Columns that a robot file leaves open are tried; its own names are kept."""

from pathlib import Path

import numpy as np
import pytest
from printed_lines import remove_marks, write_line
from rotor import describe_rotor, write_log

from hesr_model.errors import LogError
from hesr_model.health.joints import apply_changes
from hesr_model.health.proposal import Proposal, ProposalError, inspect_logs, robot_file


def inspect(tmp_path: Path, header: str, **columns: str) -> Proposal:
    changes = {f"log.columns.{key}": (name,) for key, name in columns.items()}
    description = apply_changes(describe_rotor(tmp_path), changes)
    return inspect_logs([write_log(tmp_path / "run.csv", header)], description)


@pytest.mark.parametrize(
    ("header", "chosen"),
    [
        ("t=t;q=q;dq=dq;torque=noise;effort=tau", "effort"),
        ("t=t;q=q;dq=dq;torque=tau;effort=noise", "torque"),
        ("t=t;q=q;dq=dq;torque=noise;effort=tau;moment=warmth", "effort"),
    ],
)
def test_the_torque_that_motion_explains_is_chosen(
    header: str, chosen: str, tmp_path: Path
) -> None:
    assert inspect(tmp_path, header).description.log.columns.tau == (chosen,)


def test_names_of_the_user_are_kept_and_one_key_is_missing(tmp_path: Path) -> None:
    header = "t=t;a=q;b=dq;c=amperes;position=noise;velocity=noise"
    proposal = inspect(tmp_path, header, q="a", dq="b", current="c")
    columns = proposal.description.log.columns
    assert (columns.q, columns.dq, columns.current) == (("a",), ("b",), ("c",))
    assert set(proposal.reasons) == {"log.torque_per_ampere"}
    with pytest.raises(LogError) as caught:
        inspect(tmp_path, header, q="a", dq="nothing", current="c")
    assert (caught.value.code, caught.value.key) == ("log.column_missing", "nothing")


def test_the_torque_that_motion_explains_is_taken(tmp_path: Path) -> None:
    header = "time=t;position=q;velocity=dq;torque_a=noise;torque_bb=tau"
    proposal = inspect(tmp_path, header)
    assert proposal.description.log.columns.tau == ("torque_bb",)
    swapped = header.replace("torque_a=noise;torque_bb=tau", "torque_a=tau;torque_bb=noise")
    assert inspect(tmp_path, swapped).description.log.columns.tau == ("torque_a",)
    equal = header.replace("torque_a=noise", "torque_a=tau")
    assert inspect(tmp_path, equal).description.log.columns.tau == ("torque_a",)


@pytest.mark.parametrize(
    ("position", "velocity", "torque", "dropped"),
    [
        ("q", "noise", "tau", "dq"),
        ("noise", "dq", "tau", "q"),
        ("q", "noise", "warmth", None),
    ],
)
def test_a_contradiction_deletes_no_witness_unless_the_torque_decides(
    position: str, velocity: str, torque: str, dropped: str | None, tmp_path: Path
) -> None:
    header = f"time=t;position={position};velocity={velocity};torque={torque}"
    proposal = inspect(tmp_path, header)
    columns = proposal.description.log.columns
    assert {key for key in ("q", "dq") if not getattr(columns, key)} == {dropped} - {None}
    if dropped is None:
        assert set(proposal.undecided) == {"log.columns.q", "log.columns.dq"}
        text = robot_file(proposal, tmp_path / "robot.toml")
        assert '\n# dq = ""\n' in text


def test_counts_get_the_size_that_the_velocity_shows(tmp_path: Path) -> None:
    proposal = inspect(tmp_path, "time=t;encoder=counts;velocity=dq;torque=tau")
    (size,) = proposal.undecided["log.units.q"].value
    assert size == pytest.approx(2 * np.pi / 4096, rel=1e-3)
    path = tmp_path / "robot.toml"
    path.write_text(remove_marks(robot_file(proposal, path)), encoding="utf-8")
    assert inspect_logs([tmp_path / "run.csv"], path).examination.findings == ()


# Columns of a log that cannot be read yet, and the code of the refusal.
REFUSED = {
    "no time": ("q1=q;dq1=dq;tau1=tau", "log.no_time"),
    "no torque": ("t=t;q1=q;dq1=dq;spring=tau", "log.no_torque"),
    "no motion": ("t=t;alpha_x=q;beta_x=dq;tau1=tau", "log.no_positions"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_one_edit_of_the_written_file_goes_on(case: str, tmp_path: Path) -> None:
    """What is missing is a comment; 'COLUMN' stands for a name that only the user knows."""
    header, code = REFUSED[case]
    log_path = write_log(tmp_path / "run.csv", header)
    with pytest.raises(ProposalError) as caught:
        inspect_logs([log_path], describe_rotor(tmp_path))
    assert caught.value.code == code
    path = tmp_path / "robot.toml"
    text = robot_file(caught.value.proposal, path)
    if code == "log.no_time":
        text = remove_marks(text)
    elif code == "log.no_torque":
        text = write_line(text, "log.columns", "tau", "['spring']")
    else:
        assert "# q = " in text
        text = write_line(text, "log.columns", "q", "['alpha_x']")
    path.write_text(text, encoding="utf-8")
    proposal = inspect_logs([log_path], path)
    # What the edit does not name is left over.
    assert {finding.check for finding in proposal.examination.findings} <= {"left-over"}
    assert len(proposal.logs[0].t) == 2000


def test_a_table_without_names_shows_a_line_of_names(tmp_path: Path) -> None:
    log_path = write_log(tmp_path / "run.csv", "t=t;q=q;dq=dq;tau=tau")
    lines = log_path.read_text(encoding="utf-8").splitlines()
    log_path.write_text("\n".join(lines[1:]), encoding="utf-8")
    description = describe_rotor(tmp_path)
    with pytest.raises(ProposalError) as caught:
        inspect_logs([log_path], description)
    path = tmp_path / "robot.toml"
    path.write_text(remove_marks(robot_file(caught.value.proposal, path)), encoding="utf-8")
    assert inspect_logs([log_path], path).examination.findings == ()
