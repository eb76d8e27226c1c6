"""Rules of `hesr check`: identifier, severity, content and clause of the standard."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from hesr_model.findings import Finding, Severity

Problem = tuple[str, str]
"""Identifier of a rule, with an own identifier of a validator after ":", and a sentence."""

MAX_PROBLEMS = 1000  # per check


@dataclass(frozen=True)
class Rule:
    """A rule; a host fails or the standard is violated (error), or may fail (warning)."""

    severity: Severity
    finds: str
    clause: str  # of FMI 2.0.4 and 3.0.1, or the validator

    @property
    def link(self) -> str:
        """Address of the standard; with FMI 3, of its clause."""
        if "SSP" in self.clause and "FMI 3" not in self.clause:
            return "https://ssp-standard.org/"
        if "FMI 3" not in self.clause:
            return "https://fmi-standard.org/"
        last = self.clause.rpartition(" ")[2]
        return f"https://fmi-standard.org/docs/3.0.1/#{_ANCHORS[last]}"


_ANCHORS = {
    "2.2": "general-mechanisms", "2.4": "modelDescription.xml", "2.4.1": "fmiModelDescription",
    "2.4.2": "common-capability-flags", "2.4.3": "figure-schema-UnitDefinitions",
    "2.4.4": "definition-of-types", "2.4.5": "definition-of-log-categories",
    "2.4.6": "DefaultExperiment", "2.4.7": "ModelVariables", "2.4.8": "ModelStructure",
    "2.4.9": "fmiTerminalsAndIcons", "2.5": "fmu-distribution",
    "2.5.1.3": "sources-directory", "2.5.1.4": "binaries-directory",
}  # fmt: skip


_ARCHIVE = "FMI 2: 2.3; FMI 3: 2.5"
_XML = "FMI 2: 2.2; FMI 3: 2.4"
_TYPES = "FMI 2: 2.2.3; FMI 3: 2.4.4"
_ROOT = "FMI 2: 2.2.1; FMI 3: 2.4.1"
_UNITS = "FMI 2: 2.2.2; FMI 3: 2.4.3"
_EXPERIMENT = "FMI 2: 2.2.5; FMI 3: 2.4.6"
_VARIABLES = "FMI 2: 2.2.7; FMI 3: 2.4.7"
_STRUCTURE = "FMI 2: 2.2.8; FMI 3: 2.4.8"
_KINDS = "FMI 2: 3.3.1, 4.3.1; FMI 3: 2.4.2"
_SOURCES = "FMI 2: 2.3; FMI 3: 2.5.1.3"
_BINARIES = "FMI 2: 2.1.1, 2.3; FMI 3: 2.2, 2.5.1.4"
_TERMINALS = "FMI 3: 2.4.9"

RULES: Mapping[str, Rule] = {
    "archive-damaged": Rule("error", "archives or entries that cannot be read", _ARCHIVE),
    "archive-entry": Rule("error", "unsafe names, links, encryption, other compression", _ARCHIVE),
    "archive-backslash": Rule("error", "backslashes in names", _ARCHIVE),
    "archive-duplicate": Rule("error", "names that occur twice", _ARCHIVE),
    "archive-case": Rule("warning", "names that differ in case alone", _ARCHIVE),
    "archive-changed": Rule("warning", "contents other than recorded at the export", _ARCHIVE),
    "archive-large": Rule("warning", "entries too large to be checked", _ARCHIVE),
    "xml-unreadable": Rule("error", "missing, malformed or oversized XML, wrong root", _XML),
    "file-missing": Rule("error", "files that are missing or cannot be opened", "hesr"),
    "xml-encoding": Rule("error", "XML in another encoding than UTF-8", _XML),
    "xml-other-encoding": Rule("warning", "another encoding in descriptions of FMI 2", _XML),
    "xml-undeclared": Rule("advice", "XML of FMI that does not declare its encoding", _XML),
    "fmi-version": Rule("error", "unknown versions of FMI", _ROOT),
    "xsd": Rule("error", "violations of the schema, named by libxml2", "XSD of FMI and SSP"),
    "fmpy": Rule("error", "findings of FMPy", "FMPy"),
    "fmpy-failed": Rule("warning", "descriptions that FMPy cannot read", "FMPy"),
    "vdmcheck2": Rule("error", "findings of VDMCheck2, with the names of its rules", "VDMCheck2"),
    "kind-missing": Rule("error", "neither model exchange nor co-simulation", _ROOT),
    "kind-identifier": Rule("error", "modelIdentifier that is no identifier of C", _KINDS),
    "kind-tool": Rule("advice", "needsExecutionTool", _KINDS),
    "kind-state": Rule("error", "serialisation of states without states", _KINDS),
    "token-empty": Rule("error", "empty guid or instantiationToken", _ROOT),
    "date-format": Rule("advice", "dates of FMI 2 in another form than UTC with Z", _ROOT),
    "experiment-times": Rule("warning", "stop time, step or tolerance out of range", _EXPERIMENT),
    "experiment-step": Rule("advice", "a step longer than the experiment", _EXPERIMENT),
    "unit-twice": Rule("error", "units or display units defined twice", _UNITS),
    "unit-ignored": Rule("advice", "display units that are not defined", "FMI 2: 2.2.7"),
    "type-twice": Rule("error", "types, items or values defined twice", _TYPES),
    "type-unit": Rule("error", "units of types that are not defined or missing", _TYPES),
    "type-name": Rule("error", "types with the name of a variable", _TYPES),
    "category-twice": Rule("error", "log categories defined twice", "FMI 2: 2.2.4; FMI 3: 2.4.5"),
    "variable-name": Rule("error", "variables without a name", _VARIABLES),
    "variable-range": Rule("error", "min above max, start outside both", _VARIABLES),
    "variable-nominal": Rule("error", "nominal values that are not positive", _VARIABLES),
    "variable-item": Rule("error", "start values that are no item of the enumeration", _VARIABLES),
    "variable-type": Rule("error", "declared types of another kind", _VARIABLES),
    "variable-unit": Rule("error", "display units without a unit", _VARIABLES),
    "variable-initial": Rule("error", "inputs with 'initial'", _VARIABLES),
    "variable-derivative": Rule("error", "derivatives of what is not a state", _VARIABLES),
    "variable-independent": Rule("error", "several independent variables", _VARIABLES),
    "variable-attribute": Rule("error", "attributes of another kind of variable", _VARIABLES),
    "variable-clock": Rule("error", "clocks without interval, 'clocks' of none", "FMI 3: 2.4.7"),
    "variable-size": Rule("error", "unknown sizes, wrong number of start values", _VARIABLES),
    "alias-constant": Rule("error", "aliases of constants that differ", _VARIABLES),
    "alias-settable": Rule("error", "aliases of which several can be set", _VARIABLES),
    "alias-unit": Rule("warning", "aliases with different units", _VARIABLES),
    "structure-derivatives": Rule(
        "error", "derivatives and event indicators not continuous", _STRUCTURE
    ),
    "structure-states": Rule("warning", "derivatives of states that are not listed", _STRUCTURE),
    "structure-index": Rule("error", "entries twice or of no variable", _STRUCTURE),
    "structure-dependency": Rule("error", "dependencies on no variable", _STRUCTURE),
    "structure-kind": Rule("error", "kinds of dependencies that are not allowed", _STRUCTURE),
    "structure-clocks": Rule("error", "clocked states that are not listed", "FMI 3: 2.4.8"),
    "structure-order": Rule("warning", "entries or dependencies out of order", _STRUCTURE),
    "structure-loops": Rule("advice", "outputs without dependencies on inputs", _STRUCTURE),
    "terminal-twice": Rule("error", "names of terminals or members that occur twice", _TERMINALS),
    "terminal-member": Rule("error", "members that are no variables", _TERMINALS),
    "terminal-icon": Rule("warning", "a declared icon that is missing", _TERMINALS),
    "source-missing": Rule("error", "listed source files that are missing", _SOURCES),
    "source-include": Rule("warning", "unconditional includes that are missing", _SOURCES),
    "binary-none": Rule("error", "neither binaries nor source code", _ARCHIVE),
    "binary-missing": Rule("error", "folders without the named library", _BINARIES),
    "binary-format": Rule("error", "libraries of another platform, programs", _BINARIES),
    "binary-unreadable": Rule("warning", "libraries that end the reader", _BINARIES),
    "binary-functions": Rule("error", "functions of FMI that are not exported", _BINARIES),
    "binary-unknown": Rule("advice", "exported functions that FMI does not have", _BINARIES),
    "binary-python": Rule("warning", "libraries that need Python in the host", _BINARIES),
    "binary-library": Rule("warning", "libraries that need others, not in the FMU", _BINARIES),
    "binary-runtime": Rule("advice", "libraries that need a runtime of Visual C++", _BINARIES),
    "binary-path": Rule("warning", "libraries that do not find others next to them", _BINARIES),
    "machine-path": Rule("advice", "paths of the build machine, except in comments", "privacy"),
    "hostile": Rule("error", "failures under --kind hostile", "FMI 2: 2.1, 3.2, 4.2; FMI 3: 2.2"),
    "sandbox": Rule("warning", "what foreign code can do here, by --kind sandbox", "hesr"),
    "references": Rule("error", "results other than those in the file", "FMI-LS-REF"),
    "ssp-structure": Rule("error", "parts that are missing or contradict FMUs", "SSP: 5 to 7"),
    "ssp-support": Rule("advice", "parts that 'hesr simulate' does not support", "SSP: 5"),
    "more": Rule("advice", "further findings of a check, beyond 1000", "hesr"),
}
"""Rules by identifier."""

_FOREIGN = Rule("error", "findings of another package's check", "the package")


def findings(problems: Iterable[Problem]) -> list[Finding]:
    """Return the findings of one check, without repetitions and at most `MAX_PROBLEMS`."""
    distinct_problems: dict[Problem, None] = {}
    omitted_count = 0
    for problem in problems:
        if len(distinct_problems) < MAX_PROBLEMS:
            distinct_problems[problem] = None
        elif problem not in distinct_problems:
            omitted_count += 1
    findings = [
        Finding(check=name, severity=find_rule(name).severity, found=text)
        for name, text in distinct_problems
    ]
    if omitted_count:
        findings.append(
            Finding(
                check="more",
                severity="advice",
                found=f"{omitted_count} more findings are not listed.",
            )
        )
    return findings


def find_rule(name: str) -> Rule:
    """Return the rule of a finding."""
    return RULES.get(name.partition(":")[0], _FOREIGN)


def label_problems(name: str, texts: Iterable[str]) -> Iterator[Problem]:
    """Yield sentences as problems of one rule."""
    return ((name, text) for text in texts)
