"""Picture of a friction FMU, which tools show as its icon, without text that fonts could lack."""

import io
from collections.abc import Sequence
from dataclasses import replace
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fmu_src.friction.reference import reference_motion
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.support.arrays import Array
from hesr_model.units import unit_of_joints

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL.Image import Image

Loop = tuple[Array, Array]  # velocity and torque over one period, each (K,)

_SIZE, _DPI = (4.0, 3.0), 100  # 400 by 300 pixels
_ROW = 3  # maximum panels per row
_FREQUENCY = 0.25  # [Hz]
_PERIODS = 3  # the last one is drawn, after the states have settled
_PERIOD = 400  # rows
_SHARES = {1 / 3: "#9ecae1", 2 / 3: "#4a98c9", 1.0: "#0b559f"}
"""Velocity amplitudes, as fractions of the reference motion, and their colours."""
_GREY = "#777777"
_LARGEST = 1e9  # [N.m]; larger values count as infinite
_MOST_COLOURS = 256
_SHADE = 32  # steps between shades of a colour, of 256


def model_png(model: FrictionModel) -> bytes:
    """Return model.png: torque over velocity of each joint, as loops at three amplitudes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    loops = _loops(model)
    columns = min(len(loops), _ROW)
    rows = ceil(len(loops) / columns)
    figure = Figure(figsize=_SIZE, dpi=_DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for joint, (panel, of_joint) in enumerate(zip(panels, loops, strict=False), start=1):
        _draw(panel, of_joint, joint)
    for panel in panels[len(loops) :]:
        panel.set_visible(False)
    figure.supxlabel(f"dq [{unit_of_joints('rad/s', model.sliding)}]", fontsize=9, color=_GREY)
    figure.supylabel(f"tau [{unit_of_joints('N.m', model.sliding)}]", fontsize=9, color=_GREY)
    figure.canvas.draw()
    # Fewer shades halve the size without a visible difference.
    drawn = canvas.buffer_rgba()  # type: ignore[no-untyped-call] # Matplotlib has not typed it
    pixels = np.asarray(drawn)[:, :, :3] // _SHADE * _SHADE + (_SHADE - 1)
    picture = io.BytesIO()
    _indexed(pixels).save(picture, format="PNG", optimize=True)
    return picture.getvalue()


def _indexed(pixels: NDArray[np.uint8]) -> "Image":
    """Return the picture (rows, columns, 3) with a palette, if it has few enough colours."""
    from PIL import Image

    colours, places = np.unique(pixels.reshape(-1, 3), axis=0, return_inverse=True)
    if len(colours) > _MOST_COLOURS:
        return Image.fromarray(pixels)
    picture = Image.fromarray(places.reshape(pixels.shape[:2]).astype(np.uint8)).convert("P")
    picture.putpalette(colours.tobytes())
    return picture


def _loops(model: FrictionModel) -> list[list[Loop]]:
    motion = reference_motion(
        model, frequency=_FREQUENCY, periods=_PERIODS, rows=_PERIODS * _PERIOD
    )
    found = []
    for law, (dq, q, load) in zip(model.laws, motion.by_joint(), strict=True):
        # The exact discretisation is stable at any step.
        exact = replace(law, discretisation="exact")
        middle = 0.5 * (q.min() + q.max())
        of_joint = []
        with np.errstate(all="ignore"):  # non-finite results are left out
            for share in _SHARES:
                v, place = share * dq, middle + share * (q - middle)
                tau = predict(exact, t=motion.t, dq=v, q=place, tau_load=load)
                of_joint.append((v[-_PERIOD:], tau[-_PERIOD:]))
        found.append(of_joint)
    return found


def _draw(panel: "Axes", loops: Sequence[Loop], joint: int) -> None:
    panel.axhline(0.0, color=_GREY, linewidth=0.6)
    panel.axvline(0.0, color=_GREY, linewidth=0.6)
    for (dq, tau), colour in zip(loops, _SHARES.values(), strict=True):
        around = np.flatnonzero(np.abs(tau) < _LARGEST)
        around = np.append(around, around[:1])
        panel.plot(dq[around], tau[around], color=colour, linewidth=1.6)
    panel.text(0.05, 0.95, str(joint), transform=panel.transAxes, va="top", weight="bold")
    panel.locator_params(nbins=3)
    panel.tick_params(labelsize=7, length=2, color=_GREY, labelcolor=_GREY)
    panel.spines[:].set_visible(False)
