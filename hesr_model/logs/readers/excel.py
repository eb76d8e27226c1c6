"""Excel workbooks; needs openpyxl."""

import csv
import io
import zipfile
from pathlib import Path
from typing import Any

from hesr_model.errors import LogError
from hesr_model.logs.csv_text import read_text
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.log_table import LogTable, compute_max_bytes, readable
from hesr_model.logs.readers.formats import table_format
from hesr_model.logs.tables import require_content
from hesr_model.support.extras import install_command


def _read(path: Path, log_format: LogFormat) -> LogTable:
    """Read the longest sheet as text, whose lines are the rows of the sheet."""
    require_content(path)
    try:
        import openpyxl
    except ModuleNotFoundError as error:
        raise LogError(
            f"{path}: Excel workbooks need openpyxl: {install_command('formats')}.",
            code="log.package",
            where=path,
        ) from error
    with readable(path, "an Excel workbook"):
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > compute_max_bytes(path):
                raise LogError(
                    f"{path}: claims more data than fits into the file.",
                    code="log.too_large",
                    where=path,
                )
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheets = [list(sheet.iter_rows(values_only=True)) for sheet in book.worksheets]
        book.close()
    return read_text(path, log_format.columns.names, _format_rows(max(sheets, key=len, default=[])))


def _format_rows(rows: list[tuple[Any, ...]]) -> bytes:
    column_count = max(map(len, rows), default=0)
    filled_columns = [
        k for k in range(column_count) if any(k < len(row) and row[k] is not None for row in rows)
    ]
    file = io.StringIO()
    writer = csv.writer(file, delimiter="\t", lineterminator="\n")
    for row in rows:
        cells = [row[k] if k < len(row) else None for k in filled_columns]
        writer.writerow(cells if any(cell is not None for cell in cells) else [])
    return file.getvalue().encode()


FORMAT = table_format("Excel workbook", {".xlsx", ".xlsm"}, _read)
