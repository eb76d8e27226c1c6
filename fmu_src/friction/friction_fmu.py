"""Export of a friction model as an FMU."""

import os
import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from math import inf
from pathlib import Path
from typing import Any

from fmu_src.export import package
from fmu_src.export.description import RELEASE_DATE, Description
from fmu_src.export.interface import Interface
from fmu_src.export.toolchain import HOST
from fmu_src.friction.discrete_fmu import (
    THERMAL_LINES,
    THERMAL_TORQUE,
    add_documentation,
    discrete_equations,
)
from fmu_src.friction.embedded_model import embed_model
from fmu_src.friction.friction_component import POWER, friction_equations
from fmu_src.friction.reference import reference_files, reference_motion
from fmu_src.friction.validity import require_numbers
from fmu_src.pages.datasheet import ModelAudit, ranges
from fmu_src.pages.friction_page import model_title, to_html
from fmu_src.pages.live import live_assets, live_data, live_section, wasm
from fmu_src.pages.picture import model_png
from hesr_model.audit.certificate import Certificate
from hesr_model.audit.properties import Properties
from hesr_model.equations.component import Equation
from hesr_model.errors import ExportError, HesrError
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.thermal_law import thermal_component
from hesr_model.robots.description import statements
from hesr_model.support import plugins
from hesr_model.support.owner import Owner
from hesr_model.support.progress import Progress, silent
from hesr_model.support.version import __version__

# Range of dates in a ZIP archive.
_FIRST_DATE = datetime(1980, 1, 1, tzinfo=UTC)
_LAST_DATE = datetime(2107, 12, 31, tzinfo=UTC)


def export_fmu(
    model: FrictionModel,
    path: Path,
    *,
    platforms: Sequence[str] = HOST,
    properties: Properties | None = None,
    audit: ModelAudit | None = None,
    power: bool = False,
    band: bool = False,
    low_pass: float | None = None,
    progress: Progress = silent,
    fmi: package.Version = 2,
    no_events: bool = False,
    no_documentation: bool = False,
) -> Path:
    """Write a friction model as an FMU of FMI 2.0 or 3.0 for co-simulation and model exchange.

    FMUs of thermal models are for co-simulation only. `properties` and the audit (by default
    computed) are for documentation. `power` and `band` add outputs: dissipated power,
    `tau_lower[i]` and `tau_upper[i]`; `low_pass` is the cut-off [Hz] of a causal low pass of dq in
    the FMU. With `no_events`, model exchange has no event indicators, and jumps are steep, see
    `STEEP`. With `no_documentation` there is neither page, picture nor reference results.

    The same model gives the same bytes. For the date see `fmu_date`. Raises ExportError if C or FMI
    cannot express the model or a thermal model gets options; SimulationError if it has no band.
    """
    package.check_request(path, platforms)
    if no_documentation and properties:
        raise ExportError(f"{path}: properties are for the page; omit no_documentation.")
    if model.thermal:
        if power or band or low_pass or properties or no_events:
            raise ExportError(
                f"friction model '{model.law}': a thermal FMU supports no power, band, low pass, "
                "properties or no_events; export the model without temperature."
            )
        content = _thermal_content(model, bare=no_documentation)
    else:
        extra_outputs: tuple[Equation, ...] = ()
        if power:
            extra_outputs = (POWER,)
        content = _component(
            model, extra_outputs, band=band, low_pass=low_pass, no_events=no_events
        )
        if not no_documentation:
            content = _add_documentation(content, _add_low_pass(model, low_pass), properties, audit)
    return package.write_fmu(content, path, platforms=platforms, progress=progress, fmi=fmi)


def _thermal_content(model: FrictionModel, *, bare: bool) -> package.Content:
    """Return the FMU of a thermal model before compilation."""
    about = describe_friction_fmu(model, "friction", "from their motion and temperature")
    components = tuple(map(thermal_component, model.laws, model.thermal))
    equations = discrete_equations(model, components)
    require_numbers(model)
    content = build_bare_content(model, about, *equations)
    if bare:
        return content
    return add_documentation(content, model, (*THERMAL_LINES, THERMAL_TORQUE), _THERMAL_NOTES)


_THERMAL_NOTES = (
    "Bounds are those of stops, F_c and F_s; they carry the Coulomb friction. Names without an "
    "index are those of one joint: joint[i].thermal_coulomb, temperature[i], rise[i].",
    "The reference results follow a motion within the trained speeds, with temperatures around "
    "the reference.",
)


export_bare = partial(export_fmu, no_documentation=True)
"""Write the same FMU as `export_fmu` without its documentation."""


