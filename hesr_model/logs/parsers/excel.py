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
from hesr_model.support.text import count_noun

Row = tuple[Any, ...]

_CELL_BYTES = 8  # of an empty cell in memory


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
        max_cells = compute_max_bytes(path) // _CELL_BYTES
        rows_by_title: dict[str, list[Row]] = {}
        for sheet in book.worksheets:
            rows = _read_rows(path, sheet, max_cells)
            max_cells -= sum(_count_cells(row) for row in rows)
            if rows:
                rows_by_title[sheet.title] = rows
        book.close()
        longest = max(rows_by_title, key=lambda title: len(rows_by_title[title]), default="")
        text = _format_rows(rows_by_title.pop(longest, []))
        others = [
            f"{title} ({count_noun(len(rows), 'row')})" for title, rows in rows_by_title.items()
        ]
        yield build_item([("text", np.frombuffer(text, np.uint8))], names=[others])


def _read_rows(path: Path, sheet: Any, max_cells: int) -> list[Row]:
    """Return the rows of a sheet; raises LogError for more cells than `max_cells`.

    The reader also yields the rows and cells that the numbers in the file skip, of any number.
    """
    rows = []
    cell_count = 0
    for row in sheet.iter_rows(values_only=True):
        cell_count += _count_cells(row)
        if cell_count > max_cells:
            raise LogError(
                f"{path}: its sheets claim more cells than fit into the file.",
                code="log.too_large",
                where=path,
            )
        rows.append(row)
    return rows


def _count_cells(row: Row) -> int:
    """Return the cells of a row, and one for the row itself."""
    return len(row) + 1


def _format_rows(rows: list[Row]) -> bytes:
    filled: set[int] = set()
    for row in rows:
        filled.update(k for k, cell in enumerate(row) if cell is not None)
    filled_columns = sorted(filled)
    file = io.StringIO()
    writer = csv.writer(file, delimiter="\t", lineterminator="\n")
    for row in rows:
        padded_row = dict(enumerate(row))
        cells = [padded_row.get(k) for k in filled_columns]
        writer.writerow(cells)
    return file.getvalue().encode()
