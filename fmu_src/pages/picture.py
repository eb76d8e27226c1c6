"""Picture of a friction FMU, which tools show as its icon, without text that fonts could lack."""

import io
from collections.abc import Sequence
from dataclasses import replace
from math import ceil, floor, log10
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fmu_src.friction.reference import reference_motion
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.support.arrays import Array
from hesr_model.units import unit_of_joints

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

Loop = tuple[Array, Array]  # velocity and torque over one period, each (K,)

_SIZE = (400, 300)  # [px]
_OVERSAMPLING = 4  # pixels drawn per pixel of the picture, in each direction
_EDGES = (20, 2, 2, 20)  # [px] left, top, right and bottom of all panels, for the labels
_INNER = (28, 6, 8, 16)  # [px] of each panel, for the numbers of its ticks
_MAX_PANELS_PER_ROW = 3  # maximum panels per row
_FREQUENCY = 0.25  # [Hz]
_PERIODS = 3  # the last one is drawn, after the states have settled
_ROWS_PER_PERIOD = 400  # rows
_SHARES = {1 / 3: "#9ecae1", 2 / 3: "#4a98c9", 1.0: "#0b559f"}
"""Velocity amplitudes, as fractions of the reference motion, and their colours."""
_GREY = "#777777"
_MAX_TORQUE = 1e9  # [N.m]; larger values count as infinite
_MAX_COLOURS = 256
_SHADE = 32  # steps between shades of a colour, of 256


def model_png(model: FrictionModel) -> bytes:
    """Return model.png: torque over velocity of each joint, as loops at three amplitudes."""
    from PIL import Image, ImageDraw

    loops = _loops(model)
    columns = min(len(loops), _MAX_PANELS_PER_ROW)
    rows = ceil(len(loops) / columns)
    picture = Image.new("RGB", (_OVERSAMPLING * _SIZE[0], _OVERSAMPLING * _SIZE[1]), "white")
    drawing = ImageDraw.Draw(picture)
    left_margin, top_margin, right_margin, bottom_margin = _EDGES
    width = _SIZE[0] - left_margin - right_margin
    height = _SIZE[1] - top_margin - bottom_margin
    for j, joint_loops in enumerate(loops):
        row, column = divmod(j, columns)
        x = left_margin + column * width / columns
        y = top_margin + row * height / rows
        box = [x, y, x + width / columns, y + height / rows]
        inner = (n * sign for n, sign in zip(_INNER, (1, 1, -1, -1), strict=True))
        _draw(drawing, [b + i for b, i in zip(box, inner, strict=True)], joint_loops, str(j + 1))
    middle = left_margin + width / 2
    _text(drawing, middle, _SIZE[1] - 2, f"dq [{unit_of_joints('rad/s', model.sliding)}]", "md", 12)
    aside = Image.new("RGB", (_OVERSAMPLING * _SIZE[1], _OVERSAMPLING * left_margin), "white")
    label = f"tau [{unit_of_joints('N.m', model.sliding)}]"
    _text(ImageDraw.Draw(aside), top_margin + height / 2, 2, label, "ma", 12)
    picture.paste(aside.transpose(Image.Transpose.ROTATE_90).crop((0, 0, 60, 9999)), (0, 0))
    # Fewer shades halve the size without a visible difference.
    pixels = np.asarray(picture.resize(_SIZE, Image.Resampling.BOX)) // _SHADE * _SHADE
    written = io.BytesIO()
    _index_colours(pixels + (_SHADE - 1)).save(written, format="PNG", optimize=True)
    return written.getvalue()


def _index_colours(pixels: NDArray[np.uint8]) -> "Image":
    """Return the picture (rows, columns, 3) with a palette, if it has few enough colours."""
    from PIL import Image

    # Rows of a matrix are sorted ten times slower than numbers.
    packed = pixels.astype(np.int64) @ (1 << 16, 1 << 8, 1)
    values, places = np.unique(packed, return_inverse=True)
    colours = (values[:, None] >> np.array([16, 8, 0]) & 255).astype(np.uint8)
    if len(colours) > _MAX_COLOURS:
        return Image.fromarray(pixels)
    picture = Image.fromarray(places.reshape(pixels.shape[:2]).astype(np.uint8)).convert("P")
    picture.putpalette(colours.tobytes())
    return picture


