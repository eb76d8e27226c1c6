"""Short motions of the digital twin and gains of its closed loop, as TOML, and how to run them."""

ALONE = "import os; os.cpu_count = lambda: 1; from hesr.cli import main; main()"
"""The command line without worker processes, which import all again."""


def fourier(name: str, seed: int, harmonics: int, period: float, peaks: str) -> str:
    return f"""
[[motions]]
name = "{name}"
kind = "fourier"
seed = {seed}
harmonics = {harmonics}
period = {period}
peak_velocity = [{peaks}]
offset = [0.0, 0.3, -1.9]
"""


EXCITATION = fourier("excitation", 86, 5, 6.0, "1.0, 0.9, 1.0")
TRIAL = fourier("trial", 1, 5, 5.0, "0.9, 0.8, 0.9")

MOTIONS = f"""{EXCITATION}also_reversed = true

[[motions]]
name = "sweep"
kind = "sweep"
first = 0.2
last = 0.6
length = 8.0
amplitude = [0.7, 0.7, 0.7]
swing = [0.3, 0.3, 0.3]
swing_phase = [-1.57, 0.0, 1.57]
swing_period = 5.0
start = [-0.2, -0.6, -2.6]
{TRIAL}"""

GAINS = """
[tracking.gains]
Kp = [0.005, 0.0066, 0.009]
Kd = [0.0, 0.0, 0.0]
decay = 4.0
Kv = [90.5, 150.8, 52.8]
Ki = [905.0, 1508.0, 528.0]
latency = 0.01
"""
