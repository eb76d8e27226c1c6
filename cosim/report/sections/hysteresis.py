"""The hysteresis state of the paper's law (Fig. 2)."""

from dataclasses import replace

import numpy as np

from cosim.report.figures.plots import Sheet, sheets
from cosim.report.markup import Pictures, Section, joined, paragraph
from cosim.report.results import Results
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.registry import papers_law
from hesr_model.support.arrays import Array

_FREQUENCY = 0.25  # [Hz], of the paper's sine
_ROWS = 801  # of a period
_FACTORS = (0.25, 1.0, 4.0)
_SPEED = 1.2  # [rad/s] where no speed was trained


def section(results: Results, pictures: Pictures) -> Section | None:
    """Draw what alpha and beta do, at the values that were fitted to the first joint."""
    from cosim.report.figures.chart import Line
    from cosim.report.figures.style import strokes

    model = results.models.get(papers_law())
    if model is None or not {"alpha", "beta"} <= set(model.laws[0].values):
        return None
    first = model.laws[0]
    alpha, beta = first.values["alpha"], first.values["beta"]
    speed = model.trained[0].speed if model.trained else _SPEED
    three = list(strokes([f"{f:g}" for f in _FACTORS]).values())
    near = np.linspace(-4.0 / beta, 4.0 / beta, 201)
    slopes = tuple(
        Line(name=_times(f), x=1e3 * near, y=np.tanh(f * beta * near), stroke=stroke)
        for f, stroke in zip(_FACTORS, three, strict=True)
    )
    widths = tuple(
        Line(name=_times(f), x=dq, y=h, stroke=stroke)
        for f, stroke in zip(_FACTORS, three, strict=True)
        for dq, h in [_loop(replace(first, values={**first.values, "alpha": f * alpha}), speed)]
    )
    colours = strokes(list(results.joints))
    fitted = tuple(
        Line(name=short, x=dq, y=h, stroke=colours[short])
        for short, law in zip(results.joints, model.laws, strict=True)
        for dq, h in [_loop(law, speed)]
    )
    picture = sheets(
        (
            Sheet(
                title="(a) β: slope at rest",
                x=f"dq [{results.unit('mrad/s', 0)}]",
                y="tanh(β dq)",
                lines=slopes,
            ),
            Sheet(
                title="(b) α: width of the loop",
                x=f"dq [{results.unit('rad/s', 0)}]",
                y="h",
                lines=widths,
            ),
            Sheet(title="(c) as fitted", x=f"dq [{results.unit('rad/s')}]", y="h", lines=fitted),
        )
    )
    values = "; ".join(
        f"{short} ({law.values['alpha']:.4g}, {law.values['beta']:.4g})"
        for short, law in zip(results.joints, model.laws, strict=True)
    )
    return Section(
        key="hysteresis",
        title="Hysteresis state",
        html=joined(
            paragraph(
                "The paper's law sees, beside the velocity, a state h that follows the direction "
                "of motion with a delay (its eq. 9): dh/dt = α (tanh(β dq) − h). Fitted (α [1/s], "
                f"β [{results.unit('s/rad')}]): {values}."
            ),
            pictures.figure(
                "hysteresis",
                picture,
                f"The state (Fig. 2 of the paper) over a sine of {_FREQUENCY:g} Hz. (a) β sets how "
                "steeply the direction turns at rest, at a quarter of the value of J1, the value, "
                "and four times it; (b) α sets how long the state remembers, and so how wide its "
                "loop is; (c) the loops as they were fitted. The delay is one of time: at rest the "
                "state forgets.",
                alt="Three panels: tanh of beta times velocity at three slopes; loops of h over "
                "velocity that are wider the smaller alpha is; the fitted loop of each joint.",
            ),
        ),
    )


def _times(factor: float) -> str:
    return {0.25: "a quarter", 1.0: "as fitted", 4.0: "four times"}[factor]


def _loop(law: FrictionLaw, speed: float) -> tuple[Array, Array]:
    """Return velocity and state over one settled period of a sine."""
    relaxation = next(r for r in law.form.relaxations if r.name == "h")
    only = replace(law, form=replace(law.form, output=relaxation.state), discretisation="exact")
    t = np.linspace(0.0, 2.0 / _FREQUENCY, 2 * _ROWS - 1)
    dq = speed * np.sin(2.0 * np.pi * _FREQUENCY * t)
    return dq[-_ROWS:], predict(only, t=t, dq=dq)[-_ROWS:]
