"""Interactive sections of pages: models with knobs, run by the C of FMUs as WebAssembly.

A page may have any number of them, with one shared script and style.
"""

import base64
import re
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from itertools import zip_longest
from math import floor, log10
from typing import Any

import sympy

from fmu_src.export.interface import Interface
from fmu_src.export.package import own_source
from fmu_src.export.toolchain import build_wasm
from fmu_src.friction.friction_component import place, scales_of
from fmu_src.friction.reference import trained_speed
from fmu_src.pages.html import TEMPLATES, rendered
from fmu_src.pages.mathml import symbol
from hesr_model.friction.inputs import INPUTS, TAU_LOAD, Q
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.support.files import scratch_folder
from hesr_model.units import unit_of_joint


def wasm(sources: Mapping[str, str]) -> bytes:
    """Compile the C files of `package.translation_unit` to a WebAssembly module without imports.

    It exports the functions of `c/live.c` around those of FMI.
    """
    with scratch_folder() as folder:
        for name, text in (*sources.items(), ("live.c", own_source("live.c"))):
            (folder / name).write_text(text, encoding="utf-8")
        powers = any(re.search(r"\bpow\(", text) for text in sources.values())
        return build_wasm(folder / "live.c", powers=powers)


def packed(module: bytes) -> str:
    """Return a module as text for embedding in pages."""
    return base64.b64encode(zlib.compress(module, 9)).decode()


def live_section(data: Mapping[str, Any], key: str = "live") -> str:
    """Return the section of a friction model; `live_assets` must follow it on the page.

    The colours are the page's --ink, --soft, --line, --paper, --card and --accent. The key is the
    prefix of identifiers.
    """
    return rendered("live.html.j2", data=data, key=key)


def live_assets(*, fit_tables: bool = False) -> str:
    """Return the style and script of all interactive sections of a page, to follow them.

    With `fit_tables` the script also fits tables and equations to the width of the page, as that of
    `report.html.j2` does by itself.
    """
    names = ["live_plot.js", "live.js"]
    if fit_tables:
        names.append("fit.js")
    scripts = "\n".join(_text(name) for name in names)
    whole = f'(() => {{\n"use strict";\n{scripts}}})();'
    return f"<style>\n{_text('live.css')}</style>\n<script>\n{whole}\n</script>\n"


def _text(name: str) -> str:
    bare = re.sub(r"/\*.*?\*/\n?", "", (TEMPLATES / name).read_text("utf-8"), flags=re.DOTALL)
    return re.sub(r"^\s+", "", bare, flags=re.MULTILINE)


_FACTOR = 5.0  # range of a coefficient's slider, as a factor in both directions
_SLOWEST = 0.05
_FASTEST = 5.0  # [Hz]
_FEWEST = 20  # rows of a cycle
_USUAL = 0.25  # [Hz], as in the FMU's picture
_UNITS = {"velocity": "rad/s", "position": "rad", "time": "s", "torque": "N.m"}
_NO_LOAD = 20.0  # default load [N.m]
_LEAST_ROWS = 4
_MOST_ROWS = 20_000  # rows of a cycle; a browser runs this many within seconds
_MOST_CYCLES = 100.0


@dataclass(frozen=True)
class Knob:
    """A number with a slider and a number field; `name` is its key on the page.

    `low` and `high` limit the slider, whose scale is "linear", "log" (both limits of one sign) or
    "whole" numbers; `least` and `most` limit the field.
    """

    name: str
    text: str
    unit: str
    value: float
    low: float
    high: float
    scale: str = "linear"
    least: float | None = None
    most: float | None = None
    symbol: str = ""
    reference: int | None = None


def live_data(model: FrictionModel, interface: Interface, module: bytes) -> dict[str, Any]:
    """Return the JSON data of an interactive section; `module` is the result of `wasm`."""
    trained = model.trained or (None,) * len(model.joints)
    connectors = (*(u.name for u in INPUTS), "tau")
    joints = []
    for i, (name, law, trained_range, slides) in enumerate(
        zip(model.joints, model.laws, trained, model.slides, strict=True), start=1
    ):
        motion = _motion(law, trained_range, model.sample_time)
        motion = (replace(k, unit=unit_of_joint(k.unit, slides=slides)) for k in motion)
        joints.append(
            {
                "name": name,
                "references": {x: interface.places[f"{x}[{i}]"] for x in connectors},
                "units": {x: unit_of_joint(unit, slides=slides) for x, unit in _UNITS.items()},
                "speeds": list(trained_range.dq) if trained_range else None,
                "motion": list(map(asdict, motion)),
                "coefficients": list(map(asdict, _coefficients(law, i, interface))),
            }
        )
    return {"module": packed(module), "step": model.sample_time, "joints": joints}


