"""Export of an observer as an FMU or one C header."""

import re
from collections.abc import Sequence
from pathlib import Path

from fmu_src.export import package
from fmu_src.friction.validity import require_exportable
from fmu_src.pages.html import code_templates
from fmu_src.plant.plant_fmu import PlantBody
from hesr.extras.observer.observation import limits_of
from hesr.extras.observer.observer_fmu import BANDWIDTH, HERE, content, outputs_of
from hesr_model.errors import ExportError
from hesr_model.friction.model import FrictionModel
from hesr_model.support.files import PathArg, written_whole
from hesr_model.support.progress import Progress, silent


def export_observer(
    model: FrictionModel,
    path: Path,
    *,
    body: PlantBody,
    calibration: Sequence[PathArg] | None = None,
    bandwidth: float = BANDWIDTH,
    torque_constants: Sequence[float] | None = None,
    platforms: Sequence[str] = ("linux64",),
    progress: Progress = silent,
    fmi: package.Version = 2,
) -> Path:
    """Write an observer of the external torque as an FMU (.fmu), or as one C header (.h).

    `calibration` are logs without contact that were left out of the fit; by default limits come
    from the bands of the law. With `torque_constants` (n,) [N.m/A] the inputs are currents. Raises
    ExportError if model and robot do not fit, or there are no limits.
    """
    alone = path.suffix == ".h"
    if not alone:
        package.check_request(path, platforms)
    elif not re.fullmatch(r"[A-Za-z_]\w*", path.stem, re.ASCII):
        raise ExportError(f"{path}: '{path.stem}' is not a valid C name.")
    require_exportable(model, "the C header of an observer", thermal=not alone)
    limits = limits_of(model, body, calibration or (), bandwidth)
    whole = content(
        model, body, limits, bandwidth=bandwidth, constants=torque_constants, bare=alone
    )
    if not alone:
        return package.write_fmu(whole, path, platforms=platforms, progress=progress, fmi=fmi)
    with written_whole(path) as temporary:
        temporary.write_text(header_of(whole, path.stem), encoding="utf-8", newline="\n")
    return path


def header_of(whole: package.Content, name: str) -> str:
    """Return an observer as one C header, with functions of the prefix `name`."""
    _, sources = package.translation_unit(whole)
    missing = dict(sources)

    def text_of(file: str) -> str:
        text = missing.pop(file, "")
        return re.sub(r'#include "([^"]+)"\n', lambda m: text_of(m[1]), text)

    template = code_templates(HERE / "templates").get_template("observer.h.j2")
    outputs = [(a.name, len(a.elements), a.place) for a in outputs_of(whole.table)]
    own = text_of("observer.c")
    return str(template.render(name=name, text=whole.about.text, own=own, outputs=outputs))
