"""Names of the measured logs of a UR10e, which are next to the repository."""

from pathlib import Path

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "ur10e"

IDENTIFICATION = ("id_fourier_50s_12harm", "id_fourier_30s_12harm", "id_fourier_20s_5harm")
TEST = (
    "test_fourier_40s_12harm",
    "test_fourier_20s_7harm",
    "test_fourier_20s_8harm",
    "test_ptp_10_points",
)
