"""Any MJCF as an FMU of native C that carries MuJoCo's library: nothing to install in the host."""

import importlib.metadata
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco

from fmu_src.arm.signals import Signals, delays
from fmu_src.description import Description
from fmu_src.interface import Interface, Variable, literal
from fmu_src.package import Binary, Content, own_source
from hesr_model.errors import ExportError

_CREATED = "1980-01-01T00:00:00Z"


def arm(signals: Signals, *, name: str, source: bytes) -> Content:
    """Return the FMU of a model.

    Parameters
    ----------
    signals : the compiled model and what of it is seen.
    name : of the model.
    source : the MJCF, which the FMU carries to be read; it loads the compiled model.

    Raises
    ------
    ExportError
        If the installed MuJoCo has no library for this platform, or names are not names in FMI.
    """
    model = signals.model
    delay, longest = delays(model)
    state = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)
    noisy = [o for o in signals.outputs if o.noise is not None]
    table = Interface(
        variables=tuple(_variables(signals, delay)),
        own=2 + state,
        model_exchange=False,
        directional_derivatives=False,
    )
    with tempfile.TemporaryDirectory(prefix="hesr-") as folder:
        binary = Path(folder, "model.mjb")
        mujoco.mj_saveModel(model, str(binary), None)
        compiled = binary.read_bytes()
    return Content(
        table=table,
        about=Description(
            name=name,
            identifier="Arm",
            text=f"{name}, simulated by MuJoCo {mujoco.__version__}.",
            version=importlib.metadata.version("hesr"),
            created=_CREATED,
            step=signals.step,
            sources=(),
        ),
        sources={
            "mjcf.c": own_source("mjcf.c"),
            "signals.h": _signals_h(signals, table, state, longest, len(noisy)),
        },
        members={
            "resources/model.mjb": compiled,
            "resources/model.xml": source,
            **_licences(),
        },
        binary=_library(),
    )


def _variables(signals: Signals, delay: float) -> Iterator[Variable]:
    for one in signals.inputs:
        yield Variable(name=one.name, role="input", unit=one.unit, description="control")
    for output in signals.outputs:
        yield Variable(
            name=output.name, role="output", unit=output.unit, description="sum of sensors"
        )
    yield Variable(name="friction_scale", role="fixed", unit="1", start=1.0,
                   description="factor on the friction of the elements that are named for it")  # fmt: skip
    yield Variable(name="payload", role="fixed", unit="kg", description="mass of a payload")
    yield Variable(name="latency", role="fixed", unit="s", start=delay,
                   description="delay of those actuators that have one")  # fmt: skip
    for k, half in enumerate((signals.seed & 0xFFFFFFFF, signals.seed >> 32), start=1):
        yield Variable(name=f"noise_seed[{k}]", role="fixed", unit="1", start=float(half),
                       description=f"{'low' if k == 1 else 'high'} 32 bits of the noise's seed")  # fmt: skip
    for start in signals.starts:
        yield Variable(name=start.name, role="fixed", unit=start.unit, start=start.value,
                       description="position at the start")  # fmt: skip
    for output in signals.outputs:
        if output.noise is not None:
            stem, _, index = output.name.partition("[")
            yield Variable(name=f"{stem}_noise{'[' + index if index else ''}", role="fixed",
                           unit=output.unit, start=output.noise,
                           description=f"standard deviation of the noise of {output.name}")  # fmt: skip


