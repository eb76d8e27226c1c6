"""Export of an MJCF as an FMU of native C with MuJoCo's library, for hosts without Python."""

import hashlib
import importlib.metadata
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from fmu_src.arm.library import library
from fmu_src.arm.losses import losses_header
from fmu_src.arm.signals import read_signals
from fmu_src.arm.table import (
    LATENCY,
    PAYLOAD,
    SCALE,
    SEED,
    ArmSignals,
    ArmStart,
    SignalTable,
    noise_name,
    variables,
)
from fmu_src.export.description import RELEASE_DATE, Description
from fmu_src.export.interface import Interface, literal
from fmu_src.export.package import Content, check_request, read_c_source, write_fmu
from fmu_src.export.toolchain import HOST
from fmu_src.pages.block_page import BlockPage, block_html
from fmu_src.run.reference_results import Stimuli, waves
from hesr_model.errors import ExportError
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Progress, silent

_STIMULUS_AMPLITUDE = 0.1  # amplitude of controls in the reference results
_COMPONENT_STATES = 4
_STATES_PER_LOSS = 2  # state variables of mjcf.c without MuJoCo's, and per loss
_SOURCES = (
    *("mjcf.c", "mjcf_losses.h", "mjcf_parameters.h", "beside.h", "guard.h"),
    *("mujoco_library.h", "noise.h", "resource.h"),
)
# Type, size constant and placeholder element of each table; C has no empty arrays.
_TABLES = {
    "drives": ("Drive", "DRIVES", "{0, 0}"),
    "reads": ("Read", "READS", "{0, 0, 0.0, 0}"),
    "noises": ("Noise", "NOISY", "{0, 0, 0u}"),
    "starts": ("Start", "STARTS", "{0, 0, 0, -1, 1.0}"),
    "rubbing": ("int", "RUBBING", "0"),
    "losses": ("Loss", "LOSSES", "{0, -1, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 1.0}"),
    "lost": ("Lost", "LOST", "{0, 0}"),
}


def to_h(signals: ArmSignals, interface: Interface, *, state: int, digest: str) -> str:
    """Return signals.h; `state` is the size of MuJoCo's integration state."""
    indices = interface.places
    rows = {
        name: list(map(_row, table_rows)) for name, table_rows in _rows(signals, indices).items()
    }
    arrays = [
        f"static const {kind} {name}[] = {{{', '.join(rows[name]) or empty}}};"
        for name, (kind, _, empty) in _TABLES.items()
    ]
    longest_latency = 0.0
    if signals.delay is not None:
        longest_latency = signals.delay.longest
    payload_body = -1
    if signals.payload is not None:
        payload_body = signals.payload
    return _SIGNALS.format(
        digest=digest,
        counts=", ".join(f"{_TABLES[name][1]} = {len(e)}" for name, e in rows.items()),
        arrays="\n".join(arrays),
        outputs=len(signals.outputs),
        first_output=indices[signals.outputs[0].name],
        scale=indices.get(SCALE, -1),
        payload=indices.get(PAYLOAD, -1),
        latency=indices.get(LATENCY, -1),
        seed=indices.get(f"{SEED}[1]", -1),
        body=payload_body,
        state=state,
        longest=literal(longest_latency),
    )


def _row(values: tuple[object, ...]) -> str:
    """Return a row of a table in C: a structure, or a single number."""
    texts = list(map(_number, values))
    if len(texts) == 1:
        return texts[0]
    return f"{{{', '.join(texts)}}}"


def _number(value: object) -> str:
    if isinstance(value, float):
        return literal(value)
    return str(value)


