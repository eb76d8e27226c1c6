"""Trajectory FMU: desired motion, now and at a preview time, selected by parameters."""

import numpy as np

from fmu_src.blocks.table import content, places, scalar, vector
from fmu_src.export.interface import Enumeration, Interface, Variable
from fmu_src.export.package import Content, own_source
from fmu_src.run.reference_results import ROWS
from hesr_model.errors import ExportError
from hesr_model.motions.trajectories import Fourier, Sine, Sweep, Trajectory

HARMONICS = 10
"""Maximum number of harmonics of a Fourier motion."""

KIND = Enumeration(
    name="Motion",
    items=(
        ("fourier", "dq = sum_k a_k cos(k w t) + b_k sin(k w t), w = 2 pi / period"),
        ("sine", "dq = amplitude sin(2 pi first t)"),
        ("sweep", "dq = (amplitude + swing sin(2 pi t / swing_period + swing_phase)) sin(phi), the "
         "frequency rising from first to last in a time of length, after which the joint rests; "
         "without swing a chirp"),
    ),
)  # fmt: skip

_PARAMETERS = (
    ("offset", "rad", "mean position, or position at the start of a sweep"),
    ("amplitude", "rad/s", "peak velocity of a sine or sweep"),
    ("swing", "rad/s", "variation of the peak velocity of a sweep"),
    ("swing_phase", "rad", "of the swing"),
)
_SCALARS = (
    ("preview", "s", "how far ahead the outputs _ahead are", 0.0),
    ("rest_time", "s", "at rest before the motion begins", 0.0),
    ("period", "s", "of a Fourier motion", 10.0),
    ("swing_period", "s", "of the swing", 10.0),
    ("first", "1/s", "frequency of a sine, or at the start of a sweep", 0.25),
    ("last", "1/s", "frequency at the end of a sweep", 1.0),
    ("length", "s", "of a sweep", 10.0),
)

_FROM_REST = (("a", 1, 0.5), ("a", 3, -0.5), ("b", 1, 0.4), ("b", 2, -0.2))
"""Coefficients of each joint in the reference results [rad/s]."""


def trajectory(joints: int, *, step: float = 0.005) -> Content:
    """Return the Trajectory FMU for a number of joints with preferred step `step` [s]."""
    zeros = np.zeros(joints)
    kind = Variable(
        name="kind", role="fixed", description="kind of the motion", enumeration=KIND, start=2.0
    )
    scalars = [scalar(name, "fixed", unit, text, start) for name, unit, text, start in _SCALARS]
    vectors = [v for n, unit, text in _PARAMETERS for v in vector(n, "fixed", unit, text, zeros)]
    series = [
        scalar(f"{name}[{i},{k}]", "fixed", "rad/s", f"harmonic {k} of joint {i}", 0.0)
        for name in ("a", "b")
        for i in range(1, joints + 1)
        for k in range(1, HARMONICS + 1)
    ]
    made_of = [v.name for v in (kind, *scalars, *vectors, *series)]
    outputs = [
        variable
        for tail, text in (("", "desired {}"), ("_ahead", "desired {} a preview time ahead"))
        for name, unit, what in (
            ("q", "rad", "position"),
            ("dq", "rad/s", "velocity"),
            ("ddq", "rad/s2", "acceleration"),
        )
        for variable in vector(name + tail, "output", unit, text.format(what), zeros, made_of)
    ]
    table = Interface(
        variables=(*outputs, kind, *scalars, *vectors, *series),
        model_exchange=False,
        directional_derivatives=False,
    )
    first = {"POSITION": "q", "VELOCITY": "dq", "ACCELERATION": "ddq", "POSITION_AHEAD": "q_ahead",
             "VELOCITY_AHEAD": "dq_ahead", "ACCELERATION_AHEAD": "ddq_ahead",
             **{name.upper(): name for name in ("kind", "a", "b")},
             **{name.upper(): name for name, *_ in (*_SCALARS, *_PARAMETERS)}}  # fmt: skip
    kinds = {name.upper(): i for i, (name, _) in enumerate(KIND.items, start=1)}
    header = places(table, "MOTION_H", first, JOINTS=joints, HARMONICS=HARMONICS, **kinds)
    return content(
        table,
        name="Trajectory",
        text="Desired motion of all joints: Fourier series, sine, sweep or chirp.",
        sources={"trajectory.c": own_source("trajectory.c"), "motion.h": header},
        step=step,
        example={
            "kind": 1.0,
            "period": ROWS * step,
            "preview": 2.0 * step,
            **{
                f"{name}[{i},{k}]": value
                for i in range(1, joints + 1)
                for name, k, value in _FROM_REST
            },
        },
    )


def start_values(motion: Trajectory) -> dict[str, float | str | tuple[float, ...]]:
    """Return the parameters of the Trajectory FMU for a motion; ExportError if unsupported."""
    match motion:
        case Fourier():
            series = _series(motion)
            offset = tuple(motion.offset)
            return {"kind": "fourier", "period": motion.period, "offset": offset, **series}
        case Sine():
            return {
                "kind": "sine",
                "first": motion.frequency,
                "offset": tuple(motion.offset),
                "amplitude": tuple(motion.amplitude),
            }
        case Sweep():
            return {
                "kind": "sweep",
                "first": motion.first,
                "last": motion.last,
                "length": motion.length,
                "swing_period": motion.swing_period,
                "offset": tuple(motion.start),
                "amplitude": tuple(motion.amplitude),
                "swing": tuple(motion.swing),
                "swing_phase": tuple(motion.phase),
            }
    raise ExportError(f"a motion of kind '{type(motion).__name__}' cannot be made by the FMU.")


def _series(motion: Fourier) -> dict[str, float]:
    harmonics = motion.a.shape[1]
    if harmonics > HARMONICS:
        raise ExportError(
            f"a Fourier motion of {harmonics} harmonics cannot be made by the FMU, which has "
            f"{HARMONICS}."
        )
    return {
        f"{name}[{i + 1},{k + 1}]": float(array[i, k]) if k < harmonics else 0.0
        for name, array in (("a", motion.a), ("b", motion.b))
        for i in range(len(array))
        for k in range(HARMONICS)
    }
