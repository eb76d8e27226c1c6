"""Correct logs of 40 synthetic benches: what a check says about them is a false alarm.

A bench has friction with break-away, hysteresis and viscous parts, an inertia that the robot file
does not state, an encoder with noise or counts, and a drive that measures torque with noise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import RobotDescription

Array = np.ndarray
TURN = 2.0 * np.pi
URDF = """<robot name="bench"><link name="base"/>
<joint name="axis" type="{kind}"><parent link="base"/><child link="body"/><axis xyz="0 {y} {z}"/>
<limit lower="{lower}" upper="{upper}" effort="0" velocity="0"/></joint>
<link name="body"><inertial><origin xyz="{lever} 0 0"/><mass value="{mass}"/>
<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A joint, how it moves and how it is logged.

    Attributes
    ----------
    speed : velocity [rad/s or m/s] at times (N,) [s].
    seconds, rate : duration [s] and sample rate [Hz].
    coulomb, viscous, inertia : of the joint, in SI units.
    rise : share of Coulomb friction that break-away exceeds it by.
    deflection : over which friction builds up [rad or m].
    position_noise, torque_noise, speed_noise : standard deviations; counts of the encoder.
    gravity : torque of a pendulum at the horizontal [N.m], stated by the model.
    known : whether the robot file states the body.
    """

    speed: Callable[[Array], Array]
    seconds: float = 20.0
    rate: float = 200.0
    coulomb: float = 0.3
    viscous: float = 0.05
    inertia: float = 0.01
    rise: float = 0.3
    deflection: float = 2e-3
    stribeck: float = 0.1
    position_noise: float = 0.0
    count: float = 0.0
    speed_noise: float = 0.0
    torque_noise: float = 0.02
    gravity: float = 0.0
    known: bool = False
    slides: bool = False
    has_velocity: bool = True

    def record(self, seed: int) -> list[Log]:
        """Return a log of one seed, whose phase and noise it draws."""
        rng = np.random.default_rng(seed)
        stride = max(1, round(1000.0 / self.rate))
        step = 1.0 / (self.rate * stride)
        t = step * np.arange(round(self.seconds * self.rate) * stride)
        phase = 0.0 if self.gravity else rng.uniform(0.0, 0.2)
        dq = self.speed(t + phase)
        # The drive holds its speed within some per cent.
        peak = np.max(np.abs(dq))
        dq = dq * (1.0 + 0.002 * np.sin(7.0 * np.cumsum(dq) * step + rng.uniform(0, TURN)))
        q = np.cumsum(dq) * step + (0.3 if self.gravity else 0.0)
        friction = self._compute_friction(dq, step)
        smooth_dq = np.convolve(dq, np.ones(5) / 5, "same")
        tau = friction + self.inertia * np.gradient(smooth_dq, step)
        tau += self.gravity * np.cos(q)
        rows = slice(None, None, stride)
        t, q, dq, tau = t[rows], q[rows], dq[rows], tau[rows]
        q = q + self.position_noise * rng.standard_normal(len(t))
        if self.count:
            q = self.count * np.round(q / self.count)
        scale = np.sqrt(np.mean(tau**2))
        tau = tau + self.torque_noise * scale * rng.standard_normal(len(t))
        dq = dq + self.speed_noise * peak * rng.standard_normal(len(t))
        logged_dq = dq[:, None] if self.has_velocity else None
        return [Log(name="run", t=t, q=q[:, None], dq=logged_dq, tau=tau[:, None])]

    def _compute_friction(self, dq: Array, step: float) -> Array:
        """Return friction with a stop (elastoplastic) and a Stribeck level."""
        peak = np.max(np.abs(dq))
        level = 1.0 + self.rise * np.exp(-np.abs(dq) / (self.stribeck * peak))
        stop = np.empty_like(dq)
        state = 0.0
        for k, displacement in enumerate(dq * step / self.deflection):
            state = min(1.0, max(-1.0, state + displacement))
            stop[k] = state
        return self.coulomb * level * stop + self.viscous * dq

    def write_description(self, folder: Path) -> RobotDescription:
        """Write the model of the bench, and return its robot file."""
        lever = self.gravity / 9.81 if self.gravity else 0.0
        text = URDF.format(
            kind="prismatic" if self.slides else "continuous",
            y=-1 if self.gravity else 0,
            z=0 if self.gravity else 1,
            lower=0,
            upper=0,
            lever=lever,
            mass=1.0,
            inertia=max(self.inertia - lever**2, 1e-6) if self.known else 1.0,
        )
        path = folder / "bench.urdf"
        path.write_text(text, encoding="utf-8")
        known = None if self.known else ()
        return RobotDescription(
            name="bench",
            model=path,
            joints=("axis",),
            known=known,
            rotor_inertia=False,
            log={"filter_cutoff": min(15.0, 0.3 * self.rate)},
        )


def strokes(speed: float, seconds: float) -> Callable[[Array], Array]:
    """Constant speed that reverses every `seconds`."""
    return lambda t: speed * np.where((t // seconds) % 2 < 1, 1.0, -1.0)


def stairs(speeds: tuple[float, ...], seconds: float) -> Callable[[Array], Array]:
    """Speeds one after another, each both ways."""

    def speed(t: Array) -> Array:
        step = np.minimum((t // (2.0 * seconds)).astype(int), len(speeds) - 1)
        return np.array(speeds)[step] * np.where((t // seconds) % 2 < 1, 1.0, -1.0)

    return speed


def ramped(speed: float, seconds: float) -> Callable[[Array], Array]:
    """Start once, in a twentieth of `seconds`, and never reverse."""
    return lambda t: speed * np.clip(t / (0.05 * seconds), 0.0, 1.0)


def sines(*pairs: tuple[float, float]) -> Callable[[Array], Array]:
    """A sum of sines of speed, each with amplitude and frequency [Hz]."""
    return lambda t: sum(
        amplitude * np.sin(TURN * frequency * t + k)
        for k, (amplitude, frequency) in enumerate(pairs)
    )


def trapezoid(speed: float, period: float, share: float = 0.2) -> Callable[[Array], Array]:
    """Alternating trapezoids of speed with ramps of a share of half a period."""

    def shape(t: Array) -> Array:
        x = (2.0 * t / period) % 2.0
        up = np.minimum(x % 1.0, 1.0 - x % 1.0) / share
        return speed * np.minimum(up, 1.0) * np.where(x < 1.0, 1.0, -1.0)

    return shape


FAST = sines((2.0, 0.23), (1.0, 0.7))
BENCHES: dict[str, Bench] = {
    # Constant speeds, the standard friction experiment.
    "one reversal": Bench(speed=strokes(0.4, 10.0), speed_noise=0.08, position_noise=5e-4),
    "strokes": Bench(speed=strokes(0.4, 4.0), speed_noise=0.08, position_noise=5e-4),
    "fast strokes": Bench(speed=strokes(20.0, 2.0), speed_noise=0.02, count=TURN / 4096),
    "staircase": Bench(speed=stairs((0.1, 0.3, 0.5, 0.7), 5.0), seconds=40.0, speed_noise=0.08),
    "long staircase": Bench(
        speed=stairs((0.5, 1.0, 2.0, 5.0, 10.0), 4.0), seconds=40.0, count=TURN / 2000
    ),
    "staircase without velocity": Bench(
        speed=stairs((0.1, 0.3, 0.5), 5.0), seconds=30.0, has_velocity=False, count=1e-4
    ),
    "trapezoids": Bench(speed=trapezoid(1.0, 4.0), speed_noise=0.02),
    "heavy trapezoids": Bench(speed=trapezoid(1.0, 2.0, 0.1), inertia=0.5, count=1e-3),
    # One way only.
    "one way": Bench(speed=ramped(0.5, 6.0), seconds=6.0, rate=1000.0),
    "one way, exact": Bench(
        speed=ramped(0.3, 6.0), seconds=6.0, rate=1000.0, torque_noise=0.001
    ),
    "one way, noisy": Bench(speed=ramped(2.0, 10.0), seconds=10.0, speed_noise=0.1, count=1e-3),
    "one way, swaying": Bench(speed=lambda t: 1.0 + 0.5 * np.sin(TURN * 0.2 * t)),
    "one way, backwards": Bench(speed=lambda t: -ramped(5.0, 8.0)(t), seconds=8.0),
    # Creeping.
    "creeping": Bench(
        speed=sines((6e-3, 0.08)), seconds=80.0, rate=100.0, deflection=1e-4, viscous=10.0
    ),
    "creeping strokes": Bench(
        speed=strokes(2e-3, 10.0), seconds=60.0, rate=50.0, deflection=5e-5, count=1e-6
    ),
    "hysteresis loop": Bench(
        speed=sines((5e-3, 0.2)), seconds=40.0, rate=100.0, deflection=4e-3, rise=0.0
    ),
    "wide hysteresis loop": Bench(
        speed=sines((0.1, 0.5)), seconds=20.0, deflection=0.05, rise=0.0, viscous=0.0
    ),
    "pre-sliding": Bench(
        speed=sines((1e-3, 0.3), (5e-4, 0.71)), seconds=30.0, deflection=2e-3, rise=0.0,
        position_noise=1e-7,
    ),
    "creeping, whole counts": Bench(
        speed=sines((0.02, 0.05)), seconds=60.0, rate=100.0, count=2e-5, has_velocity=False
    ),
    # Sliding.
    "cylinder": Bench(
        speed=sines((15e-3, 0.08)), seconds=80.0, rate=100.0, slides=True, coulomb=12.0,
        viscous=400.0, inertia=20.0, deflection=1e-4,
    ),
    "cylinder strokes": Bench(
        speed=strokes(18e-3, 4.0), seconds=40.0, rate=100.0, slides=True, coulomb=80.0,
        viscous=900.0, inertia=5.0, deflection=1e-4, count=1e-6, has_velocity=False,
    ),
    "fretting rig": Bench(
        speed=sines((3e-4, 1.0)), seconds=20.0, rate=500.0, slides=True, coulomb=40.0,
        viscous=0.0, inertia=1.0, deflection=2e-5, count=1e-7,
    ),
    "linear motor": Bench(
        speed=sines((1.0, 0.4), (0.5, 1.3)), rate=1000.0, slides=True, coulomb=20.0, viscous=15.0,
        inertia=6.0, deflection=1e-4, count=1e-6,
    ),
    "gantry": Bench(
        speed=trapezoid(2.0, 3.0), slides=True, coulomb=60.0, viscous=10.0, inertia=30.0,
        position_noise=1e-5,
    ),
    "micrometres": Bench(
        speed=trapezoid(2e-5, 4.0), seconds=40.0, rate=100.0, slides=True, coulomb=1.0,
        viscous=100.0, inertia=0.2, deflection=2e-6, count=1e-8,
    ),
    # Noisy.
    "noisy torque": Bench(speed=FAST, torque_noise=0.5),
    "very noisy torque": Bench(speed=FAST, torque_noise=1.5, seconds=30.0),
    "noisy position": Bench(speed=FAST, position_noise=2e-3),
    "noisy velocity": Bench(speed=FAST, speed_noise=0.3),
    "all noisy": Bench(speed=FAST, speed_noise=0.15, position_noise=1e-3, torque_noise=0.4),
    "coarse encoder": Bench(speed=FAST, count=TURN / 10000, has_velocity=False),
    # Rates.
    "25 Hz": Bench(speed=sines((1.0, 0.1), (0.5, 0.23)), rate=25.0, seconds=60.0),
    "50 Hz": Bench(speed=sines((1.0, 0.2), (0.5, 0.43)), rate=50.0, seconds=40.0),
    "100 Hz": Bench(speed=FAST, rate=100.0),
    "500 Hz": Bench(speed=FAST, rate=500.0),
    "1 kHz": Bench(speed=FAST, rate=1000.0, speed_noise=0.05),
    "2 kHz": Bench(speed=FAST, rate=2000.0, seconds=10.0, count=TURN / 2**17),
    "4 kHz": Bench(speed=FAST, rate=4000.0, seconds=8.0, count=TURN / 2**20, has_velocity=False),
    # Gravity, and a body that is stated.
    "pendulum": Bench(
        speed=sines((1.5, 0.2), (0.5, 0.37)), gravity=2.0, known=True, inertia=0.05, seconds=30.0
    ),
    "light wrist": Bench(
        speed=FAST, gravity=0.15, known=True, inertia=0.002, coulomb=6.0, viscous=0.5, rise=0.1
    ),
}  # fmt: skip
