"""A system of FMUs as an SSP, which other co-simulation engines read."""

from pathlib import Path

from cosim.systems.contents import SystemContents
from cosim.systems.markup import Version
from cosim.systems.ssd import SSD, resource, to_ssd
from cosim.systems.ssp_results import result_files
from cosim.systems.ssv import to_ssv
from fmu_src.export.package import zip_members
from hesr_model.errors import ConfigError
from hesr_model.support.files import written_whole


def write_ssp(contents: SystemContents, path: Path, *, version: Version = "1.0") -> Path:
    """Write a system with its FMUs as an SSP: the same bytes every time.

    Where all FMUs are ours it carries the system's signals as reference results.

    Parameters
    ----------
    contents : the system.
    path : the file to write, ending in .ssp.
    version : of the standard; libcosim and ecos read 1.0 only.

    Returns
    -------
    `path`.

    Raises
    ------
    ConfigError
        If the name does not end so.
    ArtifactError
        If it cannot be written.
    """
    if path.suffix != ".ssp":
        raise ConfigError(f"{path}: the name of a packaged system ends in .ssp.")
    members = {SSD: to_ssd(contents, version)}
    for component in contents.spec.components:
        name = component.name
        if contents.wiring.start[name]:
            members[resource(name, ".ssv")] = to_ssv(contents, name, version)
        members[resource(name, ".fmu")] = component.fmu.read_bytes()
    members |= result_files(contents)
    with written_whole(path) as temporary:
        zip_members(temporary, members, contents.created)
    return path


def left_out(contents: SystemContents) -> str | None:
    """Return one sentence on what of a system its SSP has not, None if that is nothing.

    Connectors of inputs that nothing feeds, of parameters and of what is local would be refused by
    engines, so that an SSP observes outputs only.
    """
    from hesr_model.support.text import listed

    used = set(contents.used)
    observed = [".".join(e) for e in contents.wiring.observed if e not in used]
    parts = [f"observes outputs only, not {listed(observed)}"] if observed else []
    parts += [f"has no limits of {listed(contents.spec.limits)}"] if contents.spec.limits else []
    return f"The SSP {', and '.join(parts)}." if parts else None
