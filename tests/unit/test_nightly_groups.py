"""Groups of long tests: which tests stay in the gate, and entries that name none."""

from pathlib import Path

from nightly_groups import read_groups

RECORD = """
[kills]
command = "make nightly-tests GROUP=kills"
files = ["tests/test_long.py"]
tests = ["tests/test_it.py::test_kill", "tests/test_it.py::test_fill[disk]"]
gate = ["tests/test_it.py::test_kill[once]", "tests/test_long.py::test_quick"]
"""
TESTS = [
    "tests/test_it.py::test_kill[once]",
    "tests/test_it.py::test_kill[often]",
    "tests/test_it.py::test_fill[disk]",
    "tests/test_it.py::test_fill[memory]",
    "tests/test_long.py::test_slow",
    "tests/test_long.py::test_quick[a]",
]


def test_files_tests_and_cases_belong_to_a_group_except_those_of_the_gate(tmp_path: Path) -> None:
    path = tmp_path / "nightly.toml"
    path.write_text(RECORD, encoding="utf-8")
    group = read_groups(path)["kills"]
    assert [test for test in TESTS if group.has(test)] == [TESTS[1], TESTS[2], TESTS[4]]
    assert group.unknown_entries(TESTS) == []


def test_an_entry_is_unknown_only_if_its_file_was_collected(tmp_path: Path) -> None:
    path = tmp_path / "nightly.toml"
    path.write_text(RECORD, encoding="utf-8")
    group = read_groups(path)["kills"]
    assert group.unknown_entries(TESTS[2:4]) == [
        "tests/test_it.py::test_kill",
        "tests/test_it.py::test_kill[once]",
    ]
    assert group.unknown_entries(["tests/test_other.py::test_it"]) == []


def test_files_of_entries_must_be_there(tmp_path: Path) -> None:
    path = tmp_path / "nightly.toml"
    path.write_text(RECORD, encoding="utf-8")
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_it.py").touch()
    assert read_groups(path)["kills"].missing_files(tmp_path) == ["tests/test_long.py"]
