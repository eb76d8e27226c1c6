"""Click commands derived from the signatures and docstrings of workflow functions.

A positional parameter becomes an argument, a keyword-only one an option; `bool` a flag, `Literal` a
choice, `Names` and other types of several items a repeatable option, `Mapping` KEY=VALUE,
`PerJoint` numbers with commas.
"""

import ast
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import click

from hesr_model.errors import ConfigError
from hesr_model.support import plugins
from hesr_model.support.text import parse_toml

if TYPE_CHECKING:
    from cosim.workflow.export_formats import HelpSection

Function = Callable[..., Any]
Kind = click.ParamType[Any, Any]
Invoke = Callable[[Function, dict[str, Any]], None]

VERBS = (
    *("new", "inspect", "excite", "identify", "fit", "test"),
    *("export", "check", "simulate", "run", "report"),
)
"""Commands of HESR without plug-ins, in the order of work."""

_ITEMS = {
    "Names": "str",
    "Paths": "PathArg",
    "Logs": "LogArg",
    "Laws": "LawArg",
    "NamedLaws": "LawArg",
}
"""Annotations of one item, by those of several (`cosim.workflow.arguments`)."""

# Width of an example in the help, which is indented by 2 and may end with a backslash.
_EXAMPLE_WIDTH = 75


@dataclass(frozen=True, kw_only=True)
class Form:
    """Command-line form of a parameter where it differs from the derived one."""

    names: tuple[str, ...] = ()
    metavar: str | None = None
    option: bool = False  # although the parameter is positional
    minimum: int | None = None  # smallest integer
    complete: str = ""  # source of the completion: a group of plug-ins, or "platforms"
    repetition: str = "repeatable"  # how several items are given


_FORMS = {
    "output": Form(names=("-o", "--output"), metavar="FILE"),
    "export.output": Form(names=("-o", "--output"), metavar="FILE", option=True),
    "new.robot": Form(metavar="MODEL", option=True),
    "joints": Form(repetition="repeatable or with commas"),
    "logs": Form(metavar="LOG"),
    "laws": Form(metavar="LAW"),
    "fmus": Form(metavar="FMU"),
    "results": Form(metavar="RESULT"),
    "robot": Form(metavar="ROBOT"),
    "reversed_logs": Form(names=("--reversed",), metavar="LOG"),
    "options": Form(names=("--option",), metavar="KEY=VALUE"),
    "accept": Form(metavar="CHECK"),
    "seed": Form(metavar="N", minimum=0),
    "only": Form(metavar="N", minimum=0),
    "seeds": Form(metavar="N", minimum=1),
    "workers": Form(metavar="N", minimum=1),
    "excite.purpose": Form(names=("--for",)),
    "excite.after": Form(metavar="RESULTS"),
    "excite.format": Form(metavar="NAME", complete="hesr.setpoints"),
    "fit.law": Form(metavar="NAME", complete="hesr.laws"),
    "prior": Form(metavar="LAW"),
    "format": Form(metavar="NAME", complete="hesr.exports"),
    "platform": Form(metavar="NAME", complete="platforms"),
}
"""Forms by parameter, or by verb and parameter."""


class _Numbers(Kind):
    name = "X[,X...]"

    def convert(self, value: Any, param: click.Parameter | None, _: Any) -> tuple[float, ...]:
        try:
            return tuple(float(part) for part in str(value).split(","))
        except ValueError as error:
            raise ConfigError(
                f"{_option(param)} is '{value}'; expected numbers such as 3,3,0.6."
            ) from error


class _Pair(Kind):
    name = "KEY=VALUE"

    def convert(self, value: Any, param: click.Parameter | None, _: Any) -> dict[str, Any]:
        try:
            return parse_toml(str(value))
        except ValueError as error:
            raise ConfigError(
                f"{_option(param)} is '{value}'; expected KEY=VALUE in TOML, such as "
                'ripple=false or search="paper".'
            ) from error


def _option(param: click.Parameter | None) -> str:
    if param is None:
        return "the option"
    return param.opts[-1]


@dataclass(frozen=True, kw_only=True)
class Docstring:
    """Parts of a numpydoc docstring: parameters by name, examples as commands without prompt."""

    summary: str
    text: str
    parameters: dict[str, str] = field(default_factory=dict)
    examples: list[str] = field(default_factory=list)

    @classmethod
    def from_function(cls, function: Function) -> "Docstring":
        """Parse the docstring of a function."""
        text = inspect.getdoc(function) or ""
        head, *titles_and_texts = re.split(r"(?m)\n*^(\w[\w ]*)\n-{3,}\n", text)
        sections = dict(zip(titles_and_texts[::2], titles_and_texts[1::2], strict=True))
        parameter_text = "\n".join(
            sections.get(section, "") for section in ("Parameters", "Other Parameters")
        )
        entries = re.findall(
            r"^(\w+)(?: :.*)?\n((?: {4}.*\n?|\n)+)", f"{parameter_text}\n", re.MULTILINE
        )
        examples = re.sub(r" \\\n\s*", " ", sections.get("Examples", ""))
        return cls(
            summary=head.partition("\n")[0],
            text=_name_options(head, function),
            parameters={
                name: _name_options(" ".join(description.split()), function)
                for name, description in entries
            },
            examples=re.findall(r"^ *\$ (hesr .*)$", examples, re.MULTILINE),
        )


