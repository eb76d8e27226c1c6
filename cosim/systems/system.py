"""Systems of FMUs in a TOML file, or in an SSP, whose formats are plug-ins."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field, model_validator

from fmu_src.run.master import Order
from hesr_model.errors import RuleError
from hesr_model.support import plugins
from hesr_model.support.files import written_whole
from hesr_model.support.text import to_toml
from hesr_model.support.typed_files import Config, RelativePath

Name = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]
Signal = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*\..+$")]
"""`component.variable`; without an index all elements of a vector."""
Value = bool | int | float | str | tuple[float, ...]

_MULTIPLE_TOLERANCE = 1e-9  # relative tolerance of multiples
_MAX_STEPS = 10**9
_MAX_COMPONENTS = 1000


def _require_order(bounds: tuple[float, float]) -> tuple[float, float]:
    if not bounds[0] < bounds[1]:
        raise RuleError(
            f"the limits {bounds[0]:g} and {bounds[1]:g} are not in ascending order",
            code="system.limits",
        )
    return bounds


Bounds = Annotated[tuple[float, float], AfterValidator(_require_order)]


class ComponentSpec(Config):
    """One FMU of a system; a start value is a number, list of all elements, or name of a choice."""

    name: Name
    fmu: RelativePath
    start: Mapping[str, Value] = {}
    step: float | None = Field(default=None, gt=0.0)  # [s] a multiple of the system's


class Conversion(Config):
    """A linear conversion of a connected value, or a table of its values."""

    factor: float = 1.0
    offset: float = 0.0
    table: Mapping[float, float] = {}

    def __call__(self, value: float) -> float:
        """Return the converted value; values outside a table are kept."""
        if self.table:
            return self.table.get(value, value)
        return self.factor * value + self.offset


class SystemOutput(Config):
    """An output of the system itself, with the conversions of its value in order."""

    signal: Signal
    conversions: tuple[Conversion, ...] = ()


class SystemSpec(Config):
    """A system of FMUs.

    `delay_undeclared` takes outputs of FMUs that do not state their dependencies as those of
    the step before, so that loops through them run.
    """

    name: str = "system"
    step: float = Field(gt=0.0)  # [s]
    begin: float = 0.0  # [s] of the run
    stop: float  # [s] end of the run
    order: Order = "gauss_seidel"  # see `fmu_src.run.master.ExchangeScheme`
    components: tuple[ComponentSpec, ...] = Field(min_length=1, max_length=_MAX_COMPONENTS)
    connections: Mapping[Signal, Signal] = {}  # source of each input
    conversions: Mapping[Signal, tuple[Conversion, ...]] = {}  # of connected inputs, in order
    open_inputs: bool = False  # unconnected inputs keep the start value of the FMU
    observe: tuple[Signal, ...] = ()
    outputs: Mapping[str, SystemOutput] = {}
    delay_undeclared: bool = False
    limits: Mapping[Signal, Bounds | tuple[Bounds, ...]] = {}  # the run ends outside these

    @model_validator(mode="after")
    def _require_consistency(self) -> Self:
        for name, count in Counter(c.name for c in self.components).items():
            if count > 1:
                raise RuleError(
                    f"two components are named '{name}'", code="system.names", key="components"
                )
        _require_multiple(self.stop - self.begin, self.step, "the stop time", "stop")
        for k, component in enumerate(self.components):
            if component.step is not None:
                subject = f"the step of '{component.name}'"
                _require_multiple(component.step, self.step, subject, f"components.{k}.step")
        return self

    @property
    def steps(self) -> int:
        """Number of communication steps of a run."""
        return round((self.stop - self.begin) / self.step)

    def find_step_multiple(self, component: ComponentSpec) -> int:
        """Return the number of communication steps per step of a component."""
        return round((component.step or self.step) / self.step)


def _require_multiple(time: float, step_size: float, subject: str, key: str) -> None:
    ratio = time / step_size
    if not ratio <= _MAX_STEPS:
        raise RuleError(
            f"{subject} is {time:g} s, {ratio:.3g} communication steps of "
            f"{step_size:g} s; at most {_MAX_STEPS:g} are allowed",
            code="system.most_steps",
            key=key,
        )
    # A negative ratio may be infinite, which has no integer.
    if ratio < 0.5 or abs(time - round(ratio) * step_size) > _MULTIPLE_TOLERANCE * time:
        raise RuleError(
            f"{subject} is {time:g} s; it must be a multiple of the communication step, "
            f"{step_size:g} s",
            code="system.multiple",
            key=key,
        )


@contextmanager
def open_system(
    path: Path,
    times: Mapping[str, float | None] | None = None,
    values: Mapping[str, Any] | None = None,
) -> Iterator[SystemSpec]:
    """Yield the system of a file; the FMUs of an SSP are unpacked meanwhile.

    `times` [s] (start, stop, step) and start values by hierarchical name replace those of an SSP.
    """
    if path.suffix.lower() != ".ssp":
        yield SystemSpec.read(path)
        return
    with plugins.find("hesr.systems", "ssp-reader")(path, times or {}, values or {}) as system:
        yield system


def write_system(system: SystemSpec, path: Path) -> Path:
    """Write a system as TOML with relative paths of FMUs, and return the path."""
    with written_whole(path) as temporary:
        text = "\n".join(_format_lines(system, path.parent.resolve()))
        temporary.write_text(f"{text}\n", encoding="utf-8")
    return path


def _format_lines(system: SystemSpec, folder: Path) -> Iterator[str]:
    for key in ("name", "step", "stop", "order", "observe"):
        yield f"{key} = {to_toml(getattr(system, key))}"
    for component in system.components:
        yield from ("", "[[components]]", f"name = {to_toml(component.name)}")
        fmu = Path(os.path.relpath(component.fmu.resolve(), folder)).as_posix()
        yield f"fmu = {to_toml(fmu)}"
        if component.step is not None:
            yield f"step = {to_toml(component.step)}"
        if component.start:
            yield from ("", "[components.start]", *_format_pairs(component.start))
    for table in ("connections", "limits"):
        pairs = getattr(system, table)
        if pairs:
            yield from ("", f"[{table}]", *_format_pairs(pairs))


def _format_pairs(table: Any) -> Iterator[str]:
    for key, value in table.items():
        yield f"{to_toml(key)} = {to_toml(value)}"
