"""Excel workbooks."""

import csv
import io
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.log_table import compute_max_bytes, readable
from hesr_model.logs.parsers.items import build_item
from hesr_model.support.child_main import Item


def parse(path: Path) -> Iterator[Item]:
    """Yield the longest sheet as text, whose lines are the rows of the sheet; raises LogError."""
    import openpyxl  # slow to import, and optional

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
        text = _format_rows(max(sheets, key=len, default=[]))
        yield build_item([("text", np.frombuffer(text, np.uint8))])


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