def _name_options(text: str, function: Function) -> str:
    """Return text with options for parameters in backticks, and commands for functions."""
    parameters = inspect.signature(function).parameters

    def replace(match: re.Match[str]) -> str:
        name = match[1]
        if name in parameters and parameters[name].kind is inspect.Parameter.KEYWORD_ONLY:
            return _name_option(function.__name__, name)
        if name in VERBS:
            return f"'hesr {name}'"
        return f"'{name}'"

    return re.sub(r"`+([^`]+)`+", replace, text).strip()


def _name_option(verb: str, name: str) -> str:
    """Return the long name of the option of a parameter."""
    names = _find_form(verb, name).names or (f"--{name.replace('_', '-')}",)
    return names[-1]


def _find_form(verb: str, name: str) -> Form:
    return _FORMS.get(f"{verb}.{name}") or _FORMS.get(name) or Form()


def command(
    name: str, function: Function, invoke: Invoke, sections: "Sequence[HelpSection]" = ()
) -> click.Command:
    """Return the click command of a workflow function, called by `invoke` with parsed values.

    It also has the options of the sections, which the help shows there.
    """
    docstring = Docstring.from_function(function)
    parameters = [
        _build_parameter(name, parameter, docstring.parameters.get(parameter.name, ""), function)
        for parameter in inspect.signature(function).parameters.values()
        if parameter.kind is not parameter.VAR_KEYWORD and parameter.name != "progress"
    ]
    if "listing" in vars(sys.modules[function.__module__]):
        listing = click.Option(["--list", "listing"], is_flag=True, help="List the choices.")
        parameters.append(listing)
    section_options = {
        section.title: _section_options(name, section, function) for section in sections
    }
    # Formats may share an option: its first description parses it.
    distinct: dict[str | None, click.Parameter] = {}
    for options in section_options.values():
        for option in options:
            distinct.setdefault(option.name, option)
    return _Command(
        name,
        sections=sections,
        section_options=section_options,
        callback=lambda **arguments: invoke(function, _select_arguments(arguments)),
        params=[*parameters, *distinct.values(), *_common_options()],
        help=docstring.text,
        short_help=docstring.summary,
        epilog=_format_examples(docstring.examples),
        context_settings={"max_content_width": 80},
    )


def _section_options(
    verb: str, section: "HelpSection", function: Function
) -> list[click.Parameter]:
    options = []
    for option in section.options:
        parameter = inspect.Parameter(
            option.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=option.annotation,
        )
        options.append(_build_parameter(verb, parameter, option.description, function))
    return options


class _Command(click.Command):
    """Command with sections of options; its other parameters are optional with --list."""

    def __init__(
        self,
        name: str,
        *,
        sections: "Sequence[HelpSection]",
        section_options: dict[str, list[click.Parameter]],
        **settings: Any,
    ) -> None:
        super().__init__(name, **settings)
        self.sections = sections
        self.section_options = section_options

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if "--list" in args and any(param.name == "listing" for param in self.params):
            for param in self.params:
                param.required = False
        return super().parse_args(ctx, args)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        names_in_sections: set[str] = set()
        for section in self.sections:
            names_in_sections |= {option.name for option in section.options}
        general_options = [
            param
            for param in self.get_params(ctx)
            if isinstance(param, click.Option) and param.name not in names_in_sections
        ]
        _write_section(formatter, "Options", _help_records(general_options, ctx))
        for section in self.sections:
            records = _help_records(self.section_options[section.title], ctx)
            _write_section(formatter, section.title, [*section.formats, *records])


def _help_records(options: Sequence[click.Parameter], ctx: click.Context) -> list[tuple[str, str]]:
    records = [option.get_help_record(ctx) for option in options]
    return [record for record in records if record is not None]


def _write_section(
    formatter: click.HelpFormatter, title: str, records: list[tuple[str, str]]
) -> None:
    # Titles that name many formats take several lines.
    lines = textwrap.wrap(title, formatter.width - 1, break_on_hyphens=False)
    with formatter.section("\n".join(lines)):
        formatter.write_dl(records)


