"""Style and files of figures; in a page each colour is a CSS variable for light and dark."""

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from hesr_model.support.files import written_whole

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType  # missing in older versions

INK = "#1d2430"
SOFT = "#5b6675"
LINE = "#d5dae1"
CARD = "#f4f6f9"
# for colour-blind readers (Okabe and Ito), with a contrast to white of at least 3
SERIES = ("#0069a8", "#c24e00", "#00785a", "#a03f87", "#806400", "#3d4f9f")

VARIABLES = {
    INK: "--ink",
    SOFT: "--soft",
    LINE: "--line",
    CARD: "--card",
    **{colour: f"--c{k}" for k, colour in enumerate(SERIES, start=1)},
}
"""CSS variable of each colour."""

_DPI = 150
_CANVASES: dict[str, tuple[Any, str]] = {
    "svg": (FigureCanvasSVG, "Date"),
    "png": (FigureCanvasAgg, "Software"),
    "pdf": (FigureCanvasPdf, "CreationDate"),
}
"""Canvas of each format, and the metadatum that differs between runs."""
_PATH = re.compile(r'(?<= d=")[^"]*')
_COMMAND = re.compile(r"([A-Za-z])([^A-Za-z]*)")
_RC: "dict[RcKeyType, Any]" = {
    "axes.edgecolor": LINE,
    "axes.facecolor": "none",
    "axes.labelcolor": INK,
    "axes.labelsize": 9,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlecolor": INK,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.xmargin": 0.01,
    "grid.color": LINE,
    "grid.linewidth": 0.5,
    "font.size": 9,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "lines.solid_joinstyle": "round",
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
    "text.color": INK,
    # The grid replaces tick marks.
    "xtick.major.size": 0,
    "xtick.color": LINE,
    "xtick.labelcolor": SOFT,
    "xtick.labelsize": 8,
    "ytick.major.size": 0,
    "ytick.color": LINE,
    "ytick.labelcolor": SOFT,
    "ytick.labelsize": 8,
}


@dataclass(frozen=True, kw_only=True)
class Stroke:
    """Style of a line; width and lengths of dashes and gaps in points, no dashes if solid."""

    colour: str
    width: float = 1.2
    dash: tuple[float, ...] = ()


MEASURED = Stroke(colour=SOFT, width=1.0)
DESIRED = Stroke(colour=INK, width=1.0, dash=(6.0, 2.0))
_DASHES: tuple[tuple[float, ...], ...] = (
    (),
    (5.0, 1.5),
    (1.5, 1.5),
    (7.0, 1.5, 1.5, 1.5),
    (),
    (3.0, 1.0),
)


def strokes(names: Sequence[str]) -> dict[str, Stroke]:
    """Return a style for each name."""
    return {
        name: Stroke(colour=SERIES[k % len(SERIES)], dash=_DASHES[k % len(_DASHES)])
        for k, name in enumerate(names)
    }


apply_style = partial(rc_context, _RC)  # applies the style of the report


def _settle(figure: Figure) -> None:
    engine = figure.get_layout_engine()
    if engine:
        engine.execute(figure)
        figure.set_layout_engine("none")


def _print(figure: Figure, kind: str, file: Any) -> None:
    # `savefig` would draw a figure that had a layout twice.
    canvas, varying = _CANVASES[kind]
    getattr(canvas(figure), f"print_{kind}")(file, metadata={varying: None})


def _render_svg(figure: Figure, salt: str, *, opaque: bool = False) -> str:
    _settle(figure)
    figure.patch.set_visible(opaque)
    text = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": salt}):
        _print(figure, "svg", text)
    figure.patch.set_visible(True)
    return text.getvalue()


def svg(figure: Figure, key: str) -> str:
    """Return a figure as SVG with the page's colours and fonts; `key` prefixes its identifiers."""
    svg_text = _render_svg(figure, key)
    width, height = 72.0 * figure.get_size_inches()
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'viewBox="0 0 {width:g} {height:g}" aria-hidden="true">{_inner(svg_text, key)}'
    )


def write_svg(figure: Figure, path: Path) -> None:
    """Write a figure as a standalone SVG with reproducible bytes."""
    with written_whole(path) as temporary:
        temporary.write_text(
            _shorten_paths(_render_svg(figure, path.stem, opaque=True)), encoding="utf-8"
        )


def write(figure: Figure, stem: Path) -> None:
    """Write a figure as PDF and PNG with reproducible bytes."""
    _settle(figure)
    for kind in ("png", "pdf"):
        figure.set_dpi(_DPI)
        with written_whole(stem.with_name(f"{stem.name}.{kind}")) as temporary:
            _print(figure, kind, temporary)


def _shorten_paths(body: str) -> str:
    return _PATH.sub(lambda m: _to_relative_path(m[0]), body)


def _to_relative_path(path: str) -> str:
    parts: list[str] = []
    last_point = [0, 0]
    previous_command = ""
    for command, numbers in _COMMAND.findall(path):
        tenths = [round(10.0 * float(number)) for number in numbers.split()]
        coordinates = tenths
        if command == "L":
            coordinates = [
                value - previous_value
                for value, previous_value in zip(tenths, last_point, strict=True)
            ]
            command = "l"
        parts += [
            "" if command == previous_command == "l" else command,
            *(f"{v / 10: g}" for v in coordinates),
        ]
        last_point, previous_command = tenths[-2:] or last_point, command
    return "".join(parts).replace(" 0.", " .").replace("-0.", "-.")


def _inner(svg_text: str, key: str) -> str:
    body = svg_text[svg_text.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    used_ids = set(
        re.findall(r"#([\w.-]+)", " ".join(re.findall(r'(?:href="|url\()#[\w.-]+', body)))
    )
    body = re.sub(
        r' id="([\w.-]+)"', lambda m: f' id="{key}-{m[1]}"' if m[1] in used_ids else "", body
    )
    body = re.sub(r'(href="|url\()#([\w.-]+)', rf"\1#{key}-\2", body)
    body = _shorten_paths(body)
    body = re.sub(r"font: ([\d.]+px) '[^\"]*?(?=[;\"])", r"font-size: \1", body)
    body = re.sub(
        r"font: (bold |700 )([\d.]+px) '[^\"]*?(?=[;\"])", r"font-weight: 600; font-size: \2", body
    )
    for colour, variable in VARIABLES.items():
        body = body.replace(colour, f"var({variable})")
    return body[body.index(">") + 1 :]
