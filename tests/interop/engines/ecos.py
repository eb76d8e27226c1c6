"""ecos, by its Python interface."""

from pathlib import Path
from xml.etree import ElementTree as ET

from interop.case import Run, Together
from interop.engine import Engine, SkippedError, Tools, given_together, host

from fmu_src.run.archive import MAX_TEXT_BYTES, Archive
from fmu_src.run.master import ExchangeScheme

_SET = "}ParameterSet"


def _together(tools: Tools, case: Together, folder: Path) -> Run:
    python = tools.python("ecospy")[0]
    names = parameter_sets(case.ssp)
    if len(names) > 1:
        raise SkippedError("it applies parameter sets of one name, the SSP has several")
    given = given_together(case) | {"parameter_set": next(iter(names), None)}
    return host(python, "run_ecos.py", given, folder)


def parameter_sets(ssp: Path) -> set[str]:
    """Return the names of all parameter sets in an SSP."""
    with Archive(ssp, "SSP") as archive:
        roots = [
            ET.fromstring(archive.read(name, MAX_TEXT_BYTES))
            for name in archive.names
            if name.endswith((".ssd", ".ssv"))
        ]
    return {e.get("name", "") for root in roots for e in root.iter() if e.tag.endswith(_SET)}


ECOS = Engine(
    name="ecos",
    install="pip install ecospy, and the system's libtbb12 and unzip",
    find=lambda tools: tools.python("ecospy")[1],
    together=_together,
    coupling=ExchangeScheme(refreshed="shown"),
)
