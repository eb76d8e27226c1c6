"""Results of a minimal study of the digital twin that covers every step."""

from pathlib import Path

import pytest
from small_twin import GAINS, MOTIONS

from cosim.study.run import run_study
from hesr.extras.studies import robustness
from hesr_model.support.files import models_folder

STUDY = """
name = "small"
robot = "{uf850}/robot.toml"
seed = 3
laws = ["stribeck", "parfam_h"]
bands = [
  {{ test = "trial & error", name = "first <half>", stop = 2.5 }},
  {{ test = "trial & error", name = "second half", start = 2.5 }},
]

[options.parfam_h]
cells = 2
starts = 4
candidates = 2
functions = ["tanh"]

[variants.plain]
law = "stribeck"

[twin]
plant = "{uf850}/plant.toml"
signals = "{uf850}/arm.toml"
motions = "motions.toml"

[logs]
identification = ["excitation"]
reversed = ["excitation_reversed"]
friction = ["sweep"]

[logs.test]
"trial & error" = ["trial"]

[tracking]
seeds = [101]
duration = 1.0
harmonics = 2
peak_velocity = [0.4, 0.4, 0.4]
offset = [0.0, 0.3, -1.9]
Kx = 5.0
sources = ["parfam_h"]
drift = 2.0
"""


FEWER = {
    "PAYLOADS": (1.0,),
    "FRICTION_SCALES": (),
    "LATENCIES": (),
    "GAIN_ERRORS": (),
    "FACTORS": (0.5, 1.0),
}
"""Changes in the closed loop; all of them take minutes."""


def write_results(folder: Path) -> Path:
    """Run the study and return its results folder."""
    (folder / "motions.toml").write_text(MOTIONS, encoding="utf-8")
    study = folder / "study.toml"
    study.write_text(STUDY.format(uf850=models_folder() / "uf850") + GAINS, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        for name, few in FEWER.items():
            patch.setattr(robustness, name, few)
        run_study(study, folder / "results")
    return folder / "results"