def _loops(model: FrictionModel) -> list[list[Loop]]:
    motion = reference_motion(
        model, frequency=_FREQUENCY, periods=_PERIODS, rows=_PERIODS * _ROWS_PER_PERIOD
    )
    loops = []
    for law, (dq, q, load) in zip(model.laws, motion.iterate_joints(), strict=True):
        # The exact discretisation is stable at any step.
        exact_law = replace(law, discretisation="exact")
        middle = 0.5 * (q.min() + q.max())
        joint_loops = []
        with np.errstate(all="ignore"):  # non-finite results are left out
            for share in _SHARES:
                v = share * dq
                position = middle + share * (q - middle)
                tau = predict(exact_law, t=motion.t, dq=v, q=position, tau_load=load)
                joint_loops.append((v[-_ROWS_PER_PERIOD:], tau[-_ROWS_PER_PERIOD:]))
        loops.append(joint_loops)
    return loops


def _draw(drawing: "ImageDraw", box: Sequence[float], loops: Sequence[Loop], label: str) -> None:
    """Draw a panel in a box: left, top, right and bottom [px]."""
    left_edge, top_edge, right_edge, bottom_edge = box
    curves = []
    for dq, tau in loops:
        finite_rows = np.flatnonzero(np.abs(tau) < _MAX_TORQUE)
        curves.append(np.stack((dq, tau), axis=1)[np.append(finite_rows, finite_rows[:1])])
    extent_points = np.concatenate((*curves, [[-1e-9, -1e-9], [1e-9, 1e-9]]))
    margin = 0.05 * np.ptp(extent_points, axis=0)
    lowest = extent_points.min(axis=0) - margin
    highest = extent_points.max(axis=0) + margin
    scale = np.array([right_edge - left_edge, top_edge - bottom_edge]) / (highest - lowest)

    def place(points: Array) -> Array:
        return np.asarray((points - lowest) * scale + (left_edge, bottom_edge))

    def line(points: Array, colour: str, width: float) -> None:
        fine = [tuple(point) for point in (_OVERSAMPLING * place(points)).tolist()]
        drawing.line(fine, fill=colour, width=round(_OVERSAMPLING * width), joint="curve")

    line(np.array([[lowest[0], 0.0], [highest[0], 0.0]]), _GREY, 0.8)
    line(np.array([[0.0, lowest[1]], [0.0, highest[1]]]), _GREY, 0.8)
    for curve, colour in zip(curves, _SHARES.values(), strict=True):
        if len(curve):
            line(curve, colour, 2.2)
    for number in _ticks(lowest[0], highest[0]):
        _text(drawing, place(np.array([number, 0.0]))[0], bottom_edge + 3, f"{number:g}", "ma", 10)
    for number in _ticks(lowest[1], highest[1]):
        _text(drawing, left_edge - 3, place(np.array([0.0, number]))[1], f"{number:g}", "rm", 10)
    _text(drawing, left_edge + 6, top_edge + 2, label, "la", 14, "black")


def _ticks(low: float, high: float) -> list[float]:
    """Return at most five round numbers in a range."""
    min_step = (high - low) / 4
    power = 10.0 ** floor(log10(min_step))
    step = next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= min_step)
    return [k * step for k in range(ceil(low / step), floor(high / step) + 1)]


def _text(
    drawing: "ImageDraw", x: float, y: float, text: str, anchor: str, size: int, colour: str = _GREY
) -> None:
    from PIL import ImageFont

    font = ImageFont.load_default(_OVERSAMPLING * size)
    drawing.text(
        (_OVERSAMPLING * x, _OVERSAMPLING * y), text, fill=colour, font=font, anchor=anchor
    )
