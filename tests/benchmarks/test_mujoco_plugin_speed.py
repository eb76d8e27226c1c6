"""Speed of the plug-in for MuJoCo, as a ratio to a bare step of the FMU with the same law."""

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from c_hosts import HOSTS, build_host
from test_fmu_speed import InHost

from fmu_src import export_fmu, model_file
from fmu_src.arm.library import find_host_libraries
from hesr.extras.mujoco_plugin.plugin_library import export_mujoco_plugin
from hesr_model.friction.model import FrictionModel
from hesr_model.support.compiler import compile_c

AIM = 1.15
JOINT = '<body><joint name="{}"/><geom size=".1"/>'


@pytest.mark.parametrize("discretisation", ["euler", "exact"])
def test_three_joints_take_as_long_as_in_the_fmu(
    discretisation: str, tmp_path: Path, tell: Callable[[str], None]
) -> None:
    """Target: 1.15 of doStep, with both timed in hosts in C."""
    model = FrictionModel.read(model_file("uf850-table1"))
    laws = tuple(replace(law, discretisation=discretisation) for law in model.laws)
    own = replace(model, laws=laws)
    fmu = InHost.of(build_host("host.c", tmp_path), export_fmu(own, tmp_path / "F.fmu"), tmp_path)
    plugin = export_mujoco_plugin(own, tmp_path / "speed.so")
    bodies = "".join(JOINT.format(name) for name in own.joints) + "</body>" * 3
    scene = tmp_path / "scene.xml"
    scene.write_text(
        f'<mujoco><option timestep="0.005"/><include file="speed.xml"/><worldbody>{bodies}'
        "</worldbody></mujoco>"
    )
    [library] = find_host_libraries()
    program = tmp_path / "plugin_host"
    flags = ("-O2", "-std=c11", f"-isystem{library.parent / 'include'}", f"-I{HOSTS}")
    compile_c(
        HOSTS / "plugin_host.c", flags, program, (str(library), f"-Wl,-rpath,{library.parent}")
    )
    command = [str(program), str(plugin), str(scene), "20000"]

    def of_plugin() -> float:
        return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)

    pairs = [(of_plugin(), fmu.time()) for _ in range(7)]
    ours, known = (min(times) for times in zip(*pairs, strict=True))
    tell(
        f"MuJoCo plug-in, three joints, {discretisation}: {ours:.0f} ns, {ours / known:.2f} of "
        f"doStep (aim: {AIM})"
    )
