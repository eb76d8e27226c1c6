"""Export of an MJCF as an FMU that runs in the host's Python, by PythonFMU."""

import hashlib
import json
import sys
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from fmu_src.arm.native import arm_page, arm_stimuli, description, licences, model_name
from fmu_src.arm.signals import read_signals
from fmu_src.arm.table import SignalTable, variables
from fmu_src.export.description import RELEASE_DATE, Description, to_xml
from fmu_src.export.interface import Interface
from fmu_src.export.package import check_request, read_licence, write_archive
from fmu_src.run.reference_results import result_files
from fmu_src.run.trust import remember
from hesr_model.errors import ConfigError
from hesr_model.support.files import scratch_folder

MODEL = "model.xml"
ABOUT = "about.json"  # names of the FMU's resources

_MODULE = "hesr_python_arm"  # unique: all Python FMUs of a process share the list of modules


def export_python_arm(mjcf: Path, table: Path | SignalTable | None, output: Path) -> Path:
    """Write an MJCF, without references to files, as an FMU for hosts with HESR and MuJoCo."""
    check_request(output, ("linux64",))
    signals = read_signals(mjcf, table)
    interface = Interface(
        variables=variables(signals), model_exchange=False, directional_derivatives=False
    )
    description_of_arm = description(signals, model_name(signals.model, mjcf))
    about = _describe_arm(mjcf, table, interface, description_of_arm)
    with scratch_folder() as folder:
        parts = [Path(folder, MODEL), Path(folder, ABOUT)]
        parts[0].write_bytes(mjcf.read_bytes())
        parts[1].write_text(json.dumps(about), encoding="utf-8")
        try:
            read_signals(parts[0])
        except ConfigError as error:
            raise ConfigError(
                f"{mjcf}: refers to other files, which python-arm does not support."
            ) from error
        with zipfile.ZipFile(_build_fmu(Path(folder), parts)) as archive:
            members = {name: archive.read(name) for name in sorted(archive.namelist())}
    members["modelDescription.xml"] = about["xml"].encode()  # PythonFMU's has no line breaks
    members |= arm_page(signals, interface, description_of_arm)
    members |= result_files(members, arm_stimuli(signals))
    members |= read_licence()
    write_archive(members | licences("pythonfmu"), output, RELEASE_DATE)
    remember(output)
    return output


def _describe_arm(
    mjcf: Path, table: Path | SignalTable | None, interface: Interface, about: Description
) -> dict[str, Any]:
    if isinstance(table, Path):
        table = SignalTable.read(table)
    signals = None
    if table is not None:
        signals = table.model_dump()
    content = hashlib.sha256(to_xml(interface, about, "") + mjcf.read_bytes()).hexdigest()
    root = ET.fromstring(to_xml(interface, about, content))
    kind = root.find("CoSimulation")
    if kind is None:
        raise ValueError("the description is not one of co-simulation")
    kind.set("needsExecutionTool", "true")
    kind.set("canInterpolateInputs", "false")
    text: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return {
        "identifier": about.identifier,
        "xml": text.decode(),
        "signals": signals,
    }


def _build_fmu(folder: Path, parts: list[Path]) -> Path:
    from pythonfmu.builder import FmuBuilder  # slow to import

    script = folder / "slave" / f"{_MODULE}.py"
    script.parent.mkdir()
    script.write_bytes(Path(__file__).with_name("slave.py").read_bytes())
    module_paths = list(sys.path)
    try:
        FmuBuilder.build_FMU(script, dest=folder / "built.fmu", project_files=parts)
    finally:  # undo the builder's changes
        sys.path[:] = module_paths
        sys.modules.pop(_MODULE, None)
    return folder / "built.fmu"
