"""Excel workbooks; needs openpyxl."""

from dataclasses import replace
from pathlib import Path

from hesr_model.errors import LogError
from hesr_model.logs.csv_text import read_text
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.log_table import LogTable
from hesr_model.logs.parsed_file import has_module, parse_file
from hesr_model.logs.readers.formats import table_format
from hesr_model.logs.tables import require_content
from hesr_model.support.extras import install_command


def _read(path: Path, log_format: LogFormat) -> LogTable:
    """Read the longest sheet as text, whose lines are the rows of the sheet."""
    require_content(path)
    if not has_module("openpyxl"):
        raise LogError(
            f"{path}: Excel workbooks need openpyxl: {install_command('formats')}.",
            code="log.package",
            where=path,
        )
    (item,) = parse_file(path, "an Excel workbook", "excel:parse", ["openpyxl"])
    (text,) = item.arrays.values()
    table = read_text(path, log_format.columns.names, text.tobytes())
    other_sheets = [f"sheet {title}" for titles in item.names for title in titles]
    return replace(table, other_names=(*table.other_names, *other_sheets))


FORMAT = table_format("Excel workbook", {".xlsx", ".xlsm"}, _read)
