"""Trajectory FMU: desired motion, now and at a preview time, selected by parameters."""

from collections.abc import Iterable, Iterator

import numpy as np

from fmu_src.blocks.block import content, places, vector
from fmu_src.export.interface import Enumeration, Interface, Variable
from fmu_src.export.package import Content, read_c_source
from fmu_src.pages.block_page import BlockPage
from fmu_src.run.reference_results import ROWS
from hesr_model.errors import ExportError
from hesr_model.motions.trajectories import Fourier, Sine, Sweep, Trajectory

HARMONICS = 10  # maximum number of harmonics of a Fourier motion

_SWEEP = (
    "dq = (amplitude + swing sin(2 pi t / swing_period + swing_phase)) sin(phi), the frequency "
    "rising from first to last in a time of length, after which the joint rests; without swing a "
    "chirp"
)
KIND = Enumeration(
    name="Motion",
    items=(
        ("fourier", "dq = sum_k a_k cos(k w t) + b_k sin(k w t), w = 2 pi / period"),
        ("sine", "dq = amplitude sin(2 pi first t)"),
        ("sweep", _SWEEP),
    ),
)
_MOTION = {"q": ("rad", "position"), "dq": ("rad/s", "velocity"), "ddq": ("rad/s2", "acceleration")}
_PARAMETERS = (
    ("offset", "rad", "mean position, or position at the start of a sweep"),
    ("amplitude", "rad/s", "peak velocity of a sine or sweep"),
    ("swing", "rad/s", "variation of the peak velocity of a sweep"),
    ("swing_phase", "rad", "phase of the swing"),
)
_SCALARS = (
    ("preview", "s", "lead of the outputs named _ahead", 0.0),
    ("rest_time", "s", "time at rest before the motion begins", 0.0),
    ("period", "s", "period of a Fourier motion", 10.0),
    ("swing_period", "s", "period of the swing", 10.0),
    ("first", "1/s", "frequency of a sine, or at the start of a sweep", 0.25),
    ("last", "1/s", "frequency at the end of a sweep", 1.0),
    ("length", "s", "duration of a sweep", 10.0),
)

_FROM_REST = (("a", 1, 0.5), ("a", 3, -0.5), ("b", 1, 0.4), ("b", 2, -0.2))
"""Coefficients of each joint in the reference results [rad/s]."""

_PAGE = BlockPage(
    equations=(
        "s = max(time - rest_time, 0)",
        "fourier   w = 2 pi / period, sums over k = 1 to 10",
        "          q = offset + sum (a[k] sin(k w s) - b[k] cos(k w s)) / (k w)",
        "          dq = sum a[k] cos(k w s) + b[k] sin(k w s)",
        "sine      w = 2 pi first",
        "          q = offset - amplitude / w cos(w s)",
        "          dq = amplitude sin(w s)",
        "sweep     phi = 2 pi (first s + (last - first) s^2 / (2 length)), s at most length",
        "          dq = (amplitude + swing sin(2 pi s / swing_period + swing_phase)) sin(phi)",
        "          q = offset + integral of dq",
        "q_ahead, dq_ahead, ddq_ahead (time) = q, dq, ddq (time + preview)",
    ),
    notes=(
        "During the rest time, and after a sweep, dq and ddq are 0 and q is that of the nearest "
        "instant of the motion. The arm must begin there: start it at the q of this FMU after its "
        "initialisation, q(0). Only a sweep begins at its offset.",
        "A sweep without swing is a chirp.",
        "For a controller that inverts the servo of the arm, preview = latency of the servo + half "
        "a step of the loop. For every other controller preview = 0. A rest_time above the preview "
        "makes the first command one of rest.",
        "fourier uses period, offset, a and b; sine uses first, offset and amplitude; sweep uses "
        "first, last, length, offset, amplitude, swing, swing_period and swing_phase.",
    ),
    refusals=("period, swing_period, first, last and length must be positive.",),
)