def _signals_h(
    signals: Signals, table: Interface, state: int, longest: float, noisy: int
) -> str:
    at = table.references
    first_noise = len(table.variables) - noisy
    rows = {
        "drives": [
            f"{at[i.name]}, {control}" for i in signals.inputs for control in i.controls
        ],
        "reads": [
            f"{at[o.name]}, {address}, {literal(factor)}, {int(scaled)}"
            for o in signals.outputs
            for address, factor, scaled in o.reads
        ],
        "noises": [
            f"{at[o.name]}, {first_noise + k}, {o.stream}u"
            for k, o in enumerate(o for o in signals.outputs if o.noise is not None)
        ],
        "starts": [
            row
            for s in signals.starts
            for row in (
                f"{at[s.name]}, 0, {s.position}, -1, 1.0",
                *(() if s.activation is None else (
                    f"{at[s.name]}, 1, {s.activation}, {at[s.held] if s.held else -1}, "
                    f"{literal(s.gain)}",
                )),
            )
        ],
        "rubbing": [str(i) for i in signals.friction],
    }  # fmt: skip
    counts = {"drives": "DRIVES", "reads": "READS", "noises": "NOISY", "starts": "STARTS",
              "rubbing": "RUBBING"}  # fmt: skip
    types = {"drives": "Drive", "reads": "Read", "noises": "Noise", "starts": "Start",
             "rubbing": "int"}  # fmt: skip
    empty = {"Drive": "{0, 0}", "Read": "{0, 0, 0.0, 0}", "Noise": "{0, 0, 0u}",
             "Start": "{0, 0, 0, -1, 1.0}", "int": "0"}  # fmt: skip
    arrays = []
    for name, entries in rows.items():
        kind = types[name]
        shown = entries if kind == "int" else [f"{{{e}}}" for e in entries]
        arrays.append(
            f"static const {kind} {name}[] = {{{', '.join(shown) or empty[kind]}}};"
        )
    return _SIGNALS.format(
        counts=", ".join(f"{counts[n]} = {len(e)}" for n, e in rows.items()),
        arrays="\n".join(arrays),
        outputs=len(signals.outputs),
        first_output=at[signals.outputs[0].name],
        scale=at["friction_scale"],
        payload=at["payload"],
        latency=at["latency"],
        seed=at["noise_seed[1]"],
        body=-1 if signals.payload is None else signals.payload,
        state=state,
        longest=literal(longest * (1 + 1e-9)),
    )


_SIGNALS = """\
/* Generated: which parts of the model are the FMU's signals. */
#ifndef SIGNALS_H
#define SIGNALS_H

#define MODEL_FILE "model.mjb"
#define LONGEST_LATENCY {longest}

/* Places of variables, and sizes. */
enum {{ FIRST_OUTPUT = {first_output}, FRICTION_SCALE = {scale}, PAYLOAD = {payload} }};
enum {{ LATENCY = {latency}, NOISE_SEED = {seed}, ADAPTED = 3, OUTPUTS = {outputs} }};
enum {{ PAYLOAD_BODY = {body}, STATE_SIZE = {state}, {counts} }};

typedef struct {{
    int input, control;
}} Drive;

typedef struct {{
    int output, sensor; /* address in the sensor data */
    double factor;
    int scaled; /* whether the factor follows the friction scale */
}} Read;

typedef struct {{
    int output, sigma;
    unsigned stream;
}} Noise;

typedef struct {{
    int parameter, activation, index, held_output;
    double gain;
}} Start;

{arrays}

#endif
"""


def _library() -> Binary:
    """MuJoCo of the installed wheel, to compile against and to ship."""
    folder = Path(mujoco.__file__).parent
    found = sorted(folder.glob("libmujoco.so.*"))
    if not found:
        raise ExportError(
            "the installed MuJoCo has no library for linux64, the only platform of native arms."
        )
    return Binary(library=found[-1], include=folder / "include")


def _licences() -> dict[str, bytes]:
    """Licence and notices of MuJoCo, from its package."""
    files = importlib.metadata.files("mujoco") or ()
    wanted: Sequence[importlib.metadata.PackagePath] = [
        f for f in files if "licenses" in f.parts or f.name.upper().startswith("LICENSE")
    ]
    return {
        f"documentation/licenses/mujoco-{f.name}": Path(str(f.locate())).read_bytes()
        for f in wanted
    }
