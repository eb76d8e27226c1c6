"""Thresholds of checks, found by bisection, and the numbers of findings."""

from collections.abc import Callable, Iterable

from unchanged import NUMBER

from hesr_model.findings import Finding


def edge(
    speaks: Callable[[float], object], low: float, high: float, steps: int = 24
) -> list[float]:
    """Return the threshold of a check, and 1 if it reports above it, 0 if below."""
    at_low = bool(speaks(low))
    assert at_low != bool(speaks(high)), "it says the same at both ends"
    for _ in range(steps):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if bool(speaks(middle)) == at_low else (low, middle)
    return [0.5 * (low + high), 0.0 if at_low else 1.0]


def said(findings: Iterable[Finding]) -> list[str]:
    """Return check, severity, joints and numbers of each finding."""
    return [
        f"{f.check}, {f.severity}, {list(f.joints)}: {', '.join(NUMBER.findall(f.found))}"
        for f in findings
    ]