def _add_documentation(
    bare: package.Content,
    model: FrictionModel,
    properties: Properties | None,
    audit: ModelAudit | None,
) -> package.Content:
    """Add the page, the picture and the reference results of a model, as the FMU runs it."""
    with ThreadPoolExecutor(max_workers=1) as pool:
        # Draw the picture while the compiler runs.
        module = pool.submit(wasm, package.translation_unit(bare)[1])
        picture = model_png(model)
        live = live_section(live_data(model, bare.table, module.result()))
        live += live_assets(fit_tables=True)
    audit = audit or _examine(model)
    certificates: Sequence[Certificate] = ()
    if audit is not None:
        certificates = audit.certificates
    page = ""
    if properties is not None:
        write_section = plugins.find("hesr.sheets", "properties")
        page = write_section(properties, sliding=model.sliding)
    html = to_html(model, bare.table, bare.about, live=live, properties=page, audit=audit)
    members = {
        "model.png": picture,
        "documentation/index.html": html.encode(),
        **bare.members,
        **reference_files(model, bare.about.identifier),
    }
    return replace(bare, members=members, origin=describe_origin(model, certificates))


def _examine(model: FrictionModel) -> ModelAudit | None:
    """Return the audit of a model, None if its torque has no audit; the page says why."""
    try:
        return ModelAudit.from_model(model, ranges(model, reference_motion(model)))
    except HesrError:
        return None


def describe_origin(
    model: FrictionModel, certificates: Sequence[Certificate] = ()
) -> dict[str, Any]:
    """Return the sources of a model, its errors and certificates, as JSON data."""
    joints: list[dict[str, Any]] = [{"joint": name} for name in model.joints]
    for j, entry in enumerate(joints):
        if model.training_rmse:
            entry["training_rmse"] = model.training_rmse[j]
        if model.left_out_rmse:
            entry["left_out_rmse"] = model.left_out_rmse[j]
        if certificates:
            entry["passivity"] = certificates[j].label
            entry["storage"] = certificates[j].storage
            entry["rests_on"] = list(certificates[j].rests_on)
    return {
        "law": model.law,
        "robot": model.robot,
        "hesr": __version__,
        "joints": joints,
        "provenance": model.provenance,
    }


def _component(
    model: FrictionModel,
    extra_outputs: tuple[Equation, ...] = (),
    *,
    band: bool = False,
    low_pass: float | None = None,
    no_events: bool = False,
) -> package.Content:
    require_numbers(model)
    if band:
        model.require_band()
    about = describe_friction_fmu(model, "friction", "from their motion")
    equations = friction_equations(
        _add_low_pass(model, low_pass), extra_outputs, band=band, events=not no_events
    )
    return build_bare_content(model, about, *equations)


def _add_low_pass(model: FrictionModel, low_pass: float | None) -> FrictionModel:
    if low_pass is None:
        return model
    if not 0.0 < low_pass < inf:
        raise ExportError(
            f"friction model '{model.law}': the cut-off of its low pass is {low_pass:g} Hz; it "
            "must be positive."
        )
    return model.behind_low_pass(low_pass)


def build_bare_content(
    model: FrictionModel, about: Description, interface: Interface, header: str
) -> package.Content:
    """Return the FMU of a model without pages, with the model itself."""
    return package.Content(
        table=interface,
        about=about,
        sources=package.equation_sources(header),
        members=embed_model(model),
        origin=describe_origin(model),
    )


_TITLES = {"friction": "Friction", "adaptive": "Adaptive friction"}


def describe_friction_fmu(model: FrictionModel, kind: str, text: str) -> Description:
    """Return the model description of a friction FMU of some kind."""
    return describe_fmu(
        model,
        name=f"{_TITLES[kind]} of {model.robot} by {model_title(model)}",
        identifier=f"{kind}_{model.law}",
        text=f"Joint friction torque of {len(model.joints)} joints {text}.",
        step_size=model.sample_time,
    )


def describe_fmu(
    model: FrictionModel, *, name: str, identifier: str, text: str, step_size: float
) -> Description:
    """Return the model description of an FMU, with the model's date and owner."""
    return Description(
        name=name,
        identifier=re.sub(r"\W", "_", identifier, flags=re.ASCII),
        text=" ".join([text, *statements(model.provenance, "guessed")]),
        created=fmu_date(model).strftime("%Y-%m-%dT%H:%M:%SZ"),
        step=step_size,
        owner=Owner.from_provenance(model.provenance),
    )


def fmu_date(model: FrictionModel) -> datetime:
    """Return the date in an FMU: SOURCE_DATE_EPOCH, that of the provenance, or of this release."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    created = model.provenance.get("created")
    date = datetime.fromisoformat(RELEASE_DATE)
    try:
        if epoch is not None:
            date = datetime.fromtimestamp(int(epoch), tz=UTC)
        elif created is not None:
            date = datetime.fromisoformat(str(created))
    except (ValueError, OverflowError, OSError) as error:
        observation = f"'created' is '{created}'"
        if epoch:
            observation = f"SOURCE_DATE_EPOCH is '{epoch}'"
        raise ExportError(f"{observation}; it must be a date.") from error
    if date.tzinfo is None:
        date = date.replace(tzinfo=UTC)
    date = date.astimezone(UTC)
    return min(max(date, _FIRST_DATE), _LAST_DATE)