def _rows(signals: ArmSignals, indices: Mapping[str, int]) -> dict[str, list[tuple[object, ...]]]:
    """Return the rows of each of `_TABLES`."""
    rows: dict[str, list[tuple[object, ...]]] = {name: [] for name in _TABLES}
    for arm_input in signals.inputs:
        index = indices[arm_input.name]
        rows["drives"] += [(index, control) for control in arm_input.controls]
    for output in signals.outputs:
        index = indices[output.name]
        for address, factor, scaled in output.reads:
            rows["reads"].append((index, address, factor, int(scaled)))
        if output.noise is not None:
            rows["noises"].append((index, indices[noise_name(output)], f"{output.stream}u"))
        rows["lost"] += [(index, loss) for loss in output.losses]
    for start in signals.starts:
        rows["starts"] += _start_rows(start, indices[start.name])
    rows["rubbing"] += [(actuator,) for actuator in signals.friction]
    rows["losses"] += [astuple(loss) for loss in signals.losses]
    return rows


def _start_rows(start: ArmStart, index: int) -> Iterator[tuple[object, ...]]:
    """Yield what a start value sets: its joint, activations, and a second joint."""
    yield index, 0, start.position, -1, 1.0
    if start.activation is not None:
        for held_dof in start.held or (-1,):
            yield index, 1, start.activation, held_dof, start.gain
    if start.other is not None:
        yield index, 0, start.other, -1, 1.0


_SIGNALS = """\
/* Generated: the FMU's signals in the model. */
#ifndef SIGNALS_H
#define SIGNALS_H

/* The compiled model, SHA-256 {digest}. */
#define MODEL_FILE "model.mjb"
#define LONGEST_LATENCY {longest}

/* Indices of variables, -1 if absent, and sizes. */
enum {{ FIRST_OUTPUT = {first_output}, OUTPUTS = {outputs} }};
enum {{ FRICTION_SCALE = {scale}, PAYLOAD = {payload}, LATENCY = {latency}, NOISE_SEED = {seed} }};
enum {{ PAYLOAD_BODY = {body}, STATE_SIZE = {state} }};
enum {{ {counts} }};

typedef struct {{
    int input, control;
}} Drive;

/* A summand of an output. */
typedef struct {{
    int output, sensor; /* address in the sensor data */
    double factor;
    int scaled; /* whether the factor follows the friction scale */
}} Read;

typedef struct {{
    int output, sigma;
    unsigned stream;
}} Noise;

/* A position, or an activation that may balance the torques on a joint. */
typedef struct {{
    int parameter, activation, index, held_dof;
    double gain;
}} Start;

/* See losses.h; springs of the carrier are the load. */
typedef struct {{
    int dof, carrier;
    double constant, load, direct, speed, evolution, age, slip, longest;
}} Loss;

typedef struct {{ /* summand of an output */
    int output, loss;
}} Lost;

{arrays}

#endif
"""


def export_mjcf(
    model_path: Path,
    path: Path,
    *,
    table: Path | SignalTable | ArmSignals | None = None,
    platforms: Sequence[str] = HOST,
    progress: Progress = silent,
) -> Path:
    """Write an MJCF as an FMI 2.0 FMU for co-simulation, simulated by MuJoCo."""
    targets = check_request(path, platforms)
    signals = table if isinstance(table, ArmSignals) else read_signals(model_path, table)
    content = arm(
        signals,
        name=model_name(signals.model, model_path),
        source=model_path.read_bytes(),
        platforms=[target.folder for target in targets],
    )
    return write_fmu(content, path, platforms=platforms, progress=progress)


def model_name(model: Any, path: Path) -> str:
    """Return the name of the model in an MJCF, by default that of its file."""
    name = bytes(model.names).partition(b"\0")[0].decode()
    if name in ("", "MuJoCo Model"):
        return path.stem
    return name