def _motion(law: FrictionLaw, trained_range: TrainedRange | None, step: float) -> Iterator[Knob]:
    speed = trained_speed(trained_range)
    digits = 2 - floor(log10(speed))
    within = floor(speed * 10.0**digits) / 10.0**digits  # short, and within the trained range
    low = _short(speed / 200.0)
    high = _short(2.0 * speed)
    yield Knob("amplitude", "velocity amplitude", "rad/s", within, low, high, "log", least=0.0)
    fastest = max(min(_FASTEST, 1.0 / (_FEWEST * step)), 2.0 * _SLOWEST)
    high = _short(fastest)
    least = min(_SLOWEST, _short(1.0 / (_MOST_ROWS * step)))
    most = max(high, _short(1.0 / (_LEAST_ROWS * step)))
    usual = min(_USUAL, fastest)
    yield Knob("frequency", "frequency", "Hz", usual, _SLOWEST, high, "log", least, most)
    text = "cycles, the last one drawn in full"
    yield Knob("cycles", text, "", 3.0, 1.0, 10.0, "whole", least=1.0, most=_MOST_CYCLES)
    if Q in law.form.inputs:
        middle = trained_range.middle if trained_range else 0.0
        low = _short(middle - 3.0)
        high = _short(middle + 3.0)
        yield Knob("centre", "centre of the positions", "rad", middle, low, high)
    if TAU_LOAD in law.form.inputs:
        low, high = trained_range.tau_load if trained_range else (0.0, 0.0)
        reach = max(high - low, abs(low), abs(high)) or _NO_LOAD
        middle = 0.5 * (low + high)
        low = _short(middle - reach)
        high = _short(middle + reach)
        yield Knob("load", "load torque, constant", "N.m", middle, low, high)


def _coefficients(law: FrictionLaw, joint: int, interface: Interface) -> Iterator[Knob]:
    own = place(law, joint).parameters
    names = (*own, *scales_of(joint))
    for name, coefficient in zip_longest(names, law.form.coefficients if own else ()):
        reference = interface.places[name]
        variable = interface.variables[reference]
        factor = coefficient is None or _is_factor(law.form, coefficient.symbol)
        least = variable.least
        most = variable.greatest
        low, high, kind = ends(variable.start, factor=factor)
        yield Knob(
            coefficient.name if coefficient else name,
            variable.description,
            "" if variable.unit in (None, "1") else str(variable.unit),
            variable.start,
            low if least is None else max(low, least),
            high if most is None else min(high, most),
            kind,
            least,
            most,
            symbol=symbol(coefficient.name) if coefficient else "",
            reference=reference,
        )


def ends(value: float, *, factor: bool) -> tuple[float, float, str]:
    """Return the limits and the scale of a coefficient's slider, with its value in the middle.

    A factor of a term ranges from zero to twice its value; others have a logarithmic scale.
    """
    if value == 0.0:
        return -1.0, 1.0, "linear"
    if factor:
        other = _short(2.0 * value)
        return min(0.0, other), max(0.0, other), "linear"
    one, other = sorted((_short(value / _FACTOR), _short(value * _FACTOR)))
    return one, other, "log"


def _is_factor(form: LawForm, c: sympy.Symbol) -> bool:
    inner = {s for element in form.memory for part in element.parts for s in part.free_symbols}
    # A state's derivative contains the coefficients of its element.
    terms = (term for term in sympy.Add.make_args(form.output) if term.has(c))
    return c not in inner and all(
        c in (parts := sympy.Mul.make_args(term)) and not any(p.has(c) for p in parts if p != c)
        for term in terms
    )


def _short(value: float) -> float:
    return float(f"{value:.3g}")
