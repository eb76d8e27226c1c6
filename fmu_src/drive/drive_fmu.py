"""Export of a friction model and its motors as an FMU: torque in, speed and angle out."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fmu_src.drive.drive_component import SUBSTEP, Motors, equations_to_c, interface, motors
from fmu_src.export.package import Content, Version, check_request, own_source, write_fmu
from fmu_src.export.terminals import Terminal
from fmu_src.friction.embedded_model import embedding
from fmu_src.friction.friction_fmu import description_of
from fmu_src.friction.validity import require_exportable
from fmu_src.pages.drive_page import to_html
from fmu_src.run.reference_results import ROWS, Stimuli, waves
from hesr_model.friction.model import FrictionModel
from hesr_model.support.progress import Progress, silent

FLANGE = Terminal(
    name="flange",
    kind="org.modelica.Modelica.Mechanics.Rotational.Interfaces.Flange_b",
    description="towards the link: its angle and speed in, the torque on it out",
    members={
        "phi": ("q_link", "signal"),
        "w": ("dq_link", "signal"),
        "tau": ("tau_link", "outflow"),
    },
)
"""Terminal of each joint, on the joint side of the gear."""

_UNKNOWN = 10.0  # default friction torque [N.m]


def export_drive(
    model: FrictionModel,
    path: Path,
    *,
    inertia: Sequence[float],
    stiffness: Sequence[float] | None = None,
    damping: Sequence[float] | None = None,
    ratio: Sequence[float] | None = None,
    platforms: Sequence[str] = ("linux64",),
    progress: Progress = silent,
    fmi: Version = 2,
    bare: bool = False,
) -> Path:
    """Write a friction model with the motors of its joints as an FMU for co-simulation.

    The model is in joint coordinates; stiffness and damping are those of the flexspline. Units are
    kg.m2, N.m/rad, N.m.s/rad and motor turns per joint turn, for prismatic joints kg, N/m and so
    on. By default gears are rigid, with ratio 1. The same arguments give the same bytes; dates are
    those of `friction_fmu.export_fmu`. `bare` omits the documentation.
    """
    check_request(path, platforms)
    require_exportable(model, "a drive")
    own = motors(
        len(model.laws), inertia=inertia, stiffness=stiffness, damping=damping, ratio=ratio
    )
    whole = content(model, own, bare=bare)
    return write_fmu(whole, path, platforms=platforms, progress=progress, fmi=fmi)


def content(model: FrictionModel, own: Motors, *, bare: bool = False) -> Content:
    """Return the FMU of a drive before compilation."""
    table = interface(model, own)
    about = description_of(
        model,
        name=f"Drive of {model.robot} with {model.law}",
        identifier=f"drive_{model.law}",
        text=f"Motors of {len(model.joints)} joints under friction: torque in, speed and angle "
        "out.",
        step=SUBSTEP,
    )
    names = ("balance.h", "coupling.h", "drive.c", "law_math.h", "root.h")
    sources = {name: own_source(name) for name in names}
    members = {}
    if not bare:
        page = to_html(model, table, about).encode()
        members = {"documentation/index.html": page, **embedding(model)}
    return Content(
        table=table,
        about=about,
        sources=sources | {"equations.h": equations_to_c(model, table)},
        members=members,
        stimuli=_stimuli(model, own),
        terminals=(FLANGE,),
    )


def _stimuli(model: FrictionModel, own: Motors) -> Stimuli:
    """Return motor torques that exceed the friction, and the middle of the trained loads."""
    trained = model.trained or (None,) * len(model.joints)
    sizes, loads = {}, {}
    for i, (seen, ratio) in enumerate(zip(trained, own.ratio, strict=True), start=1):
        friction = max(map(abs, seen.tau)) if seen else _UNKNOWN
        sizes[f"tau_motor[{i}]"] = float(f"{3.0 * (friction or _UNKNOWN) / abs(ratio):.2g}")
        load = sum(seen.tau_load) / 2.0 if seen else 0.0
        loads[f"tau_load[{i}]"] = np.full(ROWS + 1, float(f"{load:.3g}"))
    return Stimuli(step=SUBSTEP, inputs={**waves(sizes), **loads})
