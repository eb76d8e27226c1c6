"""Adaptive friction FMUs for co-simulation: friction estimated from measured torques."""

from collections.abc import Sequence
from pathlib import Path

from fmu_src.export.package import Content, Version, check_request, write_fmu
from fmu_src.friction.discrete_fmu import discrete_equations
from fmu_src.friction.friction_fmu import about_model, bare_content
from fmu_src.friction.validity import require_numbers
from hesr.extras.adaptive.component import ADAPT
from hesr.extras.adaptive.follow import adaptive_components
from hesr_model.friction.model import FrictionModel
from hesr_model.support.progress import Progress, silent


def export_adaptive(
    model: FrictionModel,
    path: Path,
    *,
    platforms: Sequence[str] = ("linux64",),
    progress: Progress = silent,
    fmi: Version = 2,
) -> Path:
    """Write a friction model with stops or bristles as an adaptive FMU, without pages."""
    check_request(path, platforms)
    return write_fmu(adaptive_content(model), path, platforms=platforms, progress=progress, fmi=fmi)


def adaptive_content(model: FrictionModel) -> Content:
    """Return the adaptive FMU before compilation."""
    about = about_model(model, "adaptive", "that adapts to measured torques")
    equations = discrete_equations(model, adaptive_components(model), (ADAPT,))
    require_numbers(model)
    return bare_content(model, about, *equations)
