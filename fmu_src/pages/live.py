"""Interactive sections of pages: models with knobs, run by the C of FMUs as WebAssembly.

A page may have any number of them, with one shared script and style.
"""

import base64
import re
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from math import floor, log10
from pathlib import Path
from typing import Any

import sympy

from fmu_src.export.interface import Interface
from fmu_src.export.package import read_c_source
from fmu_src.export.toolchain import build_wasm
from fmu_src.friction.friction_component import place, scale_names
from fmu_src.friction.reference import trained_speed
from fmu_src.pages.html import TEMPLATES, render_template
from fmu_src.pages.mathml import symbol
from hesr_model.errors import ArtifactError
from hesr_model.friction.inputs import INPUTS, TAU_LOAD, Q
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.support.files import scratch_folder
from hesr_model.support.text import join_few, on_one_line, parse_json, quote
from hesr_model.support.typed_files import from_json, to_json
from hesr_model.units import unit_of_joint


def wasm(sources: Mapping[str, str]) -> bytes:
    """Compile the C files of `package.translation_unit` to a WebAssembly module without imports.

    It exports the functions of `c/live.c` around those of FMI.
    """
    with scratch_folder() as folder:
        for name, text in (*sources.items(), ("live.c", read_c_source("live.c"))):
            (folder / name).write_text(text, encoding="utf-8")
        powers = any(re.search(r"\bpow\(", text) for text in sources.values())
        return build_wasm(folder / "live.c", powers=powers)


def pack_module(module: bytes) -> str:
    """Return a module as text for embedding in pages."""
    return base64.b64encode(zlib.compress(module, 9)).decode()


def live_section(data: Mapping[str, Any], key: str = "live") -> str:
    """Return the section of a friction model; `live_assets` must follow it on the page.

    The colours are the page's --ink, --soft, --line, --paper, --card and --accent. The key is the
    prefix of identifiers.
    """
    return render_template("live.html.j2", data=data, key=key)


def live_assets(*, fit_tables: bool = False) -> str:
    """Return the style and script of all interactive sections of a page, to follow them.

    With `fit_tables` the script also fits tables and equations to the width of the page, as that of
    `report.html.j2` does by itself.
    """
    names = ["live_plot.js", "live.js"]
    if fit_tables:
        names.append("fit.js")
    scripts = "\n".join(_text(name) for name in names)
    script = f'(() => {{\n"use strict";\n{scripts}}})();'
    return f"<style>\n{_text('live.css')}</style>\n<script>\n{script}\n</script>\n"


def _text(name: str) -> str:
    code = re.sub(r"/\*.*?\*/\n?", "", (TEMPLATES / name).read_text("utf-8"), flags=re.DOTALL)
    return re.sub(r"^\s+", "", code, flags=re.MULTILINE)


_SLIDER_FACTOR = 5.0  # range of a coefficient's slider, as a factor in both directions
_MIN_FREQUENCY = 0.05
_MAX_FREQUENCY = 5.0  # [Hz]
_MIN_SLIDER_ROWS = 20  # rows of a cycle
_DEFAULT_FREQUENCY = 0.25  # [Hz], as in the FMU's picture
_CONNECTORS = (*(quantity.name for quantity in INPUTS), "tau")
_UNITS = {"velocity": "rad/s", "position": "rad", "time": "s", "torque": "N.m"}
_DEFAULT_LOAD = 20.0  # default load [N.m]
_MIN_FIELD_ROWS = 4
_MAX_CYCLE_ROWS = 20_000  # rows of a cycle; a browser runs this many within seconds
_MAX_CYCLES = 100.0


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


@dataclass(frozen=True)
class LiveJoint:
    """Data of a joint; `references` are the variables of the module by connector."""

    name: str
    references: dict[str, int]
    units: dict[str, str]
    speeds: tuple[float, float] | None
    motion: tuple[Knob, ...]
    coefficients: tuple[Knob, ...]


@dataclass(frozen=True)
class LiveData:
    """JSON data of an interactive section: a packed WebAssembly module, step [s] and joints."""

    module: str
    step: float
    joints: tuple[LiveJoint, ...]


_MATHML = re.compile(r'(?:</?m[a-z]+(?: class="dot")?>|[^<])*')
"""Symbols of a page, which the browser shows as markup: MathML, with attributes of dots only."""


def read_live_data(text: str, path: Path) -> dict[str, Any]:
    """Return the data of an interactive section that an FMU carries; raises ArtifactError."""
    try:
        data = parse_json(text)
    except ValueError as error:
        raise ArtifactError(f"{path}: not a readable page ({on_one_line(error)}).") from error
    live = from_json(LiveData, data, path, "the data of a plot")
    for joint in live.joints:
        missing_units = _UNITS.keys() - joint.units.keys()
        if missing_units:
            raise ArtifactError(f"{path}: a plot has no unit of {join_few(sorted(missing_units))}.")
        for knob in joint.coefficients:
            if not _MATHML.fullmatch(knob.symbol):
                raise ArtifactError(f"{path}: the symbol {quote(knob.symbol)} is not MathML.")
    if not live.joints:
        raise ArtifactError(f"{path}: the data of a plot name no joint.")
    checked: dict[str, Any] = to_json(live)
    return checked


