"""The control of every engine: a plain FMU with results in closed form.

It contains no code of this project, so that an engine which fails it is driven wrongly here.
"""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from interop.case import Alone, Case, opened_case

from cosim.systems.system import ComponentSpec, SystemSpec, write_system
from fmu_src.export.toolchain import TARGETS, build
from hesr_model.support.arrays import Array

SOURCE = Path(__file__).with_name("control.c")
GAIN, STEP, STEPS = 3.0, 0.005, 400

TOLERANCE = 1e-9
"""Largest deviation, relative to the largest value; engines sum steps in their own way."""

_DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Control" guid="{control-1}"
  numberOfEventIndicators="0">
  <ModelExchange modelIdentifier="Control"/>
  <CoSimulation modelIdentifier="Control" canHandleVariableCommunicationStepSize="true"/>
  <DefaultExperiment startTime="0" stopTime="2" stepSize="0.005"/>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input" variability="continuous">
      <Real start="0"/></ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output" variability="continuous"
      initial="calculated"><Real/></ScalarVariable>
    <ScalarVariable name="gain" valueReference="2" causality="parameter" variability="fixed"
      initial="exact"><Real start="2"/></ScalarVariable>
    <ScalarVariable name="clock" valueReference="3" causality="output" variability="discrete"
      initial="calculated"><Real/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="2" dependencies="1"/><Unknown index="4" dependencies=""/></Outputs>
    <InitialUnknowns><Unknown index="2" dependencies="1 3"/><Unknown index="4" dependencies=""/>
    </InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""


@dataclass(frozen=True, kw_only=True)
class Control:
    """A case and its results (N,) by signal."""

    case: Case
    expected: Mapping[str, Array]


def control_fmu(folder: Path) -> Path:
    """Compile the FMU for this machine."""
    headers = str(files("fmpy") / "c-code")
    target = TARGETS["linux64"]
    library = build(SOURCE, "Control", target, (f"-I{headers}", "-DFMI2_OVERRIDE_FUNCTION_PREFIX"))
    path = folder / "Control.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", _DESCRIPTION)
        archive.writestr(f"binaries/linux64/Control{target.suffix}", library)
    return path


def controls(folder: Path) -> tuple[Control, Control]:
    """Return the FMU alone, and two of them in a row."""
    fmu = control_fmu(folder)
    t = STEP * np.arange(STEPS + 1, dtype=float)
    u = np.sin(2.0 * np.pi * t + 0.5)
    held = np.r_[u[0], u[:-1]]
    alone = Alone(
        name="control",
        fmu=fmu,
        step=STEP,
        steps=STEPS,
        inputs={"u": u},
        outputs=("y", "clock"),
        start={"gain": GAIN},
    )
    spec = SystemSpec(
        name="control",
        step=STEP,
        stop=STEP * STEPS,
        components=(
            ComponentSpec(name="a", fmu=fmu, start={"u": 0.0}),
            ComponentSpec(name="b", fmu=fmu, start={"gain": GAIN}),
        ),
        connections={"b.u": "a.clock"},
        observe=("a.clock", "b.y"),
    )
    with opened_case(write_system(spec, folder / "SYSTEM.toml"), folder) as together:
        late = GAIN * np.r_[0.0, t[:-1]]  # whatever an engine gives before the first step
        return (
            Control(case=alone, expected={"y": GAIN * held, "clock": t}),
            Control(case=together, expected={"a.clock": t, "b.y": late}),
        )
