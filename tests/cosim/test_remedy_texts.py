"""Every command, option or line of a file that the product prints is executed by a test."""

import ast
from collections.abc import Mapping
from pathlib import Path

import pytest
import test_remedies_of_answers
import test_remedies_of_calls
import test_remedies_of_files
import test_remedies_of_options
from documents import ROOT
from remedy_texts import find_remedies

PACKAGES = ("hesr", "cosim", "fmu_src", "hesr_model")
OTHER_TABLE = ("health", "robot_log")
"""Modules whose remedies are in the table of `unit/health/test_printed_remedies.py`."""

TABLES: tuple[Mapping[str, object], ...] = (
    test_remedies_of_answers.EXECUTED,
    test_remedies_of_calls.EXECUTED,
    test_remedies_of_files.REFUSALS,
    test_remedies_of_options.REFUSALS,
)
ELSEWHERE = {
    "hesr {}": "cosim/test_remedies_of_options.py::test_the_new_form_of_a_verb_is_a_command",
    "log.bag.": "unit/test_log_bag.py::test_keys_that_refusals_print_make_them_go_away",
    " --measured {}": "cosim/test_remedies_of_answers.py::test_what_an_answer_prints_is_executed",
    "--platform {}": "cosim/test_remedies_of_answers.py::test_what_an_answer_prints_is_executed",
    "a divisor of all steps": "cosim/package/test_ssp_spellings.py::test_printed_times_work",
    "for another end": "cosim/package/test_ssp_spellings.py::test_printed_times_work",
    "[log] missing = 'interpolate'": "unit/test_logs_of_other_tools.py::test_a_printed_line_joins",
    "(--verbose lists all)": "cosim/package/test_recorded_left_over.py::"
    "test_many_names_take_a_line_per_file_and_verbose_lists_them",
    "--only {} -o": "cosim/test_remedies_of_answers.py::test_what_an_answer_prints_is_executed",
}
"""Words of remedies that another test executes."""

NO_REMEDIES = {
    "joints; give 'calibration'": "the remedy of a law without a band, for coupled motors",
    "not a friction FMU": "lists the variables that an FMU must have",
    "ParFam structure has": "describes a law file that only HESR writes",
    "ParFam unit {}": "describes a law file that only HESR writes",
    "ripple {} needs": "describes a law file that only HESR writes",
    "Coupling: gauss_seidel": "describes a system; nothing is wrong",
    "Proposed by 'hesr inspect'": "names the origin of a file",
    "Written by 'hesr new'": "names the origin of a file",
    "needs 'integrals'": "states which entries of one table belong together",
    "a text; use 'set'": "no tool writes FMUs whose inputs are texts; the option is that of starts",
    "failures under --kind": "title of a group of rules",
    "foreign code can do here": "title of a group of rules",
    "'hesr simulate' does not support": "title of a group of rules",
    "options = {": "line of a proposed study, which is run",
    'law = "{}"': "line of a proposed study, which is run",
    "seed = 0": "line of a proposed study, which is run",
    "laws = {}": "line of a proposed study, which is run",
    # Formulas.
    "shift = the same": "formula",
    "near q = 0": "formula",
    "base at q = 0": "formula",
    "dq_comp = 0": "formula",
    "dq = ddq = 0": "formula",
    "preview = latency": "formula",
    "w = 2 pi": "formula",
    "sweep     phi": "formula",
    "*needed = ": "a line of C",
    "int l = 0": "a line of C",
    "int far = 0": "a line of C",
}
"""Words of texts that look like remedies, each with the reason why it is none."""


def list_modules() -> list[Path]:
    return [
        path
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        if not {*path.parts, path.stem} & {*OTHER_TABLE}
    ]


def list_words() -> list[str]:
    return [words for table in (*TABLES, ELSEWHERE, NO_REMEDIES) for words in table]


def test_every_remedy_is_executed() -> None:
    listed = [*list_words(), *MOVED]
    remedies = find_remedies(list_modules())
    assert len(remedies) > 100
    assert [text for text in sorted(remedies) if not any(words in text for words in listed)] == []


MOVED = ("hesr fit ", "hesr test ", "hesr inspect LOG...", "hesr simulate SWEEP", "hesr monitor ",
         "hesr export ", "hesr report ")  # fmt: skip
"""New forms of verbs, which `test_the_new_form_of_a_verb_is_a_command` parses."""


def test_listed_words_are_printed() -> None:
    texts = find_remedies(list_modules())
    words = [*(words for table in (ELSEWHERE, NO_REMEDIES) for words in table), *MOVED]
    assert [w for w in words if w != "hesr {}" and not any(w in text for text in texts)] == []


@pytest.mark.parametrize("test", sorted(set(ELSEWHERE.values())))
def test_tests_of_other_modules_exist(test: str) -> None:
    file, _, name = test.partition("::")
    tree = ast.parse((ROOT / "tests" / file).read_text(encoding="utf-8"))
    assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_a_new_remedy_is_found(tmp_path: Path) -> None:
    """A sentence that no table has fails the test above."""
    module = tmp_path / "module.py"
    module.write_text(
        "def refuse():\n    raise ValueError(f\"{1}: no rate; give 'sample_rate'.\")\n"
        'REMEDY = "set rate = [5.0] in the file"\nNOTE = "rows are late"\n',
        encoding="utf-8",
    )
    assert len(find_remedies([module])) == 2
