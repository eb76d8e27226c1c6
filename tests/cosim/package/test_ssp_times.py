"""Steps and times of SSPs: hints that do not fit, and texts that are no times."""

import logging

import pytest

from hesr.extras.ssp.ssp_times import fit_hint, fit_stop, read_step, require_times
from hesr_model.errors import ConfigError


@pytest.mark.parametrize("text", ["fast", "0", "-1", "INF", "NaN", ""])
def test_steps_are_positive_numbers(text: str) -> None:
    with pytest.raises(ConfigError, match=f"^x is '{text}'; it must be"):
        read_step(text, "x")
    assert read_step("2.5e-1", "x") == 0.25


@pytest.mark.parametrize(
    ("hint", "step_size", "is_changed"),
    [
        ("0.2", 0.2, False),
        ("0.30000000000000004", 0.3, False),
        ("0.25", 0.2, True),
        ("0.05", 0.1, True),
        ("0", None, False),
        (" ", None, False),
    ],
)
def test_hints_become_multiples(
    hint: str, step_size: float | None, is_changed: bool, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        fitted = fit_hint(hint, 0.1, "x")
    assert fitted == (None if step_size is None else pytest.approx(step_size, rel=1e-12, abs=0.0))
    assert ("[step-hint]" in caplog.text) == is_changed


@pytest.mark.parametrize(("stop", "end"), [(3.0, 3.0), (3.2, 2.8), (1.1, 1.6)])
def test_a_run_ends_at_a_step(stop: float, end: float, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        assert fit_stop(1.0, stop, 0.2 if stop == 3.0 else 0.6, "x") == pytest.approx(end)
    assert ("[stop-time]" in caplog.text) == (stop != end)


@pytest.mark.parametrize(("start", "stop"), [(1.0, 1.0), (1.0, 0.0), (0.0, float("inf"))])
def test_a_run_ends_after_its_start(start: float, stop: float) -> None:
    with pytest.raises(ConfigError, match=r"^x: it stops at"):
        require_times(start, stop, "x")
    require_times(0.0, 1.0, "x")
