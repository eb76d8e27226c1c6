"""pandas tables and xarray data sets, imported on use."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

from hesr_model.errors import ConfigError
from hesr_model.support.arrays import Array


def pandas_frame(columns: Mapping[str, Any], index: str | None = None) -> Any:
    """Return columns (N,) as a `pandas.DataFrame`."""
    frame = _library("pandas").DataFrame(dict(columns))
    return frame if index is None else frame.set_index(index)


def xarray_dataset(
    t: Array, signals: Mapping[str, tuple[Array, str]], joints: Sequence[str], **about: Any
) -> Any:
    """Return signals (N, n) with units as an `xarray.Dataset` over t [s] and joints."""
    return _library("xarray").Dataset(
        {name: (("t", "joint"), values, {"units": u}) for name, (values, u) in signals.items()},
        coords={"t": ("t", t, {"units": "s"}), "joint": list(joints)},
        attrs=about,
    )


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise ConfigError(f"{name} is not installed; pip install 'hesr[tables]'.") from error
