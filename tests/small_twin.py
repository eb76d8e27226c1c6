"""Short motions of the digital twin and gains of its closed loop, as TOML."""

MOTIONS = """
[[motions]]
name = "excitation"
kind = "fourier"
seed = 86
harmonics = 5
period = 6.0
peak_velocity = [1.0, 0.9, 1.0]
offset = [0.0, 0.3, -1.9]
also_reversed = true

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

[[motions]]
name = "trial"
kind = "fourier"
seed = 1
harmonics = 5
period = 5.0
peak_velocity = [0.9, 0.8, 0.9]
offset = [0.0, 0.3, -1.9]
"""

GAINS = """
[tracking.gains]
Kp = [0.005, 0.0066, 0.009]
Kd = [0.0, 0.0, 0.0]
decay = 4.0
Kv = [90.5, 150.8, 52.8]
Ki = [905.0, 1508.0, 528.0]
latency = 0.01
"""