def _select_arguments(arguments: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments that are set; several tables become one."""
    selected = {}
    for name, value in arguments.items():
        if value in (None, ()):
            continue
        if _is_tables(value):
            selected[name] = _merge_tables(value)
        else:
            selected[name] = value
    return selected


def _is_tables(value: object) -> bool:
    return isinstance(value, tuple) and all(isinstance(item, dict) for item in value)


def _merge_tables(tables: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return one table of several; the last of several plain values counts."""
    merged: dict[str, Any] = {}
    for table in tables:
        for key, value in table.items():
            earlier_value = merged.get(key)
            if isinstance(earlier_value, dict) and isinstance(value, dict):
                merged[key] = _merge_tables([earlier_value, value])
            else:
                merged[key] = value
    return merged


def _build_parameter(
    verb: str, parameter: inspect.Parameter, text: str, function: Function
) -> click.Parameter:
    """Return the argument or option of a parameter, with its help text."""
    form = _find_form(verb, parameter.name)
    annotation = str(parameter.annotation).removesuffix(" | None")
    item_annotation = _find_item_annotation(annotation)
    is_repeated = item_annotation != annotation
    if parameter.kind is parameter.POSITIONAL_OR_KEYWORD and not form.option:
        return _build_argument(parameter, form, text, is_repeated=is_repeated)
    option_name = _name_option(verb, parameter.name)
    if item_annotation == "bool":
        return click.Option([option_name, parameter.name], is_flag=True, help=text)
    kind = _choose_kind(item_annotation, function, form)
    is_multiple = is_repeated or isinstance(kind, _Pair)
    if is_multiple and text:
        text = f"{text.removesuffix('.')} ({form.repetition})."
    completion = None
    if form.complete:
        completion = _build_completion(form.complete)
    return click.Option(
        [*(form.names or (option_name,)), parameter.name],
        type=kind,
        multiple=is_multiple,
        required=parameter.default is parameter.empty,
        metavar=form.metavar or _choose_metavar(item_annotation, kind),
        help=text,
        shell_complete=completion,
    )


def _find_item_annotation(annotation: str) -> str:
    """Return the annotation of one item of a parameter of several, or that of a single one."""
    item_match = re.fullmatch(r"Sequence\[(.*)\]|.* \| Iterable\[(.*)\]", annotation)
    if item_match:
        return item_match[1] or item_match[2]
    return _ITEMS.get(annotation, annotation)


def _build_argument(
    parameter: inspect.Parameter, form: Form, text: str, *, is_repeated: bool
) -> click.Argument:
    is_required = parameter.default is parameter.empty
    metavar = form.metavar or parameter.name.upper()
    if not is_required:
        metavar = f"[{metavar}]"
    count = 1
    if is_repeated:
        metavar += "..."
        count = -1  # any number
    return click.Argument(
        [parameter.name], nargs=count, required=is_required, metavar=metavar, help=text
    )


def _choose_kind(annotation: str, function: Function, form: Form) -> Kind:
    if annotation.startswith("Literal["):
        return click.Choice(ast.literal_eval(f"({annotation[len('Literal[') : -1]},)"))
    annotated_type = vars(sys.modules[function.__module__]).get(annotation)
    if get_origin(annotated_type) is Literal:
        return click.Choice(get_args(annotated_type))
    if annotation.startswith("Mapping"):
        return _Pair()
    kinds: dict[str, Kind] = {
        "int": click.IntRange(min=form.minimum),
        "float": click.FLOAT,
        "PerJoint": _Numbers(),
        "Iterable[float]": _Numbers(),
    }
    return kinds.get(annotation, click.STRING)


def _choose_metavar(annotation: str, kind: Kind) -> str | None:
    if isinstance(kind, click.Choice):
        return None
    words = {"str": "NAME", "float": "X", "int": "N", "PathArg": "FILE"}
    if annotation in words:
        return words[annotation]
    if isinstance(kind, _Numbers | _Pair):
        return kind.name
    return "FILE"


def _build_completion(source: str) -> Callable[[Any, Any, str], list[str]]:
    def complete(_: Any, __: Any, prefix: str) -> list[str]:
        if source == "platforms":
            from fmu_src.export.toolchain import TARGETS

            choices: Sequence[str] = (*TARGETS, "all")
        else:
            choices = plugins.names(source)
        return [name for name in choices if name.startswith(prefix)]

    return complete


def _common_options() -> Iterator[click.Option]:
    yield click.Option(
        ["--json", "json_file"],
        metavar="FILE",
        help="Also write the result as JSON; - is standard output.",
    )
    yield click.Option(
        ["--fail-on"],
        type=click.Choice(["error", "warning", "advice", "never"]),
        default="error",
        help="Lowest severity with exit code 1 (default: error).",
    )
    yield click.Option(["--quiet"], is_flag=True, help="Print errors only.")
    yield click.Option(
        ["--verbose"], is_flag=True, help="Log to standard error, and print all tables."
    )


def _format_examples(examples: Sequence[str]) -> str:
    heading = "Example:"
    if len(examples) > 1:
        heading = "Examples:"
    lines = ["\b", heading]
    for example in examples:
        line = " "
        for part in re.split(" (?=-)", example):  # an option stays with its value
            if len(line) + len(part) > _EXAMPLE_WIDTH:
                lines.append(f"{line} \\")
                line = "   "
            line += f" {part}"
        lines.append(line)
    return "\n".join(lines)
