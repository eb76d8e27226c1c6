"""Export of an MJCF as an FMU of native C with MuJoCo's library, for hosts without Python."""

import hashlib
import importlib.metadata
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco

from fmu_src.arm.library import library
from fmu_src.arm.parts import ArmSignals, variables
from fmu_src.arm.signals import signals_of
from fmu_src.arm.signals_h import to_h
from fmu_src.arm.table import SignalTable
from fmu_src.export.description import RELEASED, Description
from fmu_src.export.interface import Interface
from fmu_src.export.package import Content, check_request, own_source, write_fmu
from fmu_src.run.reference_results import Stimuli, waves
from hesr_model.errors import ExportError
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Progress, silent

_SMALL = 0.1  # amplitude of controls in the reference results
_OWN, _OF_LOSS = 4, 2  # state variables of mjcf.c without MuJoCo's, and per loss
_SOURCES = (
    *("mjcf.c", "mjcf_losses.h", "mjcf_parameters.h", "beside.h", "guard.h"),
    *("mujoco_library.h", "noise.h", "resource.h"),
)


def export_mjcf(
    model: Path,
    path: Path,
    *,
    table: Path | SignalTable | ArmSignals | None = None,
    platforms: Sequence[str] = ("linux64",),
    progress: Progress = silent,
) -> Path:
    """Write an MJCF as an FMI 2.0 FMU for co-simulation, simulated by MuJoCo."""
    wanted = check_request(path, platforms)
    signals = table if isinstance(table, ArmSignals) else signals_of(model, table)
    content = arm(
        signals,
        name=model_name(signals.model, model),
        source=model.read_bytes(),
        platforms=[target.folder for target in wanted],
    )
    return write_fmu(content, path, platforms=platforms, progress=progress)


def model_name(model: Any, path: Path) -> str:
    """Return the name of the model in an MJCF, by default that of its file."""
    name = bytes(model.names).partition(b"\0")[0].decode()
    return path.stem if name in ("", "MuJoCo Model") else name


def arm(
    signals: ArmSignals, *, name: str, source: bytes, platforms: Sequence[str] = ("linux64",)
) -> Content:
    """Return the FMU of a model for folders of binaries; `source` is its MJCF, as documentation.

    Raises ExportError if MuJoCo for a platform is unavailable or the model needs plugins.
    """
    model = signals.model
    if model.nplugin:
        raise ExportError(f"model '{name}': plugins of MuJoCo are not supported in an FMU.")
    state = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)
    table = Interface(
        variables=variables(signals),
        own=_OWN + _OF_LOSS * len(signals.losses) + state,
        model_exchange=False,
        directional_derivatives=False,
    )
    compiled = _binary(model)
    digest = hashlib.sha256(compiled).hexdigest()
    return Content(
        table=table,
        about=description(signals, name),
        sources={name: own_source(name) for name in _SOURCES}
        | {"signals.h": to_h(signals, table, state=state, digest=digest)},
        members={
            "resources/model.mjb": compiled,
            "resources/model.xml": source,
            **licences("mujoco"),
        },
        libraries={platform: library(platform) for platform in platforms},
        stimuli=Stimuli(step=signals.step, inputs=waves({i.name: _SMALL for i in signals.inputs})),
    )


def description(signals: ArmSignals, name: str) -> Description:
    """Return the description of an FMU of a model, without variables."""
    return Description(
        name=name,
        identifier=re.sub(r"^(?=\d)", "_", re.sub(r"\W", "_", name, flags=re.ASCII)),
        text=f"{name}, simulated by MuJoCo {mujoco.__version__}.",
        created=RELEASED,
        step=signals.step,
        sources=(),
    )


def licences(package: str) -> dict[str, bytes]:
    """Return licence and notices of an installed package as members of an FMU."""
    return {
        f"documentation/licenses/{package}-{f.name}": Path(str(f.locate())).read_bytes()
        for f in importlib.metadata.files(package) or []
        if "licenses" in f.parts or f.name.upper().startswith("LICENSE")
    }


def _binary(model: Any) -> bytes:
    with scratch_folder() as folder:
        file = Path(folder, "model.mjb")
        mujoco.mj_saveModel(model, str(file), None)
        return file.read_bytes()
