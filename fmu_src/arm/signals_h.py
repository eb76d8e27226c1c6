"""The signals of a model as C tables."""

from collections.abc import Mapping
from dataclasses import astuple

from fmu_src.arm.parts import LATENCY, PAYLOAD, SCALE, SEED, ArmSignals, noise_name
from fmu_src.export.interface import Interface, literal

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


def to_h(signals: ArmSignals, table: Interface, *, state: int, digest: str) -> str:
    """Return signals.h; `state` is the size of MuJoCo's integration state."""
    at = table.places
    rows = {name: list(map(_row, found)) for name, found in _rows(signals, at).items()}
    arrays = [
        f"static const {kind} {name}[] = {{{', '.join(rows[name]) or empty}}};"
        for name, (kind, _, empty) in _TABLES.items()
    ]
    delay = signals.delay
    return _SIGNALS.format(
        digest=digest,
        counts=", ".join(f"{_TABLES[name][1]} = {len(e)}" for name, e in rows.items()),
        arrays="\n".join(arrays),
        outputs=len(signals.outputs),
        first_output=at[signals.outputs[0].name],
        scale=at.get(SCALE, -1),
        payload=at.get(PAYLOAD, -1),
        latency=at.get(LATENCY, -1),
        seed=at.get(f"{SEED}[1]", -1),
        body=-1 if signals.payload is None else signals.payload,
        state=state,
        longest=literal(delay.longest if delay else 0.0),
    )


def _row(values: tuple[object, ...]) -> str:
    texts = [literal(v) if isinstance(v, float) else str(v) for v in values]
    return f"{{{', '.join(texts)}}}" if len(texts) > 1 else texts[0]


def _rows(signals: ArmSignals, at: Mapping[str, int]) -> dict[str, list[tuple[object, ...]]]:
    outputs = signals.outputs
    noisy = [o for o in outputs if o.noise is not None]
    starts: list[tuple[object, ...]] = []
    for start in signals.starts:
        place = at[start.name]
        starts.append((place, 0, start.position, -1, 1.0))
        if start.activation is not None:
            starts += [(place, 1, start.activation, h, start.gain) for h in start.held or (-1,)]
        if start.other is not None:
            starts.append((place, 0, start.other, -1, 1.0))
    return {
        "drives": [(at[one.name], c) for one in signals.inputs for c in one.controls],
        "reads": [(at[o.name], where, k, int(s)) for o in outputs for where, k, s in o.reads],
        "noises": [(at[o.name], at[noise_name(o)], f"{o.stream}u") for o in noisy],
        "starts": starts,
        "rubbing": [(actuator,) for actuator in signals.friction],
        "losses": [astuple(loss) for loss in signals.losses],
        "lost": [(at[o.name], place) for o in outputs for place in o.losses],
    }


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

/* See mjcf_losses.h; springs of the carrier are the load. */
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
