"""Each promise of the pages on security has a test, which is named here."""

import pytest
from documents import ROOT

FOREIGN = "tests/cosim/test_foreign_fmus.py"
ATTACKS = "tests/cosim/test_attacks.py"
ANSWERS = "tests/cosim/test_sandbox_answers.py"
RESULTS = "tests/unit/test_result_folder.py"
FAULTS = "tests/cosim/test_faults_of_files.py"
ARCHIVES = "tests/cosim/test_archive_attacks.py"

PROMISES = {
    # The table of what foreign code can do.
    "a crash, an exit": (FOREIGN, "test_a_crash_of_its_process_is_one_sentence"),
    "loading, a call or a step ends": (
        "tests/cosim/test_system_sandbox.py",
        "test_each_step_has_the_limit_and_the_run_another",
    ),
    "4 GiB of address space": (FOREIGN, "test_limits_are_those_of_the_page"),
    "512 threads": (ATTACKS, "test_threads_are_limited"),
    "answers are numbers and messages": (ANSWERS, "test_bytes_that_are_no_answer_end_the_process"),
    "the process ends with HESR": (FOREIGN, "test_signals_end_a_run_at_once"),
    "it executes no module": (
        "tests/cosim/test_current_folder.py",
        "test_foreign_fmus_import_nothing_of_it",
    ),
    "it cannot start processes": (FOREIGN, "test_all_its_child_processes_are_ended"),
    "it cannot open sockets": (ATTACKS, "test_every_attack_is_refused"),
    "no shared memory": (ATTACKS, "test_every_attack_is_refused"),
    "priorities, affinity": (
        ATTACKS,
        "test_every_number_that_is_not_on_the_list_is_refused",
    ),
    "it sends no signals": (ATTACKS, "test_every_argument_that_is_not_on_the_list_is_refused"),
    "it does not see other processes": (
        "tests/cosim/test_self_test.py",
        "test_nothing_succeeds_in_a_child_of_this_machine",
    ),
    "it reads the FMU": (FOREIGN, "test_foreign_code_has_few_rights"),
    "it writes to its own folder": (FOREIGN, "test_foreign_code_has_its_scratch_folder"),
    # The table of results.
    "after an error there is": (FAULTS, "test_a_fault_leaves_the_old_result_or_the_new_one"),
    "the same after a kill": (FAULTS, "test_a_fault_leaves_the_old_result_or_the_new_one"),
    "files of an earlier result": (
        RESULTS,
        "test_files_of_an_earlier_result_go_and_those_of_the_user_stay",
    ),
    "files that HESR did not write": (
        RESULTS,
        "test_files_of_an_earlier_result_go_and_those_of_the_user_stay",
    ),
    "no link in a results folder": (RESULTS, "test_no_link_in_a_folder_is_followed"),
    "a folder or a list that": (RESULTS, "test_a_result_that_is_not_signed_is_kept_whole"),
    "temporary files of a living": (
        "tests/cosim/test_shared_folders_of_containers.py",
        "test_living_files_of_another_namespace_stay",
    ),
}
"""Tests by the first words of a row in `docs/security.md`."""

CLASSES = {
    "logs, robot and model files": ("tests/fuzz/test_text_bombs.py", "test_text_bombs_are_read"),
    "archive, description": (ARCHIVES, "test_hostile_fmus_are_refused"),
    "binary of a foreign FMU": (
        "tests/cosim/test_nothing_foreign_runs_here.py",
        "test_a_foreign_lag_is_loaded_in_the_sandbox_only",
    ),
    "FMUs exported": (FOREIGN, "test_a_marker_that_anyone_can_make_trusts_nothing"),
    "Python modules": ("tests/cosim/test_current_folder.py", "test_workers_import_nothing_of_it"),
    "C that HESR generates": (
        "tests/unit/test_compiler_rights.py",
        "test_files_of_the_user_are_not_compiled_into_a_library",
    ),
}
"""Tests by the first words of a row in `SECURITY.md`; plug-ins and engines have no promise."""

WITHOUT_PROMISE = ("plug-ins", "engines of")


def read_rows(page: str) -> list[str]:
    """Return the first cells of all tables of a page, without their heads."""
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    cells = [line.split("|")[1].strip() for line in lines if line.startswith("| ")]
    heads = ("promise", "item", "---")
    return [cell for cell in cells if not cell.startswith(heads)]


@pytest.mark.parametrize(
    ("page", "tests"), [("docs/security.md", PROMISES), ("SECURITY.md", CLASSES)]
)
def test_each_row_has_a_test(page: str, tests: dict[str, tuple[str, str]]) -> None:
    rows = [row for row in read_rows(page) if not row.startswith(WITHOUT_PROMISE)]
    assert len(rows) == len(tests)
    for row in rows:
        (words,) = [words for words in tests if row.startswith(words)]
        file, name = tests[words]
        assert name in (ROOT / file).read_text(encoding="utf-8"), row
