"""An MJCF as an FMU that runs in its host's Python: the twin of the native one, by PythonFMU."""

import hashlib
import json
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree as ET

from fmu_src.arm.native import description, licences, model_name
from fmu_src.arm.signals import signals_of
from fmu_src.arm.variables import variables
from fmu_src.export.description import RELEASED, to_xml
from fmu_src.export.interface import Interface
from fmu_src.export.package import check_request, write_archive
from fmu_src.run.fmu import remember
from hesr_model.errors import ConfigError

MODEL, TABLE, ABOUT = "model.xml", "signals.toml", "about.json"
"""Names among the FMU's resources."""

_MODULE = "hesr_python_arm"
"""Not that of a module of anyone else: all Python FMUs of a process share one list of modules."""


def export_python_arm(path_of_mjcf: Path, table: Path | None, output: Path) -> Path:
    """Write an MJCF as an FMU that needs a host with Python, HESR and MuJoCo.

    Its variables are those of the native FMU; both give the same results.

    Parameters
    ----------
    path_of_mjcf : the MJCF, which refers to no other files.
    table : TOML file that names its signals; every control and sensor if None.
    output : the FMU to write, ending in .fmu.

    Returns
    -------
    `output`.

    Raises
    ------
    ConfigError
        If the MJCF or the table is missing or not valid, or a name in the table is unknown.
    ExportError
        If a name is not one of FMI, or `output` has the wrong suffix.
    ArtifactError
        If `output` cannot be written.
    """
    check_request(output, ("linux64",))
    about = _about(path_of_mjcf, table)
    with TemporaryDirectory(prefix="hesr-") as folder:
        parts = {MODEL: path_of_mjcf.read_bytes(), ABOUT: json.dumps(about).encode()}
        if table is not None:
            parts[TABLE] = table.read_bytes()
        for name, content in parts.items():
            Path(folder, name).write_bytes(content)
        _check_alone(Path(folder, MODEL), path_of_mjcf)
        built = _built(Path(folder), list(parts))
        with zipfile.ZipFile(built) as archive:
            members = {name: archive.read(name) for name in sorted(archive.namelist())}
    members["modelDescription.xml"] = about["xml"].encode()  # PythonFMU's has its lines apart
    write_archive(members | licences("pythonfmu"), output, RELEASED)
    remember(output)
    return output


def _about(path: Path, table: Path | None) -> dict[str, str]:
    """Return identifier and model description; a slave could not tell its own GUID."""
    signals = signals_of(path, table)
    about = description(signals, model_name(signals.model, path))
    shown = Interface(
        variables=variables(signals), model_exchange=False, directional_derivatives=False
    )
    content = hashlib.sha256(to_xml(shown, about, "") + path.read_bytes()).hexdigest()
    root = ET.fromstring(to_xml(shown, about, content))
    kind = root.find("CoSimulation")
    if kind is None:
        raise ValueError("the description is not one of co-simulation")
    kind.set("needsExecutionTool", "true")
    kind.set("canInterpolateInputs", "false")
    return {"identifier": about.identifier, "xml": _text(root)}


def _text(root: ET.Element) -> str:
    text: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text.decode()


def _check_alone(copy: Path, path: Path) -> None:
    try:
        signals_of(copy)
    except ConfigError as error:
        raise ConfigError(
            f"{path}: refers to other files, which an FMU in Python does not carry."
        ) from error


def _built(folder: Path, parts: list[str]) -> Path:
    """Let PythonFMU put the parts together with a copy of the slave."""
    from pythonfmu.builder import FmuBuilder  # slow to import

    script = folder / "slave" / f"{_MODULE}.py"
    script.parent.mkdir()
    script.write_bytes(Path(__file__).with_name("slave.py").read_bytes())
    with _undisturbed():
        FmuBuilder.build_FMU(
            script, dest=folder / "built.fmu", project_files=[folder / name for name in parts]
        )
    return folder / "built.fmu"


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Take back what the builder adds to the modules of this process and their places."""
    places = list(sys.path)
    try:
        yield
    finally:
        sys.path[:] = places
        sys.modules.pop(_MODULE, None)