def arm(
    signals: ArmSignals, *, name: str, source: bytes, platforms: Sequence[str] = HOST
) -> Content:
    """Return the FMU of a model for folders of binaries; `source` is its MJCF, as documentation.

    Raises ExportError if MuJoCo for a platform is unavailable or the model needs plugins.
    """
    model = signals.model
    if model.nplugin:
        raise ExportError(f"model '{name}': plugins of MuJoCo are not supported in an FMU.")
    state = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)
    interface = Interface(
        variables=variables(signals),
        own=_COMPONENT_STATES + _STATES_PER_LOSS * len(signals.losses) + state,
        model_exchange=False,
        directional_derivatives=False,
    )
    compiled = _binary(model)
    digest = hashlib.sha256(compiled).hexdigest()
    about = description(signals, name)
    sources = {name: read_c_source(name) for name in _SOURCES}
    sources["signals.h"] = to_h(signals, interface, state=state, digest=digest)
    sources["losses.h"] = losses_header()
    return Content(
        table=interface,
        about=about,
        sources=sources,
        members={
            "resources/model.mjb": compiled,
            "resources/model.xml": source,
            **arm_page(signals, interface, about),
            **licences("mujoco"),
        },
        libraries={platform: library(platform) for platform in platforms},
        stimuli=arm_stimuli(signals),
    )


def arm_page(signals: ArmSignals, interface: Interface, about: Description) -> dict[str, bytes]:
    """Return the page of the FMU of a model as a member of its archive."""
    page = BlockPage(equations=tuple(_signal_lines(signals)), notes=_NOTES)
    return {"documentation/index.html": block_html(page, interface, about).encode()}


def arm_stimuli(signals: ArmSignals) -> Stimuli:
    """Return small controls for reference results."""
    return Stimuli(
        step=signals.step, inputs=waves({i.name: _STIMULUS_AMPLITUDE for i in signals.inputs})
    )


_NOTES = (
    "Names on the right are those of sensors and actuators in resources/model.xml, which MuJoCo "
    "steps. A measured output has normal noise with the standard deviation of its parameter. "
    "A true one has none.",
    "Start values are positions at rest. Where the table of signals says so, the integral of the "
    "servo then balances all torques, so that the arm does not sag.",
    "In a loop the arm begins where the desired motion begins: q0 = trajectory.q(0).",
)


def _signal_lines(signals: ArmSignals) -> Iterator[str]:
    """Yield the actuators that inputs command, and the sums of sensors that are outputs."""
    names = _names_of_controls(signals.model)
    for command in signals.inputs:
        yield f"{', '.join(names[control] for control in command.controls)} = {command.name}"
    for output in signals.outputs:
        terms = [_sensor_term(signals.model, *read) for read in output.reads]
        terms += [f"+ dry friction of loss {k + 1}" for k in output.losses]
        if output.noise is not None:
            terms.append(f"+ {noise_name(output)} normal noise")
        yield f"{output.name} = {' '.join(terms).removeprefix('+ ')}"


def _names_of_controls(model: Any) -> list[str]:
    """Return the name of the actuator of each control; an actuator may have several or none."""
    names = []
    for actuator in range(model.nactuator):
        name = model.actuator(actuator).name or f"actuator {actuator}"
        names += [name] * int(model.actuator_ctrlnum[actuator])
    return names


def _sensor_term(model: Any, address: int, factor: float, scaled: bool) -> str:
    """Return a number of the sensors as a signed term of a sum."""
    sensor = int(np.searchsorted(model.sensor_adr, address, side="right")) - 1
    name = model.sensor(sensor).name or f"sensor {sensor}"
    if model.sensor_dim[sensor] > 1:
        name += f"[{address - model.sensor_adr[sensor] + 1}]"
    if scaled:
        name = f"{SCALE} {name}"
    if abs(factor) != 1:
        name = f"{abs(factor):g} {name}"
    sign = "-" if factor < 0 else "+"
    return f"{sign} {name}"


def description(signals: ArmSignals, name: str) -> Description:
    """Return the description of an FMU of a model, without variables."""
    return Description(
        name=name,
        identifier=re.sub(r"^(?=\d)", "_", re.sub(r"\W", "_", name, flags=re.ASCII)),
        text=f"{name}, simulated by MuJoCo {mujoco.__version__}.",
        created=RELEASE_DATE,
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
