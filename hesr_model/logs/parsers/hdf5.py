"""HDF5 files, also those of MATLAB 7.3."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.log_table import NO_NUMBERS, TextCell, compute_max_bytes, readable
from hesr_model.logs.number_arrays import find_number_arrays
from hesr_model.logs.parsers.items import build_item
from hesr_model.support.arrays import Array
from hesr_model.support.child_main import Item
from hesr_model.support.text import quote


def parse(path: Path, *, kind: str, transposed: bool) -> Iterator[Item]:
    """Yield the arrays of numbers by path with dots; raises LogError that names the `kind`."""
    import h5py  # slow to import, and optional

    external_links: dict[str, str] = {}  # h5py does not let its visitor raise

    def note_external_link(name: str, link: Any) -> None:
        if isinstance(link, h5py.ExternalLink):
            external_links[name] = str(link.filename)

    arrays: dict[str, Array | TextCell] = {}
    units: list[list[str]] = []  # pairs of name and unit
    bytes_left = compute_max_bytes(path)

    def visit(name: str, dataset: Any) -> None:
        if not isinstance(dataset, h5py.Dataset):
            return
        _require_own_data(path, name, dataset)
        # Characters are numbers; '#refs#' holds targets of references in struct arrays.
        if name.startswith("#"):
            return
        is_number = dataset.attrs.get("MATLAB_class", b"") not in (b"char", b"cell")
        if is_number and dataset.dtype.kind in "fiuV" and "MATLAB_empty" not in dataset.attrs:
            nonlocal bytes_left
            bytes_left -= max(8, dataset.dtype.itemsize) * dataset.size
            if bytes_left < 0:
                raise LogError(
                    f"{path}: claims more data than fits into the file.",
                    code="log.too_large",
                    where=path,
                )
            units.extend([name.replace("/", "."), unit] for unit in _read_units(dataset))
            array = np.asarray(dataset)
            arrays.update(
                find_number_arrays(array.T if transposed else array, name.replace("/", "."))
            )
        else:
            arrays[name.replace("/", ".")] = NO_NUMBERS

    with readable(path, f"a {kind}"), h5py.File(path, "r", locking=False) as file:
        file.visititems_links(note_external_link)
        if external_links:
            name, other_file = next(iter(external_links.items()))
            raise _build_reference_error(path, name, "an external link to an object", other_file)
        file.visititems(visit)
    yield build_item(arrays.items(), names=units)


def _read_units(dataset: Any) -> Iterator[str]:
    """Yield the unit of a data set that an attribute states, if one does."""
    for attribute in ("units", "unit"):
        unit = dataset.attrs.get(attribute, "")
        if isinstance(unit, bytes):
            unit = unit.decode("utf-8", "replace")
        if isinstance(unit, str) and unit:
            yield unit
            return


def _require_own_data(path: Path, name: str, dataset: Any) -> None:
    """Refuse data of other files; raises LogError.

    Reading would open any file of the user, or wait for a pipe. Even the size of a virtual data set
    depends on its sources.
    """
    if dataset.is_virtual:
        sources = {source.file_name for source in dataset.virtual_sources()}
        raise _build_reference_error(path, name, "a virtual data set", ", ".join(sorted(sources)))
    if dataset.external:
        raise _build_reference_error(path, name, "external storage", dataset.external[0][0])


def _build_reference_error(path: Path, name: str, reference: str, other_file: str) -> LogError:
    return LogError(
        f"{path}: {quote(name)} is {reference} of {quote(other_file)}, which is not opened; save "
        "all numbers in one file, as data sets without such references.",
        code="log.other_file",
        where=path,
        key=name,
    )