def trajectory(joints: int, *, step: float = 0.005) -> Content:
    """Return the Trajectory FMU for a number of joints with preferred step `step` [s]."""
    parameters = list(_parameters(joints))
    interface = Interface(
        variables=(*_outputs(joints, parameters), *parameters),
        model_exchange=False,
        directional_derivatives=False,
    )
    kinds = {name.upper(): i for i, (name, _) in enumerate(KIND.items, start=1)}
    header = places(
        interface, "MOTION_H", _first_variables(), JOINTS=joints, HARMONICS=HARMONICS, **kinds
    )
    example = {"kind": 1.0, "period": ROWS * step, "preview": 2.0 * step}
    for i in range(1, joints + 1):
        for name, k, value in _FROM_REST:
            example[f"{name}[{i},{k}]"] = value
    return content(
        interface,
        name="Trajectory",
        text="Desired motion of all joints: Fourier series, sine or sweep.",
        sources={"trajectory.c": read_c_source("trajectory.c"), "motion.h": header},
        step=step,
        page=_PAGE,
        example=example,
    )


def _parameters(joints: int) -> Iterator[Variable]:
    """Yield the parameters: kind, scalars, vectors over the joints, and coefficients of series."""
    yield Variable("kind", "fixed", "kind of the motion", enumeration=KIND, start=2.0)
    for name, unit, text, start in _SCALARS:
        yield Variable(name, "fixed", text, unit=unit, start=start)
    zeros = np.zeros(joints)
    for name, unit, text in _PARAMETERS:
        yield from vector(name, "fixed", unit, text, zeros)
    for name in ("a", "b"):
        for i in range(1, joints + 1):
            for k in range(1, HARMONICS + 1):
                text = f"harmonic {k} of joint {i}"
                yield Variable(f"{name}[{i},{k}]", "fixed", text, unit="rad/s")


def _outputs(joints: int, parameters: Iterable[Variable]) -> Iterator[Variable]:
    """Yield the desired motion, then that a preview time ahead; both depend on all parameters."""
    names = [variable.name for variable in parameters]
    zeros = np.zeros(joints)
    for name, (unit, quantity) in _MOTION.items():
        yield from vector(name, "output", unit, f"desired {quantity}", zeros, names)
    for name, (unit, quantity) in _MOTION.items():
        text = f"desired {quantity} a preview time ahead"
        yield from vector(f"{name}_ahead", "output", unit, text, zeros, names)


def _first_variables() -> dict[str, str]:
    """Return the first variable of each kind, by its name in C."""
    first = {quantity.upper(): name for name, (_, quantity) in _MOTION.items()}
    first |= {f"{constant}_AHEAD": f"{name}_ahead" for constant, name in first.items()}
    parameters = ["kind", "a", "b", *(name for name, *_ in (*_SCALARS, *_PARAMETERS))]
    return first | {name.upper(): name for name in parameters}


def start_values(motion: Trajectory) -> dict[str, float | str | tuple[float, ...]]:
    """Return the parameters of the Trajectory FMU for a motion; ExportError if unsupported."""
    parameters: dict[str, float | str | tuple[float, ...]]
    match motion:
        case Fourier():
            parameters = {"kind": "fourier", "period": motion.period, **_series(motion)}
            vectors = {"offset": motion.offset}
        case Sine():
            parameters = {"kind": "sine", "first": motion.frequency}
            vectors = {"offset": motion.offset, "amplitude": motion.amplitude}
        case Sweep():
            scalars = ("first", "last", "length", "swing_period")
            parameters = {"kind": "sweep", **{name: getattr(motion, name) for name in scalars}}
            vectors = {"offset": motion.start, "swing_phase": motion.swing_phase}
            vectors |= {"amplitude": motion.amplitude, "swing": motion.swing}
        case _:
            raise ExportError(
                f"a motion of kind '{type(motion).__name__}' cannot be made by the FMU."
            )
    return parameters | {name: tuple(values) for name, values in vectors.items()}


def _series(motion: Fourier) -> dict[str, float]:
    harmonics = motion.a.shape[1]
    if harmonics > HARMONICS:
        raise ExportError(
            f"a Fourier motion of {harmonics} harmonics cannot be made by the FMU, which has "
            f"{HARMONICS}."
        )
    parameters: dict[str, float] = {}
    for name, array in (("a", motion.a), ("b", motion.b)):
        # Harmonics that the motion lacks are zero.
        coefficients = np.zeros((len(array), HARMONICS))
        coefficients[:, :harmonics] = array
        for i, row in enumerate(coefficients.tolist(), start=1):
            parameters |= {f"{name}[{i},{k}]": value for k, value in enumerate(row, start=1)}
    return parameters
