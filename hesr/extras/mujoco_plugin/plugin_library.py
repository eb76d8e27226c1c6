"""Export of a law as a shared library for MuJoCo, with the MJCF that uses it."""

from importlib.metadata import version
from pathlib import Path

from markupsafe import escape

from fmu_src.arm.library import library
from fmu_src.export.interface import to_c
from fmu_src.export.package import add_headers
from fmu_src.export.toolchain import TARGETS, build
from fmu_src.friction.friction_component import friction_equations
from fmu_src.friction.validity import find_discretisation, require_exportable
from fmu_src.pages.html import code_templates
from fmu_src.run.instance import PLATFORM
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import TAU_LOAD
from hesr_model.friction.model import FrictionModel
from hesr_model.support.files import scratch_folder, written_whole


def export_mujoco_plugin(model: FrictionModel, path: Path) -> Path:
    """Write the library NAME.so for the installed MuJoCo and this platform, and NAME.xml.

    The MJCF has one instance of the plug-in `hesr.NAME` per joint, for the joint of the same name.
    """
    if path.suffix != ".so" or PLATFORM not in ("linux64", "aarch64-linux"):
        raise ExportError(f"{path}: a plug-in of MuJoCo is a library (.so) for Linux.")
    require_exportable(model, "a plug-in of MuJoCo", coupled=False)
    interface, equations_header = friction_equations(model, steps_together=False)
    plugin_name = f"hesr.{path.stem}"
    templates = code_templates(Path(__file__).parent / "templates")
    plugin_source = templates.get_template("plugin.c.j2").render(
        name=plugin_name,
        version=version("mujoco-core"),
        loaded=", ".join(str(int(TAU_LOAD in law.form.inputs)) for law in model.laws),
        euler=float(find_discretisation(model) == "euler"),
    )
    interface_header = to_c(interface, "", model.sample_time)
    sources = {
        "interface.h": interface_header,
        "equations.h": equations_header,
        "plugin.c": plugin_source,
    }
    with scratch_folder() as folder:
        for name, content in add_headers(sources).items():
            (folder / name).write_text(content, encoding="utf-8")
        flags = (*library(PLATFORM).flags, "-std=c11", "-ldl")  # as MuJoCo's headers
        binary = build(folder / "plugin.c", path.stem, TARGETS[PLATFORM], flags)
    instances = "".join(
        f'      <instance name="{plugin_name}.{number}">'
        f'<config key="joint" value="{escape(joint)}"/>'
        f'<config key="law" value="{number}"/></instance>\n'
        for number, joint in enumerate(model.joints, start=1)
    )
    mjcf_head = f'<mujoco>\n  <extension>\n    <plugin plugin="{plugin_name}">\n{instances}'
    with written_whole(path) as library_file, written_whole(path.with_suffix(".xml")) as mjcf_path:
        library_file.write_bytes(binary)
        mjcf_path.write_text(
            mjcf_head + "    </plugin>\n  </extension>\n</mujoco>\n", encoding="utf-8"
        )
    return path
