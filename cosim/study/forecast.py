"""What a planned motion expects of the next run: standard errors and detectable differences."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hesr_model.friction.model import FrictionModel
from hesr_model.support.typed_files import from_json, read_json

SUFFIX = ".plan.json"
FORMAT = "hesr-plan-1"  # of the file next to a log of the planned motion
_MAX_DIFFERENCE = 0.25  # difference of widths that agree


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """Standard errors by law, joint and coefficient [SI], and detectable ratios by joint."""

    widths: Mapping[str, Mapping[str, Mapping[str, float]]]
    detectable: Mapping[str, float]

    @classmethod
    def from_logs(cls, logs: Iterable[Path]) -> "Forecast | None":
        """Read the plan next to the last log that has one."""
        plan_paths = [log.with_suffix(SUFFIX) for log in logs]
        known_paths = [path for path in plan_paths if path.is_file()]
        if not known_paths:
            return None
        path = known_paths[-1]
        return from_json(cls, read_json(path, FORMAT), path, "a plan")

    def ratios(self, models: Mapping[str, FrictionModel]) -> dict[tuple[str, str, str], float]:
        """Return the standard errors of fits over the expected ones, by law, joint, coefficient."""
        ratios = {}
        for law_name, joints in self.widths.items():
            if law_name not in models:
                continue
            model = models[law_name]
            for joint, friction_law in zip(model.joints, model.laws, strict=True):
                for name, error in friction_law.standard_errors.items():
                    expected = joints.get(joint, {}).get(name)
                    if expected and error > 0.0:
                        ratios[law_name, joint, name] = error / expected
        return ratios

    def sentence(
        self, models: Mapping[str, FrictionModel], detectable_ratios: Mapping[str, float]
    ) -> str:
        """Compare with fits, and with the `detectable_ratios` of a test by joint."""
        parts = []
        ratios = np.array(list(self.ratios(models).values()))
        if len(ratios):
            near = 100 * np.mean(np.abs(ratios - 1.0) < _MAX_DIFFERENCE)
            parts.append(
                f"standard errors are {np.median(ratios):.2f} of the expected ones in the median, "
                f"{near:.0f} % of them within 25 %"
            )
        ratio_pairs = [
            (detectable_ratios[joint], expected_ratio)
            for joint, expected_ratio in self.detectable.items()
            if joint in detectable_ratios
        ]
        if ratio_pairs:
            shown_percent, expected_percent = 100 * np.expm1(np.log(ratio_pairs).mean(axis=0))
            parts.append(
                f"differences of {shown_percent:.0f} % show ({expected_percent:.0f} % expected)"
            )
        if not parts:
            return ""
        return f"Planned motion: {'; '.join(parts)}."