def live_data(model: FrictionModel, interface: Interface, module: bytes) -> dict[str, Any]:
    """Return the JSON data of an interactive section; `module` is the result of `wasm`."""
    trained_ranges = model.trained or (None,) * len(model.joints)
    joints = []
    for i, (name, law, trained_range, slides) in enumerate(
        zip(model.joints, model.laws, trained_ranges, model.slides, strict=True), start=1
    ):
        motion = [
            replace(knob, unit=unit_of_joint(knob.unit, is_prismatic=slides))
            for knob in _motion(law, trained_range, model.sample_time)
        ]
        speeds = None
        if trained_range is not None:
            speeds = list(trained_range.dq)
        joint = {
            "name": name,
            "references": {x: interface.places[f"{x}[{i}]"] for x in _CONNECTORS},
            "units": {x: unit_of_joint(unit, is_prismatic=slides) for x, unit in _UNITS.items()},
            "speeds": speeds,
            "motion": list(map(asdict, motion)),
            "coefficients": list(map(asdict, _coefficients(law, i, interface))),
        }
        joints.append(joint)
    return {"module": pack_module(module), "step": model.sample_time, "joints": joints}


def _motion(
    law: FrictionLaw, trained_range: TrainedRange | None, step_size: float
) -> Iterator[Knob]:
    """Yield the knobs of a joint's motion."""
    middle = 0.0
    lowest_load = 0.0
    highest_load = 0.0
    if trained_range is not None:
        middle = trained_range.middle
        lowest_load, highest_load = trained_range.tau_load
    speed = trained_speed(trained_range)
    digits = 2 - floor(log10(speed))
    amplitude = floor(speed * 10.0**digits) / 10.0**digits  # short, and within the trained range
    low = _round_number(speed / 200.0)
    high = _round_number(2.0 * speed)
    yield Knob("amplitude", "velocity amplitude", "rad/s", amplitude, low, high, "log", least=0.0)
    yield _frequency(step_size)
    text = "cycles, the last one drawn in full"
    yield Knob("cycles", text, "", 3.0, 1.0, 10.0, "whole", least=1.0, most=_MAX_CYCLES)
    if Q in law.form.inputs:
        low = _round_number(middle - 3.0)
        high = _round_number(middle + 3.0)
        yield Knob("centre", "centre of the positions", "rad", middle, low, high)
    if TAU_LOAD in law.form.inputs:
        load_range = highest_load - lowest_load
        reach = max(load_range, abs(lowest_load), abs(highest_load)) or _DEFAULT_LOAD
        load = 0.5 * (lowest_load + highest_load)
        low = _round_number(load - reach)
        high = _round_number(load + reach)
        yield Knob("load", "load torque, constant", "N.m", load, low, high)


def _frequency(step_size: float) -> Knob:
    """Return the knob of the frequency; a cycle has neither too few nor too many rows."""
    fastest = max(min(_MAX_FREQUENCY, 1.0 / (_MIN_SLIDER_ROWS * step_size)), 2.0 * _MIN_FREQUENCY)
    high = _round_number(fastest)
    return Knob(
        "frequency",
        "frequency",
        "Hz",
        min(_DEFAULT_FREQUENCY, fastest),
        _MIN_FREQUENCY,
        high,
        "log",
        least=min(_MIN_FREQUENCY, _round_number(1.0 / (_MAX_CYCLE_ROWS * step_size))),
        most=max(high, _round_number(1.0 / (_MIN_FIELD_ROWS * step_size))),
    )


def _coefficients(law: FrictionLaw, number: int, interface: Interface) -> Iterator[Knob]:
    """Yield the knobs of a joint's coefficients, if they are parameters, and of its factors."""
    parameter_names = place(law, number).parameters
    if parameter_names:
        for name, coefficient in zip(parameter_names, law.form.coefficients, strict=True):
            factor = _is_factor(law.form, coefficient.symbol)
            knob = _parameter_knob(interface, name, factor=factor)
            yield replace(knob, name=coefficient.name, symbol=symbol(coefficient.name))
    for name in scale_names(number):
        yield _parameter_knob(interface, name, factor=True)


def _parameter_knob(interface: Interface, name: str, *, factor: bool) -> Knob:
    """Return the knob of a parameter, within its limits; see `ends` for `factor`."""
    reference = interface.places[name]
    variable = interface.variables[reference]
    low, high, kind = ends(variable.start, factor=factor)
    if variable.least is not None:
        low = max(low, variable.least)
    if variable.greatest is not None:
        high = min(high, variable.greatest)
    unit = ""
    if variable.unit not in (None, "1"):
        unit = str(variable.unit)
    return Knob(
        name,
        variable.description,
        unit,
        variable.start,
        low,
        high,
        kind,
        least=variable.least,
        most=variable.greatest,
        reference=reference,
    )


def ends(value: float, *, factor: bool) -> tuple[float, float, str]:
    """Return the limits and the scale of a coefficient's slider, with its value in the middle.

    A factor of a term ranges from zero to twice its value; others have a logarithmic scale.
    """
    if value == 0.0:
        return -1.0, 1.0, "linear"
    if factor:
        other_end = _round_number(2.0 * value)
        return min(0.0, other_end), max(0.0, other_end), "linear"
    low_end, other_end = sorted(
        (_round_number(value / _SLIDER_FACTOR), _round_number(value * _SLIDER_FACTOR))
    )
    return low_end, other_end, "log"


def _is_factor(form: LawForm, c: sympy.Symbol) -> bool:
    """Return whether the output is linear in a coefficient: a plain factor of all its terms."""
    # A state's derivative contains the coefficients of its element.
    for element in form.memory:
        if any(c in part.free_symbols for part in element.parts):
            return False
    terms = [term for term in sympy.Add.make_args(form.output) if term.has(c)]
    return all(_is_plain_factor(c, term) for term in terms)


def _is_plain_factor(c: sympy.Symbol, term: sympy.Expr) -> bool:
    """Return whether a term is a coefficient times what does not contain it."""
    factors = sympy.Mul.make_args(term)
    if c not in factors:
        return False
    return not any(factor.has(c) for factor in factors if factor != c)


def _round_number(value: float) -> float:
    return float(f"{value:.3g}")
