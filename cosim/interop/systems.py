"""Systems as cases, from the files in which they come."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cosim.interop.case import Together
from cosim.systems.contents import read_contents
from cosim.systems.ssp import write_ssp
from cosim.systems.ssp_reader import opened_system


@contextmanager
def opened_case(path: Path, folder: Path) -> Iterator[Together]:
    """Yield a system as a case: an SSP, or a system file, which is packaged as one.

    All outputs are compared that are connected or observed.

    Parameters
    ----------
    path : the SSP or the TOML file.
    folder : for the SSP of a TOML file.

    Raises
    ------
    ConfigError
        If it cannot be read, or its system does not fit its FMUs.
    """
    with opened_system(path) as spec:
        contents = read_contents(spec, path)
        packaged = path.suffix.lower() == ".ssp"
        yield Together(
            name=path.stem if packaged else spec.name,
            spec=spec,
            ssp=path if packaged else write_ssp(contents, folder / f"{spec.name}.ssp"),
            signals=[f"{name}.{variable}" for name, variable in contents.used],
        )
