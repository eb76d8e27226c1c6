"""fmi-sim, an engine in Rust that `make interop` installs."""

import subprocess
from pathlib import Path

FMI_SIM = Path(__file__).parents[1] / ".tools/interop/bin/fmi-sim"


def run_in_fmi_sim(fmu: Path, step: float, steps: int) -> None:
    """Run an FMU of FMI 3.0 at its defaults, without a message.

    fmi-sim does not support arrays of several elements as outputs.
    """
    command = [FMI_SIM, "--model", fmu, "-o", "out.csv", "-q", "co-simulation"]
    command += ["--output-interval", str(step), "-f", str(step * steps)]
    answer = subprocess.run(command, cwd=fmu.parent, capture_output=True, text=True, check=False)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert len((fmu.parent / "out.csv").read_text(encoding="utf-8").splitlines()) >= steps
